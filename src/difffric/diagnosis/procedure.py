"""Given measured data: what the simulation gets wrong, the cause, and what mending it gains.

The plain model is fitted; then one effect after the other is looked for on top of what is there,
kept where it is significant and gains on held-out pushes, and dropped again where later ones made
it needless. What of it changes too little to matter is told, and is no cause.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from threading import Thread

import numpy as np

from difffric.compute.precision import require_float64
from difffric.diagnosis.background.free_curves import compare_with_curves
from difffric.diagnosis.background.naming import (
    compare_rivals,
    fit_causes,
    fit_singles,
    keep_significant,
    list_outstanding,
)
from difffric.diagnosis.background.search import fit_beside_background, search_background
from difffric.diagnosis.combinations.explanation import explain_table
from difffric.diagnosis.conclusion import SIGNIFICANT, Findings, NamedCause, conclude
from difffric.diagnosis.cross_validation import CrossValidation, assign_folds
from difffric.diagnosis.exploration import CandidateCause, explore, is_promising
from difffric.diagnosis.impossible_measurements import find_unreachable
from difffric.diagnosis.lack_of_fit import LackOfFit, is_misfit_large, measure_lack_of_fit
from difffric.diagnosis.location import add_free_forms
from difffric.diagnosis.score_test import Score, compute_p_value, run_score_tests
from difffric.diagnosis.start import (
    SearchStart,
    find_better_base,
    find_better_optimum,
    fit_plain_model,
    prepare_start,
)
from difffric.diagnosis.starting_values import SMOOTH_AT_NULL
from difffric.diagnosis.verdict import Diagnosis, measure_changes
from difffric.errors import InputError, NumericalError
from difffric.estimation import ensemble, ensemble_refits
from difffric.estimation.effect_coordinates import PLAIN
from difffric.estimation.ensemble import Fits
from difffric.estimation.extended_model import PRESLIDING
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.progress import Tell, silent
from difffric.rig.catalogue import numbers_of
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup

PUSH, SPEED = "push", "speed"
MATTERS = 0.005
"""Share of mu_s by which a cause must change what is inferred to be one: a third of the scatter
of a good rig from push to push."""
MOST = 3
"""Causes that are looked for at most."""
_ADDED = 6
"""Effects that are added at most, those that turn out not to matter among them."""
_RESTARTS = 3
"""How often a round begins anew where the fit that it extends turns out not to be the best."""
_FEWEST = 3
"""Pushes from which on one can be held out."""
_NOTHING_LEFT = 0.01
"""Probability above which neither a misfit nor a score test calls for another round."""
_ROUNDS = 40
"""Steps at most of a refit with one more cause: strong effects take many, and what is left has to
be the best fit's."""
_BACKGROUND = 0.05
"""Share of their units by which small effects scatter, from which something outside the catalogue
may pass for them."""
_ROUNDS_WITHOUT = 15
"""The same of a refit that leaves a cause out again, which begins near its end."""


def diagnose(
    rig: Rig | Setup,
    data: Pushes | Recordings,
    *,
    matters: float = MATTERS,
    held_out: str = PUSH,
    use_data_mass: bool = False,
    skip_bad: bool = False,
    tell: Tell = silent,
) -> Diagnosis:
    """Show what the rig's simulation gets wrong in measured pushes, name the cause, extend the
    rig by it and measure the gain on held-out pushes.

    `matters`: the share of mu_s by which an effect must change mu_s, or F_p or d as much as such a
    share of mu_s does, to be a cause; what is detected and changes less is listed as negligible.
    `held_out`: "push", or "speed" to hold out all pushes of one speed at a time. Effects that the
    rig has already stay, and are refitted.

    Raises `InputError` for data that cannot be used, `NumericalError` where the fitted plain model
    gives no number for a push.
    """
    require_float64()
    if not 0 <= matters < 1:
        raise InputError(f"matters: expected a share of mu_s from 0 to 1, got {matters:g}")
    if held_out not in (PUSH, SPEED):
        raise InputError(f"held_out: expected {PUSH!r} or {SPEED!r}, got {held_out!r}")
    setup = rig if isinstance(rig, Setup) else Setup(rig)
    start = prepare_start(setup, data, tell, use_data_mass=use_data_mass, skip_bad=skip_bad)
    folds = assign_folds(np.asarray(start.data.task.model.pushes.velocity), held_out == SPEED)
    search = _CauseSearch.begin(setup, start, folds, matters, tell)
    return conclude(search.run(), tell)


