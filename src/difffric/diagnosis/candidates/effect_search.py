"""The search for one effect more on top of a fit: its starts, and what a step from them
promises."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.score_test import Score, step_off_null
from difffric.diagnosis.shape_scan import SHAPED, scan_shapes
from difffric.diagnosis.starting_values import list_starting_values
from difffric.estimation.ensembles import ensemble, ensemble_refits
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import RATIO, numbers_of
from difffric.rig.scales import Scales

_BLIND = 1.0
"""Standard deviations at its typical size below which an effect's score test sees nothing."""


@dataclass(frozen=True)
class EffectSearch:
    """What the two searches are given."""

    task: EnsembleTask
    base: Fits
    """an ensemble of one: the model that the effects are added to"""
    effects: list[str]
    scales: Scales
    scores: Mapping[str, Score]
    tell: Callable[[float], object]
    """is called with the share that is done"""
    most: float = np.inf
    """times the noise that an effect may leave once it has been looked for"""

    @property
    def by_score(self) -> list[str]:
        """The effects that have a score test, the largest predicted drop first."""
        known = (effect for effect in self.effects if effect in self.scores)
        return sorted(known, key=lambda effect: -self.scores[effect].drop)

    def is_blind(self, effect: str) -> bool:
        """Whether an effect's score test is missing or sees nothing of it."""
        return effect not in self.scores or self.scores[effect].visible < _BLIND


def make_starts(
    task: EnsembleTask, base: Fits, effect: str, scales: Scales, some: NDArray, far: bool = True
) -> Fits:
    """Return starts for one effect on top of `base` (an ensemble of one), at each of the sizes that
    it may have."""
    if effect in SHAPED:
        return scan_shapes(task, base, effect, scales, some, far)
    coordinates = task.model.coordinates
    values = list_starting_values(effect, scales, closely=True)
    rows = np.array([coordinates.point(one) for one in values])
    fits = place_effect(task, base, effect, rows)
    if effect == RATIO:  # what slides stays as it is, and mu_s with what sticks moves
        mine = coordinates.indices(numbers_of(effect))
        fits = replace(fits, mu=fits.mu - (rows - base.c[:, mine]))
    return fits


def start_from_scores(search: EffectSearch, effects: Iterable[str]) -> tuple[Fits, list[str]]:
    """Return starts where the score tests lead, the rest of the model where it would be beside
    each effect; and the names of their effects, which are those that explain anything."""
    task, base, scores = search.task, search.base, search.scores
    known = [effect for effect in effects if effect in scores and scores[effect].drop > 0]
    if not known:
        return base.pick(np.zeros(0, int)), known
    parts = []
    for effect in known:
        index = task.model.coordinates.indices(numbers_of(effect))
        at_null = place_effect(task, base, effect, base.c[:, index])
        parts.append(step_off_null(task, at_null))
    fits = ensemble.evaluate(task, ensemble.join(*parts))
    return replace(ensemble_refits.take_step(task, fits, 0.0), residual=None), known


def place_effect(task: EnsembleTask, base: Fits, effect: str, rows: NDArray) -> Fits:
    """Repeat `base` with the coordinates of an effect, which are free, at each of `rows`
    (m, numbers)."""
    index = task.model.coordinates.indices(numbers_of(effect))
    fits = base.pick(np.zeros(len(rows), int))
    c = fits.c.copy()
    c[:, index] = rows
    extra = ((*base.extra[0], *index),) * len(rows)
    return replace(fits, extra=extra, c=c, gram=None, residual=None, damping=None)


def predict_cost(task: EnsembleTask, fits: Fits) -> tuple[NDArray, NDArray]:
    """Return the (m,) costs as they stand, and what one step promises that they would be."""
    cost = ensemble.normal_equations(task, fits).cost
    return cost, cost - np.maximum(ensemble_refits.predict_gain(task, fits), 0.0)


def predict_criterion(task: EnsembleTask, fits: Fits) -> NDArray:
    """Return the (m,) -2 log likelihoods that one step promises: an effect that leaves less scatter
    may leave no smaller squares."""
    z = ensemble.normal_equations(task, fits).z
    return predict_cost(task, fits)[1] + ensemble.compute_volume(task, fits, z)


def find_best_of_each(cost: NDArray, owner: Iterable[Hashable]) -> list[int]:
    """Return the number of the least cost of each owner, in the order in which owners come."""
    best: dict[Hashable, int] = {}
    for j, k in enumerate(owner):
        if k not in best or cost[j] < cost[best[k]]:
            best[k] = j
    return list(best.values())
