"""A quasi-Newton search within bounds, from a point whose curvature is nearly known.

Written by hand, as scipy's BFGS knows no bounds and its L-BFGS-B no first curvature, without which
a fit takes several times as many evaluations, each of which follows every push dozens of times.
Source: J. Nocedal and S. J. Wright, Numerical Optimization, 2nd ed. (2006), procedure 18.2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_FARTHEST = 4.0
"""The longest step, in standard deviations of what the curvature says."""
_LONGEST = 1.0
"""The longest step along one coordinate."""
_NOISE = 5e-3
"""A rise of the value by less than this is rounding of the integrals, if the gradient shrinks."""
_SHORTER, _TRIALS = 0.3, 5
"""By how much a step that does not bring the value down is shortened, and how often."""
_DAMPED = 0.2
"""The least share of the known curvature along a step that a step leaves (Powell)."""


class Found(NamedTuple):
    """Where a search ended."""

    x: NDArray
    gradient: NDArray
    curvature: NDArray
    """(k, k) as the steps taught it"""
    gain: float
    """by how much the value would still fall within the bounds, were it quadratic"""


def search_quadratically(
    evaluate: Callable[[NDArray], tuple[float, NDArray]],
    x: NDArray,
    curvature: NDArray,
    lower: NDArray,
    upper: NDArray,
    arrived: float,
    most: int,
) -> Found:
    """The minimum near x (k,) of a function that gives its value and gradient (k,).

    It ends where less than `arrived` is to be gained, or after `most` steps, or where no step
    brings the value down; what is left is in `Found.gain`.
    """
    B = curvature
    value, g = evaluate(x)
    for _ in range(most):
        step, gain = _plan_step(x, g, B, lower, upper)
        if gain < arrived:
            break
        taken = None
        for _ in range(_TRIALS):
            trial = np.clip(x + step, lower, upper)
            new, new_g = evaluate(trial)
            fall = value - new
            calmer = _plan_step(trial, new_g, B, lower, upper)[1] < gain
            if np.isfinite(new) and (fall > 1e-4 * abs(g @ step) or (fall > -_NOISE and calmer)):
                taken = trial, new, new_g
                break
            step = _SHORTER * step
        if taken is None:
            break
        B = _update(B, taken[0] - x, taken[2] - g)
        x, value, g = taken
    return Found(x, g, B, _plan_step(x, g, B, lower, upper)[1])


def _plan_step(
    x: NDArray, g: NDArray, B: NDArray, lower: NDArray, upper: NDArray
) -> tuple[NDArray, float]:
    """The step (k,) to the minimum of the quadratic within the bounds, and what it gains."""
    step = np.zeros_like(x)
    free = ~(((x <= lower) & (g > 0)) | ((x >= upper) & (g < 0))) & (lower < upper)
    for _ in range(len(x)):
        step = np.zeros_like(x)
        part = np.ix_(free, free)
        step[free] = -np.linalg.solve(B[part], g[free]) if free.any() else 0.0
        # One at a bound that the others would take beyond it stays there.
        beyond = free & (((x <= lower) & (step < 0)) | ((x >= upper) & (step > 0)))
        if not beyond.any():
            break
        free = free & ~beyond
    gain = float(-0.5 * g @ step)
    length = np.sqrt(max(0.5 * step @ B @ step, 1e-300))
    share = min(1.0, _FARTHEST / length, _LONGEST / max(np.abs(step).max(initial=0.0), 1e-300))
    return share * step, gain


def _update(B: NDArray, step: NDArray, change: NDArray) -> NDArray:
    """The curvature (k, k) that explains how the gradient changed along a step (damped BFGS)."""
    along = B @ step
    size = step @ along
    if not size > 0:
        return B
    said = step @ change
    share = 1.0 if said >= _DAMPED * size else (1 - _DAMPED) * size / (size - said)
    change = share * change + (1 - share) * along
    return B - np.outer(along, along) / size + np.outer(change, change) / (step @ change)
