"""Where a reading determines mu_s: one speed at a time, on a fine grid of mu_s."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

JUMP = 2.0
"""A rise between neighbours that is off by more than this factor from the slopes' is a jump."""


class Line(NamedTuple):
    """The scaled inverse at one speed, where the reading determines mu_s."""

    X: NDArray
    """(2 n,) ends of n intervals of X = q / v, rising, an interval's two in turn"""
    y: NDArray
    """mu_s / v there"""
    length: NDArray
    """(2 n,) of X up to here that is determined"""

    @classmethod
    def of(cls, y: NDArray, X: NDArray, good: NDArray) -> Line:
        """From a grid of y (n,), its X, and which of the n - 1 intervals are good."""
        a, b = X[:-1][good], X[1:][good]
        ya, yb = y[:-1][good], y[1:][good]
        low = np.argsort(np.minimum(a, b), kind="stable")
        flip = b < a
        left, right = np.where(flip, b, a)[low], np.where(flip, a, b)[low]
        y_left, y_right = np.where(flip, yb, ya)[low], np.where(flip, ya, yb)[low]
        sizes = np.stack([np.zeros(len(left)), right - left], axis=1).ravel()
        ends = np.stack([left, right], axis=1).ravel()
        return cls(ends, np.stack([y_left, y_right], axis=1).ravel(), np.cumsum(sizes))

    def measure_cover(self, a: float, b: float) -> float:
        """The share of [a, b] that is determined."""
        if not len(self.X):
            return 0.0
        low, high = np.interp([a, b], self.X, self.length)
        return float((high - low) / (b - a))


def find_determined(q: NDArray, elasticity: NDArray, y: NDArray, least: float) -> NDArray:
    """Which intervals of a grid of mu_s (n - 1 of n points) one can tell by the reading q.

    There q exists, is monotone without a jump, changes by at least `least` of itself for a relative
    change of mu_s of 1 (`elasticity`, exact), and no other mu_s of the grid gives the same.
    """
    a, b, ea, eb = q[:-1], q[1:], elasticity[:-1], elasticity[1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        steep = (np.minimum(np.abs(ea), np.abs(eb)) >= least) & (ea * eb > 0) & (a > 0) & (b > 0)
        rise = np.log(b / a) / np.log(y[1:] / y[:-1])
        ratio = 2 * rise / (ea + eb)
        good = steep & (ratio > 1 / JUMP) & (ratio < JUMP)
    both = np.isfinite(a) & np.isfinite(b)
    low = np.sort(np.minimum(a, b)[both])
    high = np.sort(np.maximum(a, b)[both])
    middle = 0.5 * (a + b)
    count = np.searchsorted(low, middle, "left") - np.searchsorted(high, middle, "right")
    return good & (count == 1)
