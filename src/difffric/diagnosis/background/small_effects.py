"""The effects that every rig has a little of, and what "a little" is of each.

Every real machine has every imperfection: none of them is exactly at its null. All effects of the
catalogue that have a derivative at their null are therefore in the model at once, each with a size
of its own, which is assumed to be small: normal about the null, with the same share of the size
that changes F_p or d by as much as matters.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.score_test import OFF_NULL
from difffric.diagnosis.starting_values import SMOOTH_AT_NULL
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import RATIO, numbers_of

UNIT_CHANGE = 0.005
"""Relative change of F_p or d (rms over the pushes) that an effect of unit size makes."""
_RATIO_TYPICAL = 0.1
"""The relative change of mu_k / mu_s that one may meet; other effects' coordinates are 1 at such a
size."""
_LARGEST = 2.0
"""Times a size that one may meet: the largest unit, of an effect that changes neither F_p nor d."""
_FARTHEST, _UNSEEN_FARTHEST = 2.0, 5.0
"""Times a size that one may meet, beyond which an effect is not small; and one that changes neither
F_p nor d, of which nobody knows."""
_AT_REACH = 0.999
"""The share of that from which on an effect is there."""
_STEPS = 0.1, 0.01
"""Shares of such a size by which an effect is moved to see what it changes."""
_FAR_STEPS = np.array([0.25, 0.5, 1.0, 2.0, 5.0])
"""The same of effects that steps of this length hardly show."""
_LONG_STEP = {"pusher_lag": 0.5}
"""The same of an effect that is not seen where it is shorter than an integrator's step."""
_MOVED, _STEEP = 1e-3, 5.0
"""The share of the largest change from which on a push changes, and how many times as much as most
it may count."""


@dataclass(frozen=True)
class SmallEffects:
    """Effects that are in a model with sizes that are assumed to be small; p coordinates."""

    effects: tuple[str, ...]
    """(p,) the effect behind each coordinate: all have one number"""
    index: tuple[int, ...]
    """(p,) which coordinates"""
    unit: NDArray
    """(p,) the steps of these coordinates at which each effect has unit size"""
    typical: NDArray
    """(p,) the steps at which it has a size that one may meet"""
    null: NDArray
    """(K,) all coordinates where nothing moves them"""
    start: NDArray
    """(K,) the same with those a little beside their nulls that have no derivative there"""
    usual: NDArray | None = None
    """(p,) the steps at which each changes F_p or d by as much as matters, however large they are;
    None: the units"""
    reach: tuple[tuple[int, float], ...] = ()
    """of other coordinates that may not go anywhere how far from zero they may"""

    def assume(
        self, task: EnsembleTask, share: float, causes: Collection[int] = ()
    ) -> EnsembleTask:
        """Return the task of fits in which these effects scatter by `share` of their units about
        their nulls, but for the coordinates of `causes`."""
        free = [k for k, i in enumerate(self.index) if i not in causes]
        index = np.array(self.index, int)[free]
        prior, reach = np.zeros(len(self.null)), np.full(len(self.null), np.inf)
        prior[index] = (share * self.unit[free]) ** -2.0
        reach[index] = self._measure_reach()[free]
        for i, far in self.reach:
            reach[i] = far
        return replace(task, prior=prior, prior_about=self.null, reach=reach)

    def _measure_reach(self) -> NDArray:
        """How far (p,) from their nulls these effects may be while they are small."""
        unseen = self.unit >= _LARGEST * self.typical
        return np.where(unseen, _UNSEEN_FARTHEST, _FARTHEST) * self.typical

    def list_at_reach(self, at: Fits) -> frozenset[int]:
        """List the coordinates of effects that are as far from their nulls in a fit (an ensemble of
        one) as they may be while they are small: they want to be larger."""
        index = np.array(self.index, int)
        away = np.abs(at.c[0, index] - self.null[index])
        return frozenset(index[away >= _AT_REACH * self._measure_reach()].tolist())

    def free(self, fits: Fits) -> Fits:
        """Return the fits with these effects free beside what is free already."""
        extra = tuple((*own, *(i for i in self.index if i not in own)) for own in fits.extra)
        c = fits.c.copy()
        at_null = [i for i in self.index if not fits.c[:, i].any()]
        c[:, at_null] = self.start[at_null]
        return replace(fits, c=c, extra=extra, gram=None, residual=None, damping=None)


def step_off_null(task: EnsembleTask, at: Fits, index: Sequence[int]) -> NDArray:
    """Return the coordinates (1, K) of a fit (an ensemble of one), those of `index` that have no
    derivative at their null a little beside it."""
    c = at.c.copy()
    for i in index:
        c[0, i] = max(c[0, i], OFF_NULL.get(task.model.coordinates.names[i], -np.inf))
    return c


def choose_small_effects(task: EnsembleTask, at: Fits, effects: Sequence[str]) -> SmallEffects:
    """Choose those of the `effects` that can be in the model in small sizes, and measure their
    units where the fit `at` (an ensemble of one) stands."""
    coordinates = task.model.coordinates
    taken = {*task.shared, *at.extra[0]}
    chosen, index = [], []
    for effect in effects:
        own = coordinates.indices(numbers_of(effect))
        if effect in SMOOTH_AT_NULL and len(own) == 1 and own[0] not in taken:
            chosen.append(effect)
            index.append(own[0])
    typical = np.array([_RATIO_TYPICAL if effect == RATIO else 1.0 for effect in chosen])
    start = step_off_null(task, at, index)[0]
    unknown = np.zeros(len(index))
    small = SmallEffects(tuple(chosen), tuple(index), unknown, typical, at.c[0].copy(), start)
    return measure_units(task, at, small)


