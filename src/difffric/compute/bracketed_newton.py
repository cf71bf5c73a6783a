"""Newton's iteration kept inside a bracket, as a root finder of optimistix."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optimistix as optx
from jax import Array

from difffric.compute.bracketed_step import ARRIVED, Bracket, step_in_bracket


class BracketedNewton(optx.AbstractRootFinder):
    """Newton's iteration for a scalar function that changes sign once in a bracket.

    A step that leaves the bracket, or starts where the function is flat, is replaced by
    bisection, so it cannot diverge. Options: `lower` and `upper`, as for
    `optimistix.Bisection`, and `rising`, whether the function is negative below the root.
    """

    atol: float = ARRIVED
    rtol: float = 0.0
    norm: Any = jnp.abs

    def init(
        self,
        fn: Callable,
        y: Array,
        args: Any,
        options: dict[str, Any],
        f_struct: Any,
        aux_struct: Any,
        tags: frozenset[object],
    ) -> Bracket:
        """The state before the first step."""
        lower, upper = (jnp.asarray(options[key], float) for key in ("lower", "upper"))
        nothing = jnp.asarray(jnp.nan)
        return Bracket(lower, upper, jnp.asarray(jnp.inf), nothing, jnp.asarray(False))

    def step(
        self,
        fn: Callable,
        y: Array,
        args: Any,
        options: dict[str, Any],
        state: Bracket,
        tags: frozenset[object],
    ) -> tuple[Array, Bracket, Any]:
        """(y, state, aux) after one step of Newton's method, or one bisection."""
        (value, aux), (slope, _) = jax.jvp(lambda at: fn(at, args), (y,), (jnp.ones_like(y),))
        new, bracket = step_in_bracket(y, value, slope, state, options["rising"])
        return new, bracket, aux

    def terminate(
        self,
        fn: Callable,
        y: Array,
        args: Any,
        options: dict[str, Any],
        state: Bracket,
        tags: frozenset[object],
    ) -> tuple[Array, optx.RESULTS]:
        """(whether y is the root, that all is well)."""
        done = state.step <= self.atol + self.rtol * jnp.abs(y)
        return done, optx.RESULTS.successful

    def postprocess(
        self,
        fn: Callable,
        y: Array,
        aux: Any,
        args: Any,
        options: dict[str, Any],
        state: Bracket,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[Array, Any, dict[str, Any]]:
        """The answer as it is."""
        return y, aux, {}
