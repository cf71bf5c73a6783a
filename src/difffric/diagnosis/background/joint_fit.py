"""The fit of the plain parameters and all small effects at once.

It begins where the plain fit ended, and from the set-up's own numbers with a horizon that grows:
first the samples up to a little after the first contact, at last all of them. What a push does
late depends on all that it did before; fitted all at once from afar, pushes that are caught again
and again lead nowhere.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.diagnosis.data import DiagnosisData
from difffric.diagnosis.starting_values import find_contact_time
from difffric.estimation import ensemble, ensemble_refits
from difffric.estimation.block_means import UnevenBlocks
from difffric.estimation.ensemble import EnsembleTask, Fits

WIDE = 3.0
"""Shares of their units by which small effects are assumed to scatter while they are fitted: more
than any background has, so that a cause among them is hardly held back."""
_ROUNDS, _AT_EACH_HORIZON = 15, 8
"""Steps at most of a joint fit, and at each horizon."""
_HORIZONS = (1.5, 4.0)
"""The first horizons, in times for which the part and the tip touch."""
_FIRST_SCATTER = 0.03
"""Relative scatter of mu_s from which a fit begins at the set-up's numbers."""
_NOISE_LEFT = 3.0
"""Squares per number up to which a fit leaves noise, and what is linear in small shapes."""


def leaves_noise(task: EnsembleTask, fits: Fits) -> bool:
    """Whether a fit (an ensemble of one) leaves hardly more than noise."""
    return measure_left(task, fits) < _NOISE_LEFT


def measure_left(task: EnsembleTask, fits: Fits) -> float:
    """The squared residuals per number, in units of the noise, that a fit (an ensemble of one)
    leaves."""
    rss = np.einsum("nk,k->", fits.gram[0, ..., -1, -1], fits.spread[0] ** -2.0)
    return float(rss / task.counts.sum())


def fit_jointly(data: DiagnosisData, small: SmallEffects, plain: Fits, guess: Fits) -> Fits:
    """Return the best joint fit, begun from the plain fit `plain` and, where that does not arrive,
    from `guess`, the set-up's own numbers (all ensembles of one)."""
    task = small.assume(data.task, WIDE)
    found = ensemble_refits.refit(task, small.free(plain), _ROUNDS)
    if leaves_noise(task, found) or data.reduction is None:
        return found
    scatter = np.maximum(guess.scatter, _FIRST_SCATTER)
    at = small.free(replace(guess, extra=plain.extra, scatter=scatter))
    contact = find_contact_time(data.scales)
    released = np.array([one.release_time for one in data.reduction.details])
    horizons = [np.full(task.n, x * contact) for x in _HORIZONS]
    horizons.append(np.where(np.isfinite(released), released, np.inf))
    for horizon in horizons:
        some = _cut_at(task, horizon)
        at = ensemble_refits.refit(some, _forget(at), _AT_EACH_HORIZON)
    at = ensemble_refits.refit(task, _forget(at), _ROUNDS)
    return min(found, at, key=lambda one: float(ensemble.criterion(task, one)[0]))


def _forget(fits: Fits) -> Fits:
    """The fits without their answers."""
    return replace(fits, gram=None, residual=None, damping=None)


def _cut_at(task: EnsembleTask, horizon: NDArray) -> EnsembleTask:
    """The task with the samples of each push up to its horizon (n,) [s] alone."""

    def cut(blocks: UnevenBlocks) -> UnevenBlocks:
        first, second = (np.take_along_axis(blocks.t, x, 1) for x in blocks[1:3])
        keep = 0.5 * (first + second) < horizon[:, None]
        return blocks._replace(a=np.where(keep, blocks.a, 0.0), b=np.where(keep, blocks.b, 0.0))

    both = tuple(cut(blocks) for blocks in task.model.pushes.data)
    counts = np.stack([(blocks.a > 0).sum(axis=1) for blocks in both], axis=1).astype(float)
    model = replace(task.model, pushes=task.model.pushes._replace(data=both))
    return replace(task, model=model, counts=counts)