@dataclass
class _CauseSearch:
    """The search for causes, round by round."""

    setup: Setup
    start: SearchStart
    validation: CrossValidation
    matters: float
    tell: Tell
    plain: Fits
    """the best plain model by now (an ensemble of one)"""
    lack: LackOfFit
    """of the plain model"""
    base: Fits
    """the plain model with the effects that are added by now"""
    named: list[NamedCause] = field(default_factory=list)
    """the effects that are added"""
    small: list[NamedCause] = field(default_factory=list)
    """significant, not added, and too small to matter"""
    considered: list[CandidateCause] = field(default_factory=list)
    """the first round's leaders"""
    scores: Mapping[str, Score] = field(default_factory=dict)
    """the first round's score tests"""
    visible: dict[str, float] = field(default_factory=dict)
    """standard deviations at which each effect would be seen at its typical size, by its last score
    test"""
    total: float | None = None
    """what there was to explain, in -2 log likelihood"""
    compiling: Thread | None = None
    """compiles the program of free forms"""
    notes: tuple[str, ...] = ()
    """what a reader should know of the search"""
    usual: frozenset[str] = frozenset()
    """effects that are no larger than in any rig"""
    whole: Fits | None = None
    """the same with the small effects beside them, where there are any"""
    explained: bool | None = None
    """whether causes and background explain the data better than a curve of no particular form"""
    curves: tuple[str, ...] = ()
    """the curve that does"""

    @classmethod
    def begin(
        cls, setup: Setup, start: SearchStart, folds: np.ndarray, matters: float, tell: Tell
    ) -> _CauseSearch:
        """Begin with the best plain model.

        Raises `NumericalError` where it cannot be followed through every push.
        """
        task = start.data.task
        plain = fit_plain_model(task, start.at, start.guess)
        if (ensemble.sum_squares(task, plain) >= ensemble.REJECTED).any():
            raise NumericalError(
                "diagnose: the fitted plain model could not be followed through every push"
            )
        lack = measure_lack_of_fit(task, plain)
        validation = CrossValidation(task, folds)
        return cls(setup, start, validation, matters, tell, plain, lack, plain)

    def run(self) -> Findings:
        """Look for causes, round by round, and return all that was found."""
        data, task = self.start.data, self.start.data.task
        if task.model.in_columns:
            self._add_combination()
        elif task.n < _FEWEST:
            self.notes = (f"{task.n} pushes: too few to hold any out: no cause is looked for",)
        else:
            self._add_standing()
        certificates = find_unreachable(data.measured, self.setup.rig)
        if certificates and not self.named:
            # The plain model is wrong for certain: what may mend it is in question.
            question = tuple(c for c in self.considered if c.penalised_drop > 0)
            if question:
                self.named = [NamedCause(question[0], question, self.plain)]
                self.base = question[0].fits
        causes = self._list_causes()
        slight = [one for one in self.named if one not in causes]
        return Findings(
            setup=self.setup,
            data=data,
            fit=self.start.fit,
            validation=self.validation,
            plain=self.plain,
            whole=self.whole or self.base,
            extended=self._leave_out(self.base, *(one.best.effect for one in slight)),
            lack=self.lack,
            causes=tuple(causes),
            slight=tuple(slight),
            negligible=tuple(self.small),
            considered=tuple(self.considered),
            scores=self.scores,
            visible=self.visible,
            certificates=certificates,
            total=self.total,
            notes=self.notes,
            compiling=self.compiling,
            explained=self.explained,
            curves=self.curves,
        )

    def _add_combination(self) -> None:
        """Add the combination that explains a table best of whose distances no k, b and k_v can
        give some: one cause alone hardly mends that."""
        data, task = self.start.data, self.start.data.task

        def tell(what: str, share: float) -> None:
            self.tell(what, 0.25 + 0.1 * share)

        found = explain_table(self.setup, data.measured, self.validation.folds, tell)
        effects = [part for part in found.best.parts if part not in PLAIN]
        missing = [effect for effect in effects if effect in self._list_wanted()]
        index = task.model.coordinates.indices([n for e in missing for n in numbers_of(e)])
        at = replace(
            self.base,
            c=np.where(np.arange(found.best.points.c.shape[1]) > 0, found.best.points.c, 0.0),
            extra=((*self.base.extra[0], *index),),
            gram=None,
            residual=None,
            damping=None,
        )
        new = ensemble_refits.refit(task, at, _ROUNDS)
        if not missing or not self.validation.is_better(new, self.base):
            return
        self.total = max(self.lack.excess, 1.0)
        self.base = new
        self.notes = tuple(
            f"{' and '.join(sorted(rival.parts - found.best.parts))} in place of "
            f"{' and '.join(sorted(found.best.parts - rival.parts))} explains these data nearly as "
            f"well (cost {rival.cost:.1f} against {found.best.cost:.1f})"
            for rival in found.rivals
        )
        for effect in missing:
            without = self._leave_out(new, effect)
            drop = float(ensemble.criterion(task, without)[0] - ensemble.criterion(task, new)[0])
            p_value = compute_p_value(effect, drop, len(data.looked_for))
            price = len(numbers_of(effect)) * task.price
            one = CandidateCause(effect, new, drop, 0.0, p_value, drop - price)
            self.named.append(NamedCause(one, (one,), without))
        self.named, self.base = self._drop_needless(self.named, self.base, len(self.named))

    def _add_standing(self) -> None:
        """Add the causes that stand out of a background of small effects."""
        data, task = self.start.data, self.start.data.task
        wanted = [effect for effect in self._list_wanted() if effect != PRESLIDING]
        self.tell("looking for causes", 0.3)
        found = search_background(data, self.plain, self.start.guess, wanted, self.matters > 0)
        items, p_values = keep_significant(found.evidence, found.best, SIGNIFICANT)
        if self.matters > 0:
            outstanding = list_outstanding(found.evidence, items, SIGNIFICANT)
            self.usual = frozenset(item.effect for item in items) - outstanding
        self.scores = run_score_tests(task, self.plain, wanted)
        self.visible |= {effect: score.visible for effect, score in self.scores.items()}
        if items or found.evidence.estimate_share() > _BACKGROUND:
            self.tell("comparing with curves of no particular form", 0.6)
            compared = compare_with_curves(data, found, items)
            self.explained, self.curves = not compared.is_outside, (compared.best,)
        self.tell("fitting the causes", 0.7)
        self.base = self.whole = fit_causes(task, self.plain, found, items)
        if items:
            bare = self._leave_out(self.base, *(item.effect for item in items))
            value = ensemble.criterion(task, ensemble.join(self.plain, bare))
            if value[1] < value[0]:
                self.plain, self.lack = bare, measure_lack_of_fit(task, bare)
        self.considered = fit_singles(task, self.plain, found)
        if found.evidence.estimate_share(items) > _BACKGROUND:
            task, self.whole = fit_beside_background(data, found, items)
            self.start = replace(self.start, data=replace(data, task=task))
            self.validation = CrossValidation(task, self.validation.folds)
        value = float(ensemble.criterion(task, self.whole)[0])
        for item, p_value in zip(items, p_values, strict=True):
            without = self._leave_out(self.whole, item.effect)
            drop = float(ensemble.criterion(task, without)[0]) - value
            score = self.scores.get(item.effect)
            price = len(numbers_of(item.effect)) * task.price
            predicted = score.drop if score else 0.0
            if drop < price:  # it was there to make up for what another one did
                continue
            one = CandidateCause(item.effect, self.whole, drop, predicted, p_value, drop - price)
            others = compare_rivals(data.task, self.base, found, items, one)
            self.named.append(NamedCause(one, others, without))
        self.total = max(self.lack.excess, *(one.best.drop for one in self.named), 1.0)

    def _list_causes(self) -> list[NamedCause]:
        """List what was added and matters."""
        return [one for one in self.named if self._does_matter(one, self.whole or self.base)]

    def _does_matter(self, one: NamedCause, at: Fits) -> bool:
        """Whether an effect of the fit `at` changes as much as matters, and more than every rig
        has of it."""
        if one.best.effect in self.usual:
            return False
        task = self.start.data.task
        changes = measure_changes(task, one.without, at, one.best.effect)
        return changes.as_mu_s >= self.matters

    def _arrive(self, k: int) -> None:
        """Look for a better optimum of the model with what was added by now, while it is not at its
        noise floor: what such a fit leaves would be taken for further effects, and those that were
        added to a worse one may be needless."""
        before = self.base
        for _ in range(_RESTARTS):
            if self.validation.is_at_floor(self.base):
                break
            self.tell("looking for a better fit", 0.3 + 0.1 * k)
            better = find_better_optimum(self.start.data.task, self.base, self.start.guess)
            if better is None:
                break
            self.base = better
        if self.base is not before:
            self.named, self.base = self._drop_needless(self.named, self.base, len(self.named))

    def _look_once_more(self, k: int) -> bool:
        """Look for one more cause in round k; whether another round may find another one."""
        task = self.start.data.task
        self.tell("looking for a cause", 0.3 + 0.1 * k)
        wanted = self._list_wanted()
        scores = run_score_tests(task, self.base, wanted)
        self.scores = self.scores or scores
        self.visible |= {effect: score.visible for effect, score in scores.items()}
        if k and self._is_enough(scores):
            return False
        if k and self.compiling is None:  # free forms may be needed, and take long to compile
            wide = add_free_forms(task, self.start.data.scales).model
            self.compiling = Thread(target=wide.compile, daemon=True)
            self.compiling.start()
        found = self._explore_from_best_base(wanted, scores, k)
        self.considered = self.considered or found
        found = [c for c in found if c.p_value < SIGNIFICANT]
        best = next((c for c in found if self.validation.is_better(c.fits, self.base)), None)
        if best is None:
            return False
        self.total = self.total or max(self.lack.excess, best.drop)
        if self.validation.is_at_floor(self.base):
            every = [NamedCause(c, tuple(found), self.base) for c in found if c.penalised_drop > 0]
            if not any(self._does_matter(one, one.best.fits) for one in every):
                self.small = every
                return False
        return self._add(NamedCause(best, tuple(found), self.base))

    def _list_wanted(self) -> list[str]:
        """List the effects that are not in the model."""
        there = {name.partition(".")[0] for name in self.start.known}
        there |= {one.best.effect for one in self.named}
        return [effect for effect in self.start.data.looked_for if effect not in there]

    def _is_enough(self, scores: Mapping[str, Score]) -> bool:
        """Whether nothing is left that a further search could find."""
        left = measure_lack_of_fit(self.start.data.task, self.base)
        seen = [compute_p_value(e, s.drop, len(scores)) for e, s in scores.items()]
        fits = left.p_value is None or left.p_value > _NOTHING_LEFT
        return fits and min(seen, default=1.0) > _NOTHING_LEFT

    def _explore_from_best_base(
        self, wanted: Sequence[str], scores: Mapping[str, Score], k: int
    ) -> list[CandidateCause]:
        """Return the leading effects in round k, the best first, on top of a base that none of
        them shows to be a poor fit."""
        task = self.start.data.task
        found: list[CandidateCause] = []
        for _ in range(_RESTARTS):
            found = self._explore(wanted, scores, k)
            suspect = is_misfit_large(task, self.base) or any(
                c.p_value < SIGNIFICANT for c in found
            )
            better = find_better_base(task, self.base, found) if suspect else None
            if better is None:
                break
            self.base = better
            if not self.named:
                self.plain, self.lack = better, measure_lack_of_fit(task, better)
            scores = run_score_tests(task, self.base, wanted)
        return found

    def _explore(
        self, wanted: Sequence[str], scores: Mapping[str, Score], k: int
    ) -> list[CandidateCause]:
        """Return the leading effects on top of the base, the best first.

        Bristles have no null, and take a program of their own that takes long: they are looked for
        where the misfit is large, no other effect explains it and they might.
        """
        task, scales, base = self.start.data.task, self.start.data.scales, self.base
        strong = is_misfit_large(task, base)

        def explore_part(effects: Sequence[str], part: float) -> list[CandidateCause]:
            def tell(share: float) -> None:
                self.tell("looking for a cause", 0.3 + 0.1 * (k + part * share))

            return explore(task, base, effects, scales, scores, tell, strong)

        found = explore_part([e for e in wanted if e != PRESLIDING], 0.8)
        unexplained = strong and all(is_misfit_large(task, c.fits) for c in found)
        if PRESLIDING in wanted and unexplained and is_promising(task, base, PRESLIDING, scales):
            found += explore_part([PRESLIDING], 1.0)
        return sorted(found, key=lambda c: -c.penalised_drop)

    def _add(self, cause: NamedCause) -> bool:
        """Add a cause to the model, drop those that it makes needless, and tell whether that
        gains on held-out pushes; where it does not, nothing is added."""
        new = ensemble_refits.refit(self.start.data.task, cause.best.fits, _ROUNDS)
        named, new = self._drop_needless([*self.named, cause], new, len(self.named))
        if not self.validation.is_better(new, self.base):
            return False
        self.named, self.base = named, new
        return True

    def _drop_needless(
        self, named: list[NamedCause], base: Fits, first: int
    ) -> tuple[list[NamedCause], Fits]:
        """Drop those of the `first` causes that the model `base` does not need, one after the
        other, and say of the others what it would be without them."""
        for k in range(first):
            effect = named[k].best.effect
            less = self._leave_out(base, effect)
            task = self.start.data.task
            drop = float(ensemble.criterion(task, less)[0] - ensemble.criterion(task, base)[0])
            if compute_p_value(effect, drop, len(self.start.data.looked_for)) > SIGNIFICANT:
                return self._drop_needless(named[:k] + named[k + 1 :], less, first - 1)
            named = [*named[:k], replace(named[k], without=less), *named[k + 1 :]]
        return named, base

    def _leave_out(self, base: Fits, *effects: str) -> Fits:
        """Return the fit `base` (an ensemble of one) without some of its effects, all that is free
        fitted anew."""
        if not effects:
            return base
        task = self.start.data.task
        gone = task.model.coordinates.indices([x for e in effects for x in numbers_of(e)])
        c = base.c.copy()
        c[0, gone] = self.plain.c[0, gone]
        extra = tuple(i for i in base.extra[0] if i not in gone)
        less = replace(base, c=c, extra=(extra,), gram=None, damping=None)
        return ensemble_refits.refit(task, less, _ROUNDS_WITHOUT)

    def _add_alternatives(self) -> None:
        """Add to what the search compared each cause with what else could stand in its place."""
        data, whole = self.start.data, []
        for one in self.named:
            there = {c.effect for c in one.others}
            more = [e for e in data.looked_for if e in SMOOTH_AT_NULL and e not in there]
            found = find_alternatives(data.task, self.plain, self.base, one.best, more)
            whole.append(replace(one, others=(*one.others, *found)))
        self.named = whole
