"""A step of Newton's method that stays inside a bracket, for whoever walks it: `bracketed_newton`
under JAX, or columns of NumPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from difffric.compute import arrays as xp
from difffric.compute.event_root import HIT
from difffric.compute.lanes import differentiate, repeat_while

LONGEST = 200
"""Steps after which a search is given up: bisection alone comes to rounding in sixty."""
JUMP = 1e-6
"""A relative excess above this that a step of rounding removes is a jump, such as that of d where
the part only just leaves the tip, and no root."""
NARROW, STEEP = 1e-9, 1e-3
"""A bracket this narrow within which the relative excess is still this large holds a jump too: a
root there would be of a slope of 1e6 at least. It is not bisected to the end."""
ARRIVED = 1e-15
"""The last step of a root that has been found is no longer than this."""


class Bracket(NamedTuple):
    """The bracket, the last step, the slope where it began, and whether the root is there."""

    lower: Any
    upper: Any
    step: Any
    slope: Any
    arrived: Any


def step_in_bracket(
    y: Any, value: Any, slope: Any, bracket: Bracket, rising: Any
) -> tuple[Any, Bracket]:
    """(y, bracket) after one step of Newton's method from y, where the function has this value and
    slope, or after one bisection: where the step leaves the bracket, or the function is flat.

    `rising`: whether the function is negative below its root.
    """
    below = (value < 0) == rising
    lower = xp.where(below, y, bracket.lower)
    upper = xp.where(below, bracket.upper, y)
    flat = (slope == 0) | ~xp.isfinite(slope)
    new = y - value / xp.where(flat, 1.0, slope)
    step = xp.abs(new - y)
    inside = ~flat & (new >= lower) & (new <= upper)
    # Newton's error is quadratic in its step: after one this small, nothing is left to do.
    arrived = ~flat & ((inside & (step < 1e-9)) | (step <= 4e-16 * xp.abs(y)))
    arrived = arrived & (xp.abs(value) < JUMP)
    hit = xp.abs(value) <= HIT
    new = xp.where(hit, y, xp.where(inside | arrived, new, 0.5 * (lower + upper)))
    arrived = arrived | hit
    jumps = (upper - lower < NARROW) & (xp.abs(value) > STEEP)
    last = xp.where(arrived | jumps, 0.0, xp.abs(new - y))
    return new, Bracket(lower, upper, last, slope, arrived)


class _Search(NamedTuple):
    """Where the search in each lane stands."""

    y: Any
    bracket: Bracket
    count: Any


def find_roots_in_brackets(
    function: Callable[..., Any], given: Any, lower: Any, upper: Any, rising: Any
) -> tuple[Any, Bracket]:
    """(y, bracket) at the end of the search for the root of `function(y, *given)` in each lane.

    All columns (n,) of NumPy's, and the function of such; lanes that are done are no longer asked.
    """

    def improve(search, rising, *given):
        value, slope = differentiate(lambda y: function(y, *given), search.y, 1.0)
        y, bracket = step_in_bracket(search.y, value, slope, search.bracket, rising)
        return _Search(y, bracket, search.count + 1)

    def goes_on(search):
        return ~(search.bracket.step <= ARRIVED) & (search.count < LONGEST)

    n = len(lower)
    bracket = Bracket(lower, upper, np.full(n, np.inf), np.full(n, np.nan), np.zeros(n, bool))
    with np.errstate(all="ignore"):
        start = _Search(0.5 * (lower + upper), bracket, np.zeros(n, int))
        end = repeat_while(goes_on, improve, start, rising, *given)
    return end.y, end.bracket
