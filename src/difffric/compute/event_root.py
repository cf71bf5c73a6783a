"""A bracketed Newton root for event times, with exact derivatives of every order."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, ArrayLike, Float, Int

HIT = 1e-14
"""A relative excess below this is none: where the model is flat there is no better."""


class _Bracketing(NamedTuple):
    """Where the search for a root stands: the time, its bracket, the last step and how many."""

    t: Float[Array, ""]
    lo: Float[Array, ""]
    hi: Float[Array, ""]
    step: Float[Array, ""]
    count: Int[Array, ""]


@partial(jax.custom_jvp, nondiff_argnums=(0, 5))
def find_falling_root(
    f: Callable[[Array, Any], tuple[Array, Array]],
    args: Any,
    lo: Float[ArrayLike, ""],
    hi: Float[ArrayLike, ""],
    guess: Float[ArrayLike, ""],
    rounds: int = 0,
) -> Float[Array, ""]:
    """The root in [lo, hi] of `f(t, args) = (value, slope)`, which falls from > 0 to <= 0.

    Newton from `guess`; a step that leaves the bracket is replaced by bisection. So many
    `rounds` of it as are given are written out before the loop, which then mostly runs none:
    for a guess that is good enough for that. The derivative with respect to `args` is the
    implicit function's, itself differentiable: `slope` must be the exact derivative of `value`
    in t.
    """
    eps = jnp.finfo(jnp.result_type(float)).eps

    def is_unfinished(s):
        return (jnp.abs(s.step) > 2 * eps * jnp.abs(s.t)) & (s.count < 100)

    def improve(s):
        value, slope = f(s.t, args)
        lo = jnp.where(value > 0, s.t, s.lo)
        hi = jnp.where(value > 0, s.hi, s.t)
        t = s.t - value / jnp.where(slope == 0, -eps, slope)
        # Newton's error is quadratic in its step: after one this small, nothing is left to do
        # (and if it leaves the bracket by a rounding, that is an arrival, not an escape).
        arrived = jnp.abs(t - s.t) <= 1e-10 * jnp.abs(s.t)
        inside = (t >= lo) & (t <= hi)
        t = jnp.where(arrived, jnp.clip(t, lo, hi), jnp.where(inside, t, 0.5 * (lo + hi)))
        return _Bracketing(t, lo, hi, jnp.where(arrived, 0.0, t - s.t), s.count + 1)

    lo, hi, guess = jnp.broadcast_arrays(lo, hi, jnp.clip(guess, lo, hi))
    start = _Bracketing(guess, lo, hi, jnp.full_like(guess, jnp.inf), jnp.zeros_like(guess, int))
    for _ in range(rounds):
        start = improve(start)
    return jax.lax.while_loop(is_unfinished, improve, start).t


@partial(find_falling_root.defjvp, symbolic_zeros=True)
def _falling_root_jvp(f, rounds, primals, tangents):
    args, lo, hi, guess = primals
    t = find_falling_root(f, args, lo, hi, guess, rounds)
    # Along what does move: a law's share in a derivative by mu_s is then not computed as zeros.
    leaves, structure = jax.tree.flatten(args)
    along = jax.tree.leaves(tangents[0], is_leaf=_is_zero)
    moving = [i for i, tangent in enumerate(along) if not _is_zero(tangent)]

    def at(some):
        every = list(leaves)
        for i, leaf in zip(moving, some, strict=True):
            every[i] = leaf
        return f(t, jax.tree.unflatten(structure, every))

    (_, slope), (value_dot, _) = jax.jvp(
        at, ([leaves[i] for i in moving],), ([along[i] for i in moving],)
    )
    return t, -value_dot / jnp.where(slope == 0, 1.0, slope)


def _is_zero(tangent):
    return isinstance(tangent, SymbolicZero)
