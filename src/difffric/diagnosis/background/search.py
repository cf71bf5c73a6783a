"""The search for the causes that stand out of a background of small effects.

All small effects are fitted at once. What is then left beyond noise is looked for among the effects
that have a shape; the most probable set of causes is freed of the background, everything is fitted
anew, and the sets are compared again there, until the same set comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from difffric.diagnosis.background.cause_sets import (
    CauseSet,
    compute_price,
    find_set,
    search_sets,
)
from difffric.diagnosis.background.evidence import Evidence, PossibleCause
from difffric.diagnosis.background.joint_fit import (
    ROUGHLY,
    WIDE,
    fit_jointly,
    measure_left,
)
from difffric.diagnosis.background.placement import place_shapes, predict_start, put_small
from difffric.diagnosis.background.shape_columns import (
    Shape,
    compute_columns,
    list_nearby,
    list_placed,
)
from difffric.diagnosis.background.shape_grid import ShapeGrid, is_near, leave_out
from difffric.diagnosis.background.shape_pursuit import choose_best_shapes, pursue_shapes
from difffric.diagnosis.background.size_scan import CUTTING, place_cutting_effects
from difffric.diagnosis.background.small_effects import (
    SmallEffects,
    choose_small_effects,
    measure_units,
)
from difffric.diagnosis.data import DiagnosisData, choose_subset
from difffric.diagnosis.score_test import SIGNIFICANT, count_looks
from difffric.estimation import ensemble, ensemble_refits
from difffric.estimation.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import numbers_of

MOST_EXCESS = 1.5
"""By how many times the noise the small effects and the columns of shapes may leave, to be
trusted."""
_SHAPES_FITTED, _OF_EACH = 8, 2
"""Shapes from which a fit is begun where they leave more, and of each effect."""
_MOST_SHAPED = 8
"""How often effects with a shape are added, or moved."""
ARRIVED = 1.1
"""Squares per number from which on a fit that leaves more may have shapes at wrong places."""
_SMALL = 0.3
"""A shape is small where it would have to grow by this factor at least to have unit size."""
_AT_ONCE = 3
"""Shapes at most that are placed at once."""
_FIRST_ROUNDS = 2
"""Steps of the fits from each of these shapes."""
_LEADERS = 2
"""Those of them that are fitted to the end."""
_ROUNDS = 8
"""Steps at most of the best of them, and of a fit with a set of causes freed."""
_COMPARISONS = 3
"""How often the sets are compared, each time where the last one's best set led."""
_LEAST_SHARE = 0.1
"""The share of their units by which the background is assumed to scatter at least, while a set of
causes is fitted."""


@dataclass(frozen=True)
class BackgroundSearch:
    """Where the search ended."""

    data: DiagnosisData
    joint: Fits
    """the fit with all small effects, and the shapes that stand out (an ensemble of one)"""
    small: SmallEffects
    evidence: Evidence
    """where it stands"""
    sets: tuple[CauseSet, ...]
    """the most probable first"""
    singles: tuple[CauseSet, ...]
    """the single causes as they were compared first, the best first"""
    first: Evidence
    """where they were compared"""
    shaped: tuple[str, ...]
    """effects with a shape that are in the joint fit"""

    @property
    def best(self) -> CauseSet:
        """The most probable set."""
        return self.sets[0]


