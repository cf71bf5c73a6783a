"""What an effect changes: the mu_s that is inferred, F_p and d."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.inferred.friction import find_friction
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import CUTTING, numbers_of

_STEP = 1e-3
"""Relative change of mu_s by which F_p and d are differentiated: far above the error with which
a push is followed, and so small that nothing but the slope is seen."""
_TELLS = 0.1
"""Relative change of F_p, or of d, by that of mu_s: below, nobody infers mu_s from it."""
_OF_CUTTING = 0.5
"""Share that counts of what an effect that cuts pushes short changes of F_p or d: a few of them all
at once, several times as much as by itself where other effects make the tip late."""
_STEEP = 3.0
"""How many times as steep as most a push is at most, in its d or F_p by mu_s."""


@dataclass(frozen=True)
class Changes:
    """What an effect changes: relative, root mean square over the pushes."""

    mu_s: float
    """of the mu_s that is inferred, all that is free fitted anew without the effect"""
    peak_force: float
    """of F_p, all else as it is"""
    sliding_distance: float
    """of d likewise"""
    as_mu_s: float
    """the largest of the three as a share of mu_s: F_p and d count as the change of mu_s that
    changes them as much"""
    of_most: float
    """the larger of those of F_p and d, without the push that changes most; half of that for an
    effect that cuts pushes short"""

    def count_reading(self, effect: str, usual: bool) -> float:
        """The change of F_p or d that counts beside small effects: without the push that changes
        most for an `effect` that may be one of them (`usual`), or that cuts pushes short."""
        most = usual or effect in CUTTING
        return self.of_most if most else max(self.peak_force, self.sliding_distance)


class ReadingChanges(NamedTuple):
    """By what F_p and d are others, rms over the pushes."""

    force: float
    distance: float
    as_mu_s: float
    """the share of mu_s that makes one of them so much another"""
    of_most: float
    """the larger of the two, without the push that changes most: it may be on an edge"""


def measure_changes(task: EnsembleTask, without: Fits, at: Fits, effect: str) -> Changes:
    """Measure what an effect changes in the fit `at`; `without` is a fit that lacks it (both
    ensembles of one).

    Pushes without a d, with the effect or without it, say nothing of d.
    """
    index = task.model.coordinates.indices(numbers_of(effect))
    c = np.repeat(at.c, task.n, axis=0)
    c[:, 0] = at.mu[0, task.condition] + at.own[0]
    lacking = c.copy()
    lacking[:, index] = without.c[0, index]
    readings = compare_readings(task, c, lacking)
    moved = _take_rms(find_friction(task, at) - find_friction(task, without))
    as_mu_s = max(moved, readings.as_mu_s)
    of_most = readings.of_most * (_OF_CUTTING if effect in CUTTING else 1.0)
    return Changes(moved, readings.force, readings.distance, as_mu_s, of_most)


def compare_readings(task: EnsembleTask, c: NDArray, lacking: NDArray) -> ReadingChanges:
    """Return by what share F_p and d of the n pushes are others at coordinates c (n, K) than at
    `lacking` (n, K)."""
    n = task.n
    points = np.stack([c, lacking, c, c])
    points[2:, :, 0] += np.array([[_STEP], [-_STEP]])
    none = np.zeros((0, c.shape[1]))
    answers = task.model.answers(np.tile(np.arange(n), 4), points.reshape(4 * n, -1), none)
    there, without_it, up, down = answers.model.reshape(4, n, 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        change = there / without_it - 1
        slope = (up - down) / (2 * _STEP * there)
    force, distance = (_take_rms(x) for x in change.T)
    slopes = (max(_take_rms(_cut_jumps(x)), _TELLS) for x in slope.T)
    by_force, by_distance = (x / y for x, y in zip((force, distance), slopes, strict=True))
    of_most = max(_take_rms(np.sort(np.abs(x[np.isfinite(x)]))[:-1]) for x in change.T)
    return ReadingChanges(force, distance, max(by_force, by_distance), of_most)


def _cut_jumps(slope: NDArray) -> NDArray:
    """Return the slopes (n,), none much larger than most: a push on the edge of being caught once
    more has any."""
    size = np.abs(slope)
    usual = np.median(size[np.isfinite(size)]) if np.isfinite(size).any() else 0.0
    return np.minimum(size, _STEEP * usual)


def _take_rms(x: NDArray) -> float:
    """Return the root mean square of what is finite of x (n,), 0 where nothing is."""
    x = x[np.isfinite(x)]
    return float(np.sqrt(np.mean(x**2))) if len(x) else 0.0