def measure_units(task: EnsembleTask, at: Fits, small: SmallEffects) -> SmallEffects:
    """Return the small effects with their units where the fit `at` (an ensemble of one) stands.

    The change of each push is that by a step or by a shorter one, whichever is smaller by a unit:
    a push on an edge, to be caught once more, jumps by one of them.
    """
    slopes, index = [], list(small.index)
    for length in _STEPS:
        step = small.typical * np.array([_LONG_STEP.get(x, length) for x in small.effects])
        points = np.repeat(at.c, len(index), axis=0)
        points[np.arange(len(index)), index] += step
        slopes.append(np.abs(observe_points(task, at, points)) / step[:, None, None])
    change = measure_change(np.fmin(*slopes))
    usual = UNIT_CHANGE / np.maximum(change, 1e-12)
    bent = np.flatnonzero(usual > _LARGEST * small.typical)
    if len(bent):
        usual[bent] = np.minimum(usual[bent], _find_sizes_that_matter(task, at, small, bent))
    return replace(small, unit=np.minimum(_LARGEST * small.typical, usual), usual=usual)


def _find_sizes_that_matter(
    task: EnsembleTask, at: Fits, small: SmallEffects, which: NDArray
) -> NDArray:
    """Return the sizes (m,) from which on some of the effects, their numbers `which` (m,), change
    F_p or d by as much as matters, infinite where none does: a low-pass moves the top of a smooth
    peak by the square of its time."""
    points = np.repeat(at.c, len(which) * len(_FAR_STEPS), axis=0)
    steps = np.multiply.outer(small.typical[which], _FAR_STEPS)
    points[np.arange(len(points)), np.repeat(np.array(small.index)[which], len(_FAR_STEPS))] += (
        steps.ravel()
    )
    change = measure_change(observe_points(task, at, points)).reshape(steps.shape)
    growing = np.maximum.accumulate(np.maximum(change, 1e-12), axis=1)
    return np.array(
        [
            np.exp(np.interp(np.log(UNIT_CHANGE), np.log(x), np.log(size), right=np.inf))
            for x, size in zip(growing, steps, strict=True)
        ]
    )


def observe_points(task: EnsembleTask, at: Fits, points: NDArray) -> NDArray:
    """Return the relative changes (m, n, 2) of F_p and d of each push where coordinates other than
    mu_s are at `points` (m, K) in place of those of the fit `at` (an ensemble of one)."""
    _, model = ask_at(task, at, np.concatenate([at.c, points]))
    with np.errstate(invalid="ignore", divide="ignore"):
        return model[1:] / model[0] - 1


def ask_at(task: EnsembleTask, at: Fits, points: NDArray) -> tuple[NDArray, NDArray]:
    """Return what all pushes answer at each of the `points` (m, K), mu_s as the fit `at` (an
    ensemble of one) has it: the residuals (m, n, 2, R) in units of the noise, and F_p and d
    (m, n, 2)."""
    n, size = task.n, len(points)
    r, model = ask_pushes(task, at, np.tile(np.arange(n), size), np.repeat(points, n, axis=0))
    return r.reshape(size, n, 2, -1), model.reshape(size, n, 2)


def ask_pushes(
    task: EnsembleTask, at: Fits, index: NDArray, points: NDArray
) -> tuple[NDArray, NDArray]:
    """Return the same for pushes `index` (N,), each at its own one of the `points` (N, K):
    (N, 2, R) and (N, 2)."""
    c = points.copy()
    c[:, 0] = (at.mu[0, task.condition] + at.own[0])[index]
    found = task.model.answers(index, c, np.zeros((0, points.shape[1])))
    r = found.residual[..., : count_rows(task)]
    return r / at.spread[0][:, None], found.model


def count_rows(task: EnsembleTask) -> int:
    """Count the residuals of a channel that any push has: those behind them only fill programs of
    one shape."""
    if not task.model.recordings:
        return 1
    there = [np.asarray(blocks.a).any(axis=0) for blocks in task.model.pushes.data]
    return 1 + max(int(np.flatnonzero(x).max(initial=0)) for x in there)


def measure_change(change: NDArray) -> NDArray:
    """Return the larger of the changes of F_p and d, each rms over the pushes, of changes
    (m, n, 2); pushes without a d say nothing of d, and one on the edge of being caught once more no
    more than most."""
    there = np.isfinite(change)
    size = np.abs(np.where(there, change, 0.0))
    moved = size > _MOVED * size.max(axis=1, keepdims=True)
    usual = np.ma.median(np.ma.array(size, mask=~moved), axis=1, keepdims=True).filled(0.0)
    size = np.where(moved, np.minimum(size, _STEEP * usual), 0.0)
    return np.sqrt((size**2).sum(axis=1) / np.maximum(there.sum(axis=1), 1)).max(axis=1)
