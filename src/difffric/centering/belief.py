"""What is known of mu_s before the next push, from the pushes before it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.errors import InputError

_LOG = np.linspace(np.log(0.01), np.log(2.0), 2048)
"""The grid: steps of 0.26 % over all mu_s that parts have."""
_STEP = _LOG[1] - _LOG[0]


@dataclass(frozen=True)
class Belief:
    """A probability density of the mean of mu_s, on a grid of its logarithm.

    A push has a mu_s of its own about that mean (`scatter` is its relative standard deviation), and
    from push to push the mean wanders (by `drift`, likewise). What a push says is taken in by
    Bayes' rule for a local level with noise, in the logarithm: as Kalman's filter does, but for
    densities that are not normal.
    """

    weight: NDArray
    """(2048,) sums to one"""
    scatter: float
    drift: float = 0.0

    @classmethod
    def uniform(cls, lower: float, upper: float, scatter: float, drift: float = 0.0) -> Belief:
        """Know that mu_s is between two values, anywhere as likely.

        Raises `InputError` for values that are not within 0.01 to 2, the lower first.
        """
        if not 0.01 <= lower < upper <= 2.0:
            raise InputError(
                f"range of mu_s: expected 0.01 <= lower < upper <= 2, got {lower:g} and {upper:g}"
            )
        edges = np.exp(np.append(_LOG - _STEP / 2, _LOG[-1] + _STEP / 2))
        inside = np.diff(np.clip(edges, lower, upper))  # its share of a step, in mu_s
        return cls(inside / inside.sum(), scatter, drift)

    @classmethod
    def normal(cls, mean: float, error: float, scatter: float, drift: float = 0.0) -> Belief:
        """Know the mean with a relative standard error."""
        return cls(_make_normal(np.log(mean), error), scatter, drift)

    @property
    def next_push(self) -> NDArray:
        """(2048,) probability of the next push's own mu_s, on the grid `mu_s`."""
        return _blur(self.weight, np.hypot(self.scatter, self.drift))

    @property
    def mu_s(self) -> NDArray:
        """(2048,) the grid that the probabilities stand on."""
        return np.exp(_LOG)

    def quantiles(self, share: NDArray) -> NDArray:
        """Return the values below which the next push's mu_s is with the probabilities `share`."""
        return np.exp(_find_quantiles(self.next_push, share))

    @property
    def mean(self) -> tuple[float, float]:
        """The median of the mean of mu_s, and its relative standard deviation."""
        median = _find_quantiles(self.weight, np.array([0.5]))[0]
        return float(np.exp(median)), _find_deviation(self.weight)

    def update_with_value(self, mu_s: float, error: float) -> Belief:
        """Return what is known after a push whose own mu_s was found, with a relative standard
        error."""
        wandered = _blur(self.weight, self.drift)
        found = wandered * _make_normal(np.log(mu_s), np.hypot(error, self.scatter))
        if not found.sum() > 0:  # nothing that was held possible: begin anew from the push
            found = _make_normal(np.log(mu_s), np.hypot(error, self.scatter))
        return replace(self, weight=found / found.sum())

    def update_with_likelihood(self, log_mu_s: NDArray, likelihood: NDArray) -> Belief:
        """Return what is known after a push whose readings have the likelihood (n,) at logarithms
        (n,) of its own mu_s. These rise by equal steps; beyond their ends it is as at the ends."""
        edges = np.append(_LOG, _LOG[-1] + _STEP) - _STEP / 2
        area = np.concatenate([[0.0], np.cumsum(likelihood)])
        step = log_mu_s[1] - log_mu_s[0]
        at = np.append(log_mu_s, log_mu_s[-1] + step) - step / 2
        inside = np.diff(np.interp(edges, at, area))
        inside = np.where(_LOG < at[0], likelihood[0] * _STEP / step, inside)
        inside = np.where(_LOG > at[-1], likelihood[-1] * _STEP / step, inside)
        wandered = _blur(self.weight, self.drift)
        # A push that contradicts all that was known still counts, if not against one that fits.
        wandered = wandered + 1e-9 * wandered.max()
        found = wandered * _blur(inside, self.scatter)
        return replace(self, weight=found / found.sum())

    def foresee(self) -> Belief:
        """Return what is likely to be known after one more push, about the same median."""
        _, known = self.mean
        told = max(self.scatter, _STEP)
        spread = np.hypot(known * told / np.hypot(known, told), self.drift)
        median = _find_quantiles(self.weight, np.array([0.5]))[0]
        return replace(self, weight=_make_normal(median, spread))


def _make_normal(centre: float, deviation: float) -> NDArray:
    """A normal density on the grid; what is narrower than a step fills one."""
    at = (np.append(_LOG, _LOG[-1] + _STEP) - _STEP / 2 - centre) / max(deviation, 0.5 * _STEP)
    weight = np.diff(scipy.special.ndtr(at))
    return weight / weight.sum() if weight.sum() > 0 else weight


def _blur(weight: NDArray, deviation: float) -> NDArray:
    """Return a density on the grid after a normal deviation of the logarithm is added."""
    if deviation <= 1e-3 * _STEP:
        return weight
    half = min(int(np.ceil(6 * deviation / _STEP)), len(_LOG) // 2 - 1)
    edges = (np.arange(-half, half + 2) - 0.5) * _STEP
    kernel = np.diff(scipy.special.ndtr(edges / deviation))
    out = np.convolve(weight, kernel, mode="same")
    return out * (weight.sum() / out.sum())


def _find_quantiles(weight: NDArray, share: NDArray) -> NDArray:
    """Return the logarithms below which a density on the grid has the shares (n,)."""
    below = np.concatenate([[0.0], np.cumsum(weight)])
    below /= below[-1]
    edges = np.append(_LOG, _LOG[-1] + _STEP) - _STEP / 2
    kept = np.concatenate([[True], np.diff(below) > 0])
    return np.interp(share, below[kept], edges[kept])


def _find_deviation(weight: NDArray) -> float:
    """Return the standard deviation of the logarithm, of a density on the grid."""
    mean = weight @ _LOG
    return float(np.sqrt(weight @ (_LOG - mean) ** 2))