@dataclass
class _JointSearch:
    """The search, step by step."""

    data: DiagnosisData
    effects: Sequence[str]
    background: bool
    small: SmallEffects
    plain: Fits
    joint: Fits
    shaped: tuple[str, ...] = ()
    """effects with a shape that are in the joint fit"""

    def __post_init__(self) -> None:
        self.grid = ShapeGrid(self.data, self.effects, self.background)

    def weigh(self) -> Evidence:
        """Make the comparison where the joint fit stands."""
        return self.grid.weigh(self.small, self.joint, self.shaped)

    def _compare_shapes(self, at: Fits, shapes: Sequence[Shape]) -> Evidence:
        """Make the comparison of small effects and these shapes."""
        columns = compute_columns(self.data.task, at, shapes)
        return Evidence(self.data.task, at, self.small, columns, self.background)

    def add_shape(self, evidence: Evidence) -> bool:
        """Add the effect with a shape that helps most; whether any does."""
        task = self.small.assume(self.data.task, WIDE)
        best = choose_best_shapes(evidence, _OF_EACH)
        best = [one for one in best if not one.effects & set(self.shaped)]
        # The best of each effect before any other: those of a fine grid all seem to explain much.
        first = list({next(iter(one.effects)): one for one in reversed(best)}.values())[::-1]
        first = [*first, *(one for one in best if one not in first)][:_SHAPES_FITTED]
        if not first:
            return False
        # What one effect does, small ones together may nearly do: begin without them, too.
        bases = (self.joint, self._forget_small())
        starts = [place_shapes(task, at, one.items, one.sizes) for at in bases for one in first]
        starts += [predict_start(evidence, one.items) for one in first]
        some = choose_subset(task) if task.model.recordings else None
        fits = ensemble_refits.refit(task, ensemble.join(*starts), _FIRST_ROUNDS, some)
        leaders = np.argsort(ensemble.criterion(task, fits))[:_LEADERS]
        starts = replace(fits.pick(leaders), gram=None, residual=None, damping=None)
        fits = ensemble_refits.refit(task, starts, _ROUNDS, tol=ROUGHLY)
        best = int(np.argmin(ensemble.criterion(task, fits)))
        found, best = fits.pick(best), int(leaders[best]) % len(first)
        gain = float(ensemble.criterion(task, self.joint)[0] - ensemble.criterion(task, found)[0])
        if gain < 2 * first[best].price:
            return False
        self.joint, self.shaped = found, (*self.shaped, first[best].items[0].effect)
        return True

    def place_cuts(self, evidence: Evidence) -> bool:
        """Place what cuts pushes short, of which no column tells unless its size is nearly right;
        whether it helps."""
        task = self.small.assume(self.data.task, WIDE)
        effects = [effect for effect in self.effects if effect not in self.shaped]
        price = float(scipy.stats.chi2.isf(SIGNIFICANT / count_looks(CUTTING[0], len(effects)), 1))
        share = price / float(task.counts.sum())
        start, cutting = place_cutting_effects(task, self.joint, effects, self.data.scales, share)
        if not cutting:
            return False
        fits = ensemble_refits.refit(task, start, _ROUNDS, tol=ROUGHLY)
        before, after = (float(ensemble.criterion(task, x)[0]) for x in (self.joint, fits))
        if before - after < price * evidence.excess:
            return False
        self.joint, self.shaped = fits, (*self.shaped, *cutting)
        return True

    def place_shapes(self, evidence: Evidence) -> bool:
        """Place the shapes that stand out of the noise, one of each effect; whether any does."""
        found = self._place_beside(self.joint, self.shaped, evidence)
        if found is None:
            return False
        self.joint, self.shaped = found
        return True

    def drop_shape(self, evidence: Evidence) -> bool:
        """Drop one of the shapes without which the fit is no worse, once the others are there;
        whether there is one."""
        if len(self.shaped) < 2:
            return False
        task = self.small.assume(self.data.task, WIDE)
        bases = (self.joint, self._forget_small())
        starts = [leave_out(task, at, {effect}) for at in bases for effect in self.shaped]
        some = choose_subset(task) if task.model.recordings else None
        fits = ensemble_refits.refit(task, ensemble.join(*starts), _FIRST_ROUNDS, some)
        leaders = np.argsort(ensemble.criterion(task, fits))[:_LEADERS]
        starts = replace(fits.pick(leaders), gram=None, residual=None, damping=None)
        fits = ensemble_refits.refit(task, starts, _ROUNDS, tol=ROUGHLY)
        best = int(np.argmin(ensemble.criterion(task, fits)))
        gone = self.shaped[int(leaders[best]) % len(self.shaped)]
        before, after = (
            float(ensemble.criterion(task, x)[0]) for x in (self.joint, fits.pick(best))
        )
        if after > before:
            return False
        self.joint = fits.pick(best)
        self.shaped = tuple(effect for effect in self.shaped if effect != gone)
        return True

    def move_shape(self, evidence: Evidence) -> bool:
        """Place one of the shapes elsewhere, which stands at a wrong place; whether that is
        better."""
        task = self.small.assume(self.data.task, WIDE)
        starts, prices = [], []
        for effect in (x for x in self.shaped if x not in CUTTING):
            there = self.grid.weigh(self.small, *self._take_out([effect]), [effect])
            found = pursue_shapes(there, 1)
            if found.items:
                starts.append(predict_start(there, found.items))
                prices.append(compute_price(there, found.items))
        if not starts:
            return False
        fits = ensemble_refits.refit(task, ensemble.join(*starts), _ROUNDS, tol=ROUGHLY)
        best = int(np.argmin(ensemble.criterion(task, fits)))
        gain = ensemble.criterion(task, self.joint)[0] - ensemble.criterion(task, fits)[best]
        if gain < 2 * prices[best]:
            return False
        self.joint = fits.pick(best)
        return True

    def _take_out(self, effects: Sequence[str]) -> tuple[Fits, tuple[str, ...]]:
        """Return the joint fit without the shapes of some effects, all else as it is, and the
        effects whose shapes are still in it."""
        bare = leave_out(self.data.task, self.joint, effects)
        shaped = tuple(effect for effect in self.shaped if effect not in effects)
        return ensemble.evaluate(self.small.assume(self.data.task, WIDE), bare), shaped

    def place_shapes_anew(self, evidence: Evidence) -> bool:
        """Place all small shapes anew, of which one may stand at a wrong place; whether that is
        better."""
        small = evidence.list_small_shapes(_SMALL)
        if not small:
            return False
        bare, shaped = self._take_out(small)
        found = self._place_beside(bare, shaped, self.grid.weigh(self.small, bare, shaped))
        if found is None:
            return False
        self.joint, self.shaped = found
        return True

    def _place_beside(
        self, at: Fits, shaped: tuple[str, ...], evidence: Evidence
    ) -> tuple[Fits, tuple[str, ...]] | None:
        """Return the fit with shapes placed in the fit `at`, which has those of `shaped`, and the
        effects that are then in it; None where that is not worth it."""
        task = self.small.assume(self.data.task, WIDE)
        found = pursue_shapes(evidence, _AT_ONCE)
        nearby = list_nearby([item.shape for item in found.items if item.shape is not None])
        if not nearby:
            return None
        nearby = [*list_placed(task, at, shaped), *nearby]
        evidence = self._compare_shapes(at, nearby)
        before = float(ensemble.criterion(task, self.joint)[0])
        for most in range(_AT_ONCE, 0, -1):  # all at once may be too far for a linear prediction
            found = pursue_shapes(evidence, most)
            if len(found.items) < most:
                continue
            start = predict_start(evidence, found.items)
            fits = ensemble_refits.refit(task, start, _ROUNDS, tol=ROUGHLY)
            gain = before - float(ensemble.criterion(task, fits)[0])
            if gain > 2 * compute_price(evidence, found.items):
                return fits, tuple(dict.fromkeys((*shaped, *(x.effect for x in found.items))))
        return None

    def _forget_small(self) -> Fits:
        """The joint fit's shapes with the plain fit and no small effect."""
        index = self.data.task.model.coordinates.indices(
            [name for effect in self.shaped for name in numbers_of(effect)]
        )
        at = self.small.free(self.plain)
        c = at.c.copy()
        c[0, index] = self.joint.c[0, index]
        return replace(at, c=c, extra=self.joint.extra)

    def free(
        self, evidence: Evidence, items: Sequence[PossibleCause], sizes: Sequence[float]
    ) -> None:
        """Fit anew with a set of causes at any size."""
        start = place_shapes(self.data.task, self.joint, items, sizes)
        first = 0
        for item in items:
            if item.shape is None:  # where it is now is where its smallness held it
                put_small(start.c, self.data.task, self.small, item, sizes[first])
            first += len(item.columns)
        new = (x.effect for x in items if x.shape is not None and x.effect not in self.shaped)
        task = free_causes(self.data.task, self.small, evidence, items)
        # One of them may be far off: a large cause alone, or the linear answer where it is none.
        starts = ensemble.join(start, predict_start(evidence, items))
        fits = ensemble_refits.refit(task, starts, _FIRST_ROUNDS)
        best = int(np.argmin(ensemble.criterion(task, fits)))
        self.joint = ensemble_refits.refit(task, fits.pick(best), _ROUNDS)
        self.shaped = (*self.shaped, *new)


