"""The search for the joint fit: which shapes small effects need beside them, and where.

A fit of some thirty parameters may end in many places. Shapes are added, placed, moved and dropped
until it leaves no more than noise, or nothing helps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from difffric.diagnosis.background.cause_sets import CauseSet, compute_price, makes_sense
from difffric.diagnosis.background.columns.shape_columns import (
    compute_columns,
    list_nearby,
    list_placed,
)
from difffric.diagnosis.background.evidence import Evidence, PossibleCause
from difffric.diagnosis.background.joint_fit import (
    ROUGHLY,
    WIDE,
    fit_best,
    follow_leaders,
    free_causes,
    measure_left,
    try_starts,
)
from difffric.diagnosis.background.placement import (
    begin_with_each,
    hold_at_null,
    place_shapes,
    predict_start,
    put_small,
)
from difffric.diagnosis.background.shape_grid import ShapeGrid, leave_out
from difffric.diagnosis.background.shape_pursuit import choose_best_shapes, pursue_shapes
from difffric.diagnosis.background.size_scan import place_cutting_effects
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.diagnosis.data import DiagnosisData
from difffric.diagnosis.score_test import SIGNIFICANT, count_looks
from difffric.diagnosis.starting_values import list_starting_values
from difffric.estimation.ensembles import ensemble, ensemble_refits, friction_scan
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import CUTTING, numbers_of

MOST_EXCESS = 1.5
"""By how many times the noise the small effects and the columns of shapes may leave, to be
trusted."""
_SHAPES_FITTED, _OF_EACH = 8, 2
"""Shapes from which a fit is begun where they leave more, and of each effect."""
_SIZES = 5
"""Sizes from which it is begun of an effect whose size is its shape, where columns misjudge it."""
_MOST_SHAPED = 20
"""How often effects with a shape are added, or moved, or pushes are looked at anew, at most."""
ARRIVED = 1.1
"""Squares per number from which on a fit that leaves more has not arrived."""
_MISPLACED = 1.03
"""The same from which on shapes may be at wrong places: two waves at lengths that are not theirs
left 1.07 to 1.09 in place of 1.00 to 1.02."""
_AFAR, _SLOWLY, _STALLED = 3.0, 0.97, 3
"""Squares per number above which a change that leaves this share of them hardly helps, and after
how many such changes running only a new beginning may: each gains a little where something outside
the catalogue is, and none leads anywhere."""
_HARDLY = 1.02
"""The same from which on something may be left."""
_HIDDEN, _LARGEST_SIZES = ("static_dwell",), 5
"""Effects that hide in each push's own mu_s while they are small, and the sizes that are tried."""
_SMALL = 0.3
"""A shape is small where it would have to grow by this factor at least to have unit size."""
_AT_ONCE = 3
"""Shapes at most that are placed at once."""
_FIRST_ROUNDS = 2
"""Steps of the fits from each start with a set of causes freed."""
_HOPELESS = 30.0
"""How many times as much as the joint fit one that has not all small effects may leave after its
first steps, to be followed: those that were right left a tenth more."""
_ROUNDS = 8
"""Steps at most of the best of them, and of a fit with a set of causes freed."""
_NEARER, _NEXT_TO_NOTHING = (0.1, 0.5), 10.0
"""Shares of their units by which small effects are then assumed to scatter, and how much chi-square
may grow by that."""
_EACH = 2.0
"""What each small effect may take from chi-square that is free by chance."""


