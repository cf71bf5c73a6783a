"""Whether a fit leaves more than noise, and where: by channel, phase, speed, push."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits

BINS = 12
"""Stretches that each channel of a push is cut into: a misfit lasts longer than a sample."""
_LINEAR = 0.3
"""Excess of chi-square over what noise would leave, as a share of that, up to which an effect is
taken for so small that the answers are linear in it."""
_BY_CHANCE = 3.0
"""Standard deviations of chi-square by which it may be larger than noise would leave."""


@dataclass(frozen=True)
class LackOfFit:
    """What a fit leaves, and how probable it is that noise alone does."""

    p_value: float | None
    """None: the noise is not known, and nothing can be said"""
    excess: float
    """chi-square less what noise alone would leave"""
    expected: float
    """what noise alone would leave"""
    chi2: NDArray
    """(n, 2) of each push and channel"""


def is_misfit_large(task: EnsembleTask, fits: Fits) -> bool:
    """Whether a fit (an ensemble of one) leaves so much, relative to the noise, that what is
    linear at an effect's null is not to be trusted; or nothing is known of the noise."""
    left = measure_lack_of_fit(task, fits)
    by_chance = _BY_CHANCE * np.sqrt(2 * left.expected)  # of a table's few numbers
    few = left.excess <= _LINEAR * left.expected + by_chance  # a push that is not followed has none
    return left.p_value is None or not few


def measure_lack_of_fit(task: EnsembleTask, fits: Fits) -> LackOfFit:
    """Test the residuals of a fit (an ensemble of one) where it stands.

    Recordings are tested by sums over stretches of each push, a table by its numbers and by how
    each push's own mu_s scatters.
    """
    r = fits.residual[0] / fits.spread[0][None, :, None]
    chi2 = (r**2).sum(axis=2)
    numbers = task.counts.sum()
    fitted = task.conditions * task.mu_free + len(task.shared) + len(fits.extra[0])
    own = task.n * task.mu_free
    recordings = task.model.recordings
    zeros = task.n if recordings else 0
    expected = max(numbers - fitted - own - zeros, 1.0)
    excess = float(chi2.sum() - expected)
    if any(task.open_spread):
        return LackOfFit(None, excess, float(expected), chi2)
    if not recordings:
        total = float(chi2.sum() + ((fits.own[0] / fits.scatter[0]) ** 2).sum())
        freedom = max(numbers - fitted, 1.0)
    else:
        total, count = _sum_stretches(task, r)
        freedom = max(count - fitted - own - zeros, 1)
    return LackOfFit(float(scipy.stats.chi2.sf(total, freedom)), excess, float(expected), chi2)


def _sum_stretches(task: EnsembleTask, r: NDArray) -> tuple[float, int]:
    """Return chi-square of the sums of residuals over stretches of each push, and how many there
    are; `r` (n, 2, blocks) are the residuals in standard deviations."""
    there = np.stack([blocks.a > 0 for blocks in task.model.pushes.data], axis=1)
    total, count = 0.0, 0
    for i in range(task.n):
        for k in (0, 1):
            mine = r[i, k][there[i, k]]
            for part in np.array_split(mine, BINS):
                if len(part):
                    total += part.sum() ** 2 / len(part)
                    count += 1
    return total, count
