"""The fit of the plain parameters and all small effects at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.evidence import Evidence, PossibleCause
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.diagnosis.data import DiagnosisData, choose_subset, move_unseen
from difffric.estimation.ensembles import ensemble, ensemble_refits
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits

WIDE = 3.0
"""Shares of their units by which small effects are assumed to scatter while they are fitted: more
than any background has, so that a cause among them is hardly held back."""
LEAST_SHARE = 0.1
"""The share of their units by which the background is assumed to scatter at least, while a set of
causes is fitted."""
_FIRST_ROUNDS, _ROUNDS = 6, 15
"""Steps at most of a joint fit, first from the plain fit."""
ROUGHLY = 1.0
"""What a step has to gain in chi-square, while more is to come."""
_FEW, _LEADERS, _MORE = 2, 2, 8
"""Steps of fits from several starts on some of the pushes, those of them that are fitted to all
pushes, and the steps of these at most."""
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


def fit_jointly(data: DiagnosisData, small: SmallEffects, plain: Fits) -> Fits:
    """Return the joint fit to which the plain fit `plain` leads (both ensembles of one)."""
    task = small.assume(data.task, WIDE)
    found = ensemble_refits.refit(task, small.free(plain), _FIRST_ROUNDS, tol=ROUGHLY)
    if leaves_noise(task, found) or data.reduction is None:
        return ensemble_refits.refit(task, found, _ROUNDS)
    return found


def fit_best(task: EnsembleTask, starts: Sequence[Fits]) -> tuple[Fits, int]:
    """Return the best fit to which the `starts` lead, and the number of its start: a few steps from
    each with some of the pushes, then those that lead with all."""
    return follow_leaders(task, try_starts(task, starts)[0])


def try_starts(task: EnsembleTask, starts: Sequence[Fits]) -> tuple[Fits, NDArray]:
    """Return the fits after a few steps from each of the `starts` with some of the pushes, and the
    squares per number (m,) that they leave of these."""
    some = choose_subset(task) if task.model.recordings else np.arange(task.n)
    before = ensemble.join(*starts)
    fits = ensemble_refits.refit(task, before, _FEW, some)
    left = ensemble.sum_squares(task, fits, some) / task.counts[some].sum()
    return move_unseen(task, fits, before, some), left


def follow_leaders(task: EnsembleTask, fits: Fits) -> tuple[Fits, int]:
    """Return the best fit to all pushes to which the `fits` lead, which are to some of the pushes:
    the best few of them go on; and the number of the one that led there."""
    leaders = np.argsort(ensemble.criterion(task, fits))[:_LEADERS]
    ahead = replace(fits.pick(leaders), gram=None, residual=None, damping=None)
    fits = ensemble_refits.refit_past_jumps(task, ahead, _MORE, tol=ROUGHLY)
    best = int(np.argmin(ensemble.criterion(task, fits)))
    return fits.pick(best), int(leaders[best])


def free_causes(
    task: EnsembleTask, small: SmallEffects, evidence: Evidence, items: Sequence[PossibleCause]
) -> EnsembleTask:
    """Return the task of fits in which the `items` have any size, and the other small effects
    scatter as the evidence says."""
    share = max(evidence.estimate_share(items), LEAST_SHARE)
    free = {item.effect for item in items}
    causes = {i for i, effect in zip(small.index, small.effects, strict=True) if effect in free}
    return small.assume(task, share, causes)