@dataclass
class JointSearch:
    """The joint fit as it is searched, step by step."""

    data: DiagnosisData
    effects: Sequence[str]
    background: bool
    small: SmallEffects
    plain: Fits
    joint: Fits
    shaped: tuple[str, ...] = ()
    """effects with a shape that are in the joint fit"""
    large: frozenset[int] = frozenset()
    """coordinates of effects that are not held to be small"""

    def __post_init__(self) -> None:
        self.grid = ShapeGrid(self.data, self.effects, self.background)

    def weigh(self) -> Evidence:
        """Make the comparison where the joint fit stands."""
        return self.grid.weigh(self.small, self.joint, self.shaped)

    def arrive(self) -> Evidence:
        """Place shapes until what is left says of no more of them, and return the comparison where
        that ends."""
        evidence, slow = self.weigh(), 0
        for _ in range(_MOST_SHAPED):
            ways = [self.place_shapes]
            if evidence.excess > MOST_EXCESS:
                ways = [self.add_shape, self.place_shapes]
            left = measure_left(self.data.task, self.joint)
            far = left > ARRIVED
            ways = [self.rescan_own, self.place_cuts, *ways] if far else ways
            ways += [self.place_shapes_anew, self.move_shape] if left > _MISPLACED else []
            ways += [self.drop_shape, self.begin_with_one] if far else []
            if left > _HARDLY or len(self.shaped) > 1:
                ways += [self.enlarge_hidden]
            if slow >= _STALLED:
                ways = [self.drop_shape, self.begin_with_one, self.enlarge_hidden]
            ways += [self.replace_shape, self.add_misjudged]
            if not any(place(evidence) for place in ways):
                break
            evidence = self.weigh()
            now = measure_left(self.data.task, self.joint)
            slow = slow + 1 if now > max(_AFAR, _SLOWLY * left) else 0
        return evidence

    def draw_near(self) -> bool:
        """Bring the small effects as near to their nulls as costs the fit next to nothing; whether
        there is such a fit.

        What the data do not tell may stand anywhere, a dwell at a hundred times its unit; from
        there no linear answer leads back to the null.
        """
        before = measure_left(self.data.task, self.joint)
        for share in _NEARER:
            task = self.small.assume(self.data.task, share, self.large)
            start = replace(self.joint, damping=None)
            fits = ensemble_refits.refit(task, start, _ROUNDS, tol=ROUGHLY)
            more = measure_left(self.data.task, fits) - before
            if more * self.data.task.counts.sum() < _NEXT_TO_NOTHING:
                self.joint = fits
                return True
        return False

    def assume_wide(self) -> EnsembleTask:
        """The task of fits that hardly hold small effects back."""
        return self.small.assume(self.data.task, WIDE, self.large)

    def rescan_own(self, evidence: Evidence) -> bool:
        """Look for the mu_s of pushes that fit badly on a grid; whether that is better."""
        task = self.assume_wide()
        start = friction_scan.rescan_bad_pushes(task, self.joint, fine=True)
        return start is not self.joint and self._follow_start(task, start)

    def enlarge_hidden(self, evidence: Evidence) -> bool:
        """Begin anew with sizes at which an effect shows that no small size does, as a push's own
        mu_s makes up for it; whether that is better."""
        task = self.assume_wide()
        coordinates, starts = task.model.coordinates, []
        for effect in (x for x in _HIDDEN if x in self.small.effects):
            for value in list_starting_values(effect, self.data.scales)[-_LARGEST_SIZES:]:
                c = self.joint.c.copy()
                c[0, coordinates.indices(list(value))] = coordinates.point(value)
                starts.append(hold_at_null(self.small, replace(self.joint, c=c)))
        if not starts:
            return False
        at = ensemble_refits.settle_narrowly(task, ensemble.join(*starts))
        at = ensemble_refits.settle_narrowly(task, friction_scan.rescan_bad_pushes(task, at))
        best = at.pick(int(np.argmin(ensemble.sum_squares(task, at))))
        return self._follow_start(task, replace(best, gram=None, residual=None, damping=None))

    def _follow_start(
        self, task: EnsembleTask, start: Fits, worth: float = _NEXT_TO_NOTHING
    ) -> bool:
        """Take the fit to which a start leads if it gains its `worth`; whether it does."""
        fits = ensemble_refits.refit(task, start, _ROUNDS, tol=ROUGHLY)
        gain = ensemble.criterion(task, self.joint)[0] - ensemble.criterion(task, fits)[0]
        if gain < worth:
            return False
        self.joint = fits
        return True

    def add_shape(self, evidence: Evidence) -> bool:
        """Add the effect with a shape that helps most; whether any does."""
        best = [x for x in choose_best_shapes(evidence, _OF_EACH) if not x.effects & {*self.shaped}]
        # The best of each effect before any other: those of a fine grid all seem to explain much.
        first = list({next(iter(one.effects)): one for one in reversed(best)}.values())[::-1]
        first = [*first, *(one for one in best if one not in first)][:_SHAPES_FITTED]
        return self._add_any(evidence, first)

    def add_misjudged(self, evidence: Evidence) -> bool:
        """Add that effect whose size is its shape of which columns explain most, but all at sizes
        that they do not stand for; whether that is better."""
        best = [one for one in choose_best_shapes(evidence, _SIZES) if one.score > 0]
        sound = [x for x in best if makes_sense(evidence, x.items, np.array(x.sizes))]
        known = {effect for one in sound for effect in one.effects} | {*self.shaped}
        best = [one for one in best if not one.effects & known]
        return self._add_any(evidence, [one for one in best if one.effects == best[0].effects])

    def _add_any(self, evidence: Evidence, first: Sequence[CauseSet]) -> bool:
        """Add that of some shapes whose fit is best, if it is better than the joint fit by what it
        costs; whether it is."""
        if not first:
            return False
        task = self.assume_wide()
        # What one effect does, small ones together may nearly do: begin without them, too.
        bases = (self.joint, self._forget_small())
        starts = [place_shapes(task, at, one.items, one.sizes) for at in bases for one in first]
        starts += [predict_start(evidence, one.items) for one in first]
        found, which = fit_best(task, starts)
        one = first[which % len(first)]
        gain = float(ensemble.criterion(task, self.joint)[0] - ensemble.criterion(task, found)[0])
        if gain < 2 * one.price:
            return False
        self.joint, self.shaped = found, (*self.shaped, one.items[0].effect)
        return True

    def place_cuts(self, evidence: Evidence) -> bool:
        """Place what cuts pushes short, of which no column tells unless its size is nearly right;
        whether it helps."""
        task = self.assume_wide()
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
        task = self.assume_wide()
        bases = (self.joint, self._forget_small())
        starts = [leave_out(task, at, {effect}) for at in bases for effect in self.shaped]
        found, which = fit_best(task, starts)
        if ensemble.criterion(task, found)[0] > ensemble.criterion(task, self.joint)[0]:
            return False
        gone = self.shaped[which % len(self.shaped)]
        self.joint, self.shaped = found, tuple(x for x in self.shaped if x != gone)
        return True

    def move_shape(self, evidence: Evidence) -> bool:
        """Place a shape elsewhere that stands at a wrong place; whether that is better."""
        task = self.assume_wide()
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
        return ensemble.evaluate(self.assume_wide(), bare), shaped

    def place_shapes_anew(self, evidence: Evidence) -> bool:
        """Place all small shapes anew: one may stand at a wrong place. Whether that is better."""
        small = [x for x in evidence.list_small_shapes(_SMALL) if x not in CUTTING]
        if not small:
            return False
        bare, shaped = self._take_out(small)
        found = self._place_beside(bare, shaped, self.grid.weigh(self.small, bare, shaped))
        if found is None:
            return False
        self.joint, self.shaped = found
        return True

    def begin_with_one(self, evidence: Evidence) -> bool:
        """Begin anew with that small effect that explains most by itself; all at once may lead to
        where no step helps. Whether that is better."""
        return self._begin_with_any(self._forget_small())

    def replace_shape(self, evidence: Evidence) -> bool:
        """Put the effect that explains most in the place of a shape: a patch from where a push
        begins imitates a tilt. Whether that is better."""
        for effect in (x for x in self.shaped if x not in CUTTING):
            base = leave_out(self.data.task, self._forget_small(), {effect})
            if self._begin_with_any(base, 0.0):
                self.shaped = tuple(x for x in self.shaped if x != effect)
                return True
        return False

    def _begin_with_any(self, base: Fits, worth: float = _NEXT_TO_NOTHING) -> bool:
        """Take the fit that begins with one small effect of any size, on top of plain parameters
        and shapes of `base`, if chi-square falls by what it is `worth`; whether it does."""
        index = self.small.index
        if not index:
            return False
        chosen, starts = begin_with_each(self.data.task, base, self.small)
        few, left = try_starts(self.data.task, starts)
        if left.min() > _HOPELESS * measure_left(self.data.task, self.joint):
            return False
        fits, which = follow_leaders(self.data.task, few)
        joint = ensemble.criterion(self.assume_wide(), self.joint)[0]
        if ensemble.criterion(self.data.task, fits)[0] > joint + _EACH * len(index):
            return False
        before, self.large = self.large, self.large | {chosen[which]}
        start = hold_at_null(self.small, self.small.free(fits), fits.extra[0])
        if self._follow_start(self.assume_wide(), start, worth):
            return True
        self.large = before
        return False

    def _place_beside(
        self, at: Fits, shaped: tuple[str, ...], evidence: Evidence
    ) -> tuple[Fits, tuple[str, ...]] | None:
        """Return the fit with shapes placed in the fit `at`, which has those of `shaped`, and the
        effects that are then in it; None where that is not worth it."""
        task = self.assume_wide()
        found = pursue_shapes(evidence, _AT_ONCE)
        nearby = list_nearby([item.shape for item in found.items if item.shape is not None])
        if not nearby:
            return None
        nearby = [*list_placed(task, at, shaped), *nearby]
        columns = compute_columns(self.data.task, at, nearby)
        evidence = Evidence(self.data.task, at, self.small, columns, self.background)
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
        # A cause that was held at its null is free now.
        own = [self.small.index[x.columns[0]] for x in items if x.shape is None]
        extra = tuple((*some, *(i for i in own if i not in some)) for some in starts.extra)
        starts = replace(starts, extra=extra)
        fits = ensemble_refits.refit(task, starts, _FIRST_ROUNDS)
        best = int(np.argmin(ensemble.criterion(task, fits)))
        self.joint = ensemble_refits.refit(task, fits.pick(best), _ROUNDS)
        self.shaped = (*self.shaped, *new)
