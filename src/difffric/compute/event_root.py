"""A bracketed Newton root for event times, with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

from difffric.compute import arrays as xp
from difffric.compute.dual_numbers import Dual, highest, split
from difffric.compute.lanes import repeat_while
from difffric.compute.pytrees import list_leaves, map_tree

HIT = 1e-14
"""A relative excess below this is none: where the model is flat there is no better."""

_EPS = np.finfo(float).eps


class _Bracketing(NamedTuple):
    """Where the search for a root stands: the time, its bracket, the last step and how many."""

    t: Any
    lo: Any
    hi: Any
    step: Any
    count: Any


def find_falling_root(
    f: Callable[[Any, Any], tuple[Any, Any]],
    args: Any,
    lo: Any,
    hi: Any,
    guess: Any,
    rounds: int = 0,
) -> Any:
    """The root in [lo, hi] of `f(t, args) = (value, slope)`, which falls from > 0 to <= 0.

    Newton from `guess`; a step that leaves the bracket is replaced by bisection. So many
    `rounds` of it as are given are written out before the loop, which then mostly runs none:
    for a guess that is good enough for that. The derivative with respect to `args` is the
    implicit function's, for JAX itself differentiable: `slope` must be the exact derivative of
    `value` in t.
    """
    numbers = (*list_leaves(args), lo, hi, guess)
    if xp.uses_jax(*numbers):
        return _make_search()(f, args, lo, hi, guess, rounds)
    level = highest(numbers)
    if not level:
        lanes = np.broadcast_shapes(*map(np.shape, numbers))
        return _search(f, args, lo, hi, np.broadcast_to(guess, lanes), rounds)
    values = map_tree(lambda x: split(x, level)[0], (args, lo, hi, guess))
    t = find_falling_root(f, *values, rounds=rounds)
    value, slope = f(t, args)
    along, slope = split(value, level)[1], split(slope, level)[0]
    return t if along is None else Dual(t, _implicit_tangent(along, slope), level)


def _implicit_tangent(value_dot, slope):
    return -value_dot / xp.where(slope == 0, 1.0, slope)


def _search(f, args, lo, hi, guess, rounds):
    def is_unfinished(s):
        return (xp.abs(s.step) > 2 * _EPS * xp.abs(s.t)) & (s.count < 100)

    def improve(s, args):
        value, slope = f(s.t, args)
        lo = xp.where(value > 0, s.t, s.lo)
        hi = xp.where(value > 0, s.hi, s.t)
        t = s.t - value / xp.where(slope == 0, -_EPS, slope)
        # Newton's error is quadratic in its step: after one this small, nothing is left to do
        # (and if it leaves the bracket by a rounding, that is an arrival, not an escape).
        arrived = xp.abs(t - s.t) <= 1e-10 * xp.abs(s.t)
        inside = (t >= lo) & (t <= hi)
        t = xp.where(arrived, xp.clip(t, lo, hi), xp.where(inside, t, 0.5 * (lo + hi)))
        return _Bracketing(t, lo, hi, xp.where(arrived, 0.0, t - s.t), s.count + 1)

    lo, hi, guess = xp.broadcast_arrays(lo, hi, xp.clip(guess, lo, hi))
    start = _Bracketing(guess, lo, hi, xp.full_like(guess, xp.inf), xp.zeros_like(guess, int))
    for _ in range(rounds):
        start = improve(start, args)
    return repeat_while(is_unfinished, improve, start, args).t


@cache
def _make_search():
    """`_search` with the rule of its derivative as JAX has them."""
    import jax
    from jax.custom_derivatives import SymbolicZero

    search = partial(jax.custom_jvp, nondiff_argnums=(0, 5))(_search)

    def is_zero(tangent):
        return isinstance(tangent, SymbolicZero)

    def follow_args(f, rounds, primals, tangents):
        args, lo, hi, guess = primals
        t = search(f, args, lo, hi, guess, rounds)
        # Along what does move: a law's share in a derivative by mu_s is then not computed as zeros.
        leaves, structure = jax.tree.flatten(args)
        along = jax.tree.leaves(tangents[0], is_leaf=is_zero)
        moving = [i for i, tangent in enumerate(along) if not is_zero(tangent)]

        def at(some):
            every = list(leaves)
            for i, leaf in zip(moving, some, strict=True):
                every[i] = leaf
            return f(t, jax.tree.unflatten(structure, every))

        (_, slope), (value_dot, _) = jax.jvp(
            at, ([leaves[i] for i in moving],), ([along[i] for i in moving],)
        )
        return t, _implicit_tangent(value_dot, slope)

    search.defjvp(follow_args, symbolic_zeros=True)
    return search
