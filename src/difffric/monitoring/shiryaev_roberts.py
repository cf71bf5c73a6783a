"""Evidence that standard normal numbers have changed: a mixture of Shiryaev-Roberts statistics, and
the threshold that gives it a stated average run length.

For each direction and size delta in which a mean may change, in standard deviations,

    R_n = (1 + R_(n-1)) exp(delta z_n - delta^2 / 2),   R_0 = 0,

which is the likelihood ratio of a change by delta against none, summed over all times at which it
may have come. The statistic is the mean of all R_n. As long as nothing has changed its expectation
grows by one a push, whatever the directions have in common, so that the mean number of pushes
between false alarms is never below the threshold (Pollak, Annals of Statistics 13, 1985). By how
much it is above follows from the overshoot (Siegmund, Sequential Analysis, 1985, chapter VIII).
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

SIZES = (0.5, 1.0, 2.0)
"""Changes of the mean that are looked for [standard deviations]: drifts to large steps."""
CHANNELS = ("friction", "contrast")
"""The two numbers of a push, each held against those before."""
DIRECTIONS = ("friction up", "friction down", "contrast up", "contrast down")
FARTHEST = 4.0
"""Standard deviations; a number further out counts as this. So one wild push alone is no alarm, but
two are."""

_SIGN = np.array([1.0, -1.0, 1.0, -1.0])
_DELTA = _SIGN[:, None] * np.array(SIZES)
_CHANNEL = np.array([0, 0, 1, 1])


def start() -> NDArray:
    """Return the logarithms of R (directions, sizes) before the first push."""
    return np.full(_DELTA.shape, -np.inf)


def update(log_R: NDArray, z: NDArray) -> NDArray:
    """Return the logarithms of R (..., directions, sizes) after a push's numbers z (..., channels).

    NaN in z: the push says nothing of that channel.
    """
    own = np.clip(z, -FARTHEST, FARTHEST)[..., _CHANNEL, None]
    new = np.logaddexp(0.0, log_R) + _DELTA * own - 0.5 * _DELTA**2
    return np.where(np.isnan(own), log_R, new)


def by_direction(log_R: NDArray) -> NDArray:
    """The logarithm of each direction's share of the statistic (..., directions), from log R."""
    return scipy.special.logsumexp(log_R, axis=-1) - np.log(_DELTA.size)


def total(log_R: NDArray) -> NDArray:
    """The logarithm of the statistic (...), from those of R (..., directions, sizes)."""
    return scipy.special.logsumexp(log_R, axis=(-2, -1)) - np.log(_DELTA.size)


def overshoot(delta: float) -> float:
    """lim E exp(-overshoot) of the random walk delta z - delta^2 / 2 whose mean has changed by
    delta: 2 / delta^2 exp(-2 sum_n Phi(-delta sqrt(n) / 2) / n), about exp(-0.583 delta)
    (Siegmund 1985, 4.37)."""
    n = np.arange(1.0, 10.0 + 400.0 / delta**2)  # beyond, Phi is below 1e-22
    terms = np.exp(scipy.special.log_ndtr(-0.5 * delta * np.sqrt(n))) / n
    return float(2.0 / delta**2 * np.exp(-2.0 * terms.sum()))


def log_threshold(run_length: float) -> float:
    """The logarithm of the threshold at which the mean number of pushes between false alarms is
    `run_length`: each part crosses by itself, at a rate of its overshoot over the threshold."""
    return float(np.log(run_length * np.mean([overshoot(delta) for delta in SIZES])))
