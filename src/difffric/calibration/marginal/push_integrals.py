"""The integral over each push's own mu_s, and how it changes with what is integrated.

Residuals are linear between the points of a grid, and the integral is exact for that: d may jump
and bend with mu_s, and a push may have several mu_s, without any point on the density's peak.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

_NOTHING = -1e6
"""Log of the density of what the model cannot give."""
_FLAT = 1e-12
"""A piece along which the residuals change by less than this is taken to change by it."""
_GENTLE = 2.0
"""Where the exponent changes by less than this along a piece, its moments are sums over points:
the closed form would lose digits."""
_POINTS, _SHARES = np.polynomial.legendre.leggauss(8)
_POINTS, _SHARES = 0.5 + 0.5 * _POINTS, 0.5 * _SHARES
_ROOT_2_PI = 0.5 * np.log(2 * np.pi)


class Integrals(NamedTuple):
    """Of n pushes, each over its own grid of points."""

    log: NDArray
    """(n,) log of the integral of exp(-|r|^2 / 2) / sqrt(2 pi)"""
    pull: NDArray
    """(points, n, rows) how -log changes with the residual of each row at each point: what the
    residuals are there, weighed by how likely the push's mu_s is there"""
    share: NDArray
    """(points - 1, n) how likely it is to lie between two points"""
    mean: NDArray
    """(n,) where it lies on average"""
    sd: NDArray
    """(n,) its standard deviation"""


def integrate_pieces(grid: NDArray, r: NDArray) -> Integrals:
    """Integrate over `grid` (points, n), ascending, where r (points, n, rows) is linear in between.

    Raises nothing: where all is far too small to be a number, log is -1e6.
    """
    a, step = r[:-1], r[1:] - r[:-1]
    width = grid[1:] - grid[:-1]
    bend = np.maximum(np.sqrt(np.einsum("knr,knr->kn", step, step)), _FLAT)
    low = np.einsum("knr,knr->kn", a, step) / bend
    high = low + bend
    log_mass = _log_normal_mass(low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        rest = 0.5 * (low**2 - np.einsum("knr,knr->kn", a, a))
        log = np.log(width / bend) + rest + log_mass
    # (SciPy's annotation says that two numbers may come back; only one does.)
    total: Any = scipy.special.logsumexp(np.where(np.isfinite(log), log, -np.inf), axis=0)
    total = np.maximum(total, _NOTHING)
    share = np.where(np.isfinite(log), np.exp(np.minimum(log - total, 0.0)), 0.0)
    first, second = _find_moments(low, bend, log_mass)
    right = _weigh(a, step, share, first, second)
    left = _weigh(a, step, share, 1.0 - first, first - second)
    pull = np.zeros_like(r)
    pull[:-1] += left
    pull[1:] += right
    known = np.maximum(share.sum(axis=0), 1e-300)
    mean = np.sum(share * (grid[:-1] + width * first), axis=0) / known
    off = grid[:-1] - mean
    square = np.sum(share * (off**2 + 2 * off * width * first + width**2 * second), axis=0)
    return Integrals(total, pull, share, mean, np.sqrt(np.maximum(square / known, 0.0)))


def _weigh(a: NDArray, step: NDArray, share: NDArray, w: NDArray, wt: NDArray) -> NDArray:
    """(pieces, n, rows) the mean of the residual times a weight of mean `w`, whose mean with the
    place along the piece is `wt`, times the piece's share."""
    return a * (share * w)[..., None] + step * (share * wt)[..., None]


def _log_normal_mass(low: NDArray, high: NDArray) -> NDArray:
    """Log of the normal distribution's mass between low and high."""
    # The tail in which both ends are small in absolute size loses no digits.
    left, right = np.where(low > 0, -high, low), np.where(low > 0, -low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        top = scipy.special.log_ndtr(right)
        tail = np.minimum(scipy.special.log_ndtr(left) - top, -1e-16)
        return top + np.log(-np.expm1(tail))


def _find_moments(low: NDArray, bend: NDArray, log_mass: NDArray) -> tuple[NDArray, NDArray]:
    """The means of t and t^2, where low + bend t is normal and t lies between 0 and 1."""
    with np.errstate(over="ignore", invalid="ignore"):
        at_low = np.exp(-0.5 * low**2 - _ROOT_2_PI - log_mass)
        at_high = np.exp(-0.5 * (low + bend) ** 2 - _ROOT_2_PI - log_mass)
        ahead = at_low - at_high - low
        first = ahead / bend
        second = (1.0 - at_high * bend - low * ahead) / bend**2
    gentle = bend * (np.abs(low) + bend) < _GENTLE
    lo, by = low[gentle][:, None], bend[gentle][:, None]
    density = _SHARES * np.exp(-by * _POINTS * (lo + 0.5 * by * _POINTS))
    density /= density.sum(axis=1, keepdims=True)
    first[gentle], second[gentle] = density @ _POINTS, density @ _POINTS**2
    first = np.clip(np.nan_to_num(first, nan=0.5), 0.0, 1.0)
    return first, np.clip(np.nan_to_num(second, nan=0.3), first**2, first)
