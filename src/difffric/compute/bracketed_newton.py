"""Newton's iteration kept inside a bracket, as a root finder of optimistix."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax import Array

from difffric.compute.event_root import HIT


class _BracketState(eqx.Module):
    """The bracket, the last step, the slope where it began, and whether the root is there."""

    lower: Array
    upper: Array
    step: Array
    slope: Array
    arrived: Array


class BracketedNewton(optx.AbstractRootFinder):
    """Newton's iteration for a scalar function that changes sign once in a bracket.

    A step that leaves the bracket, or starts where the function is flat, is replaced by
    bisection, so it cannot diverge. Options: `lower` and `upper`, as for
    `optimistix.Bisection`, and `rising`, whether the function is negative below the root.
    """

    atol: float = 1e-15
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
    ) -> _BracketState:
        """The state before the first step."""
        lower, upper = (jnp.asarray(options[key], float) for key in ("lower", "upper"))
        nothing = jnp.asarray(jnp.nan)
        return _BracketState(lower, upper, jnp.asarray(jnp.inf), nothing, jnp.asarray(False))

    def step(
        self,
        fn: Callable,
        y: Array,
        args: Any,
        options: dict[str, Any],
        state: _BracketState,
        tags: frozenset[object],
    ) -> tuple[Array, _BracketState, Any]:
        """(y, state, aux) after one step of Newton's method, or one bisection."""
        (value, aux), (slope, _) = jax.jvp(lambda at: fn(at, args), (y,), (jnp.ones_like(y),))
        below = (value < 0) == options["rising"]
        lower = jnp.where(below, y, state.lower)
        upper = jnp.where(below, state.upper, y)
        flat = (slope == 0) | ~jnp.isfinite(slope)
        new = y - value / jnp.where(flat, 1.0, slope)
        step = jnp.abs(new - y)
        inside = ~flat & (new >= lower) & (new <= upper)
        # Newton's error is quadratic in its step: after one this small, nothing is left to do.
        arrived = ~flat & ((inside & (step < 1e-9)) | (step <= 4e-16 * jnp.abs(y)))
        hit = jnp.abs(value) <= HIT
        new = jnp.where(hit, y, jnp.where(inside | arrived, new, 0.5 * (lower + upper)))
        arrived = arrived | hit
        last = jnp.where(arrived, 0.0, jnp.abs(new - y))
        return new, _BracketState(lower, upper, last, slope, arrived), aux

    def terminate(
        self,
        fn: Callable,
        y: Array,
        args: Any,
        options: dict[str, Any],
        state: _BracketState,
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
        state: _BracketState,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[Array, Any, dict[str, Any]]:
        """The answer as it is."""
        return y, aux, {}