def free_causes(
    task: EnsembleTask, small: SmallEffects, evidence: Evidence, items: Sequence[PossibleCause]
) -> EnsembleTask:
    """Return the task of fits in which the `items` have any size, and the other small effects
    scatter as the evidence says."""
    share = max(evidence.estimate_share(items), _LEAST_SHARE)
    free = {item.effect for item in items}
    causes = {i for i, effect in zip(small.index, small.effects, strict=True) if effect in free}
    return small.assume(task, share, causes)


def search_background(
    data: DiagnosisData, plain: Fits, guess: Fits, effects: Sequence[str], background: bool
) -> BackgroundSearch:
    """Search for causes among the `effects`, on top of the plain fit `plain`; `guess` is the set-up
    as it was given (both ensembles of one). Without a `background` every effect but the causes is
    exactly at its null."""
    small = choose_small_effects(data.task, plain, effects)
    joint, cutting = fit_jointly(data, small, plain, guess, effects)
    search = _JointSearch(data, effects, background, small, plain, joint, cutting)
    evidence = search.weigh()
    for _ in range(_MOST_SHAPED):
        ways = [search.place_shapes]
        if evidence.excess > MOST_EXCESS:
            ways = [search.add_shape, search.place_shapes]
        if measure_left(data.task, search.joint) > ARRIVED:
            ways = [search.place_cuts, search.drop_shape, *ways]
            ways += [search.move_shape, search.place_shapes_anew]
        if not any(place(evidence) for place in ways):
            break
        evidence = search.weigh()
    # The plain fit may be far from here, and what is small there need not be so here.
    if not is_near(data.task, plain, search.joint):
        search.small = small = measure_units(data.task, search.joint, small)
        evidence = search.weigh()
    sets = search_sets(evidence, evidence.items)
    singles = [one for one in sets if len(one.items) == 1]
    first = evidence

    def end() -> BackgroundSearch:
        return BackgroundSearch(
            data, search.joint, small, evidence, tuple(sets), tuple(singles), first, search.shaped
        )

    freed: frozenset[str] = frozenset()
    ended = [(freed, end())]
    for _ in range(_COMPARISONS - 1):
        if sets[0].effects == freed:
            break
        freed = sets[0].effects
        search.free(evidence, sets[0].items, sets[0].sizes)
        evidence = search.weigh()
        sets = search_sets(evidence, evidence.items)
        ended.append((freed, end()))
    # Where they go to and fro a linear comparison is no guide: what was fitted counts.
    return ended[-1][1] if sets[0].effects == freed else _choose_fitted(ended)


def _choose_fitted(ended: Sequence[tuple[frozenset[str], BackgroundSearch]]) -> BackgroundSearch:
    """Choose the search in which the set of effects that its fit had as causes is the most
    probable, and let that set be its best."""
    best, most = ended[0][1], -np.inf
    for effects, one in ended:
        found = find_set(one.evidence, effects)
        if found is not None and one.evidence.log_likelihood + found.score > most:
            most = one.evidence.log_likelihood + found.score
            best = replace(one, sets=(found, *one.sets))
    return best


def fit_beside_background(
    data: DiagnosisData, found: BackgroundSearch, items: Sequence[PossibleCause]
) -> tuple[EnsembleTask, Fits]:
    """Return the fit with the `items` at any size and the other small effects beside them, and the
    task of it."""
    search = _JointSearch(data, (), True, found.small, found.joint, found.joint, found.shaped)
    kept = {item.effect for item in items}
    if kept != found.best.effects or any(x.shape and not x.shape.placed for x in items):
        columns = [c for item in items for c in item.columns]
        sizes = found.evidence.compare([columns]).best_size(0).tolist() if items else []
        search.free(found.evidence, items, sizes)
    return free_causes(data.task, found.small, found.evidence, items), search.joint
