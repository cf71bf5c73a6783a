"""Causes of tables and free slides, one after the other on top of what is there.

A table says so little of a push that its own mu_s takes up much of an effect: a joint fit of all
small effects has many optima. There each effect is followed from many sizes instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from difffric.diagnosis.alternatives import find_alternatives
from difffric.diagnosis.background.naming import BACKGROUND, USUAL_SHARE
from difffric.diagnosis.background.small_effects import UNIT_CHANGE
from difffric.diagnosis.combinations.explanation import explain_table
from difffric.diagnosis.conclusion import NamedCause
from difffric.diagnosis.exploration import CandidateCause, explore, is_promising
from difffric.diagnosis.inferred.changes import measure_changes
from difffric.diagnosis.lack_of_fit import is_misfit_large, measure_lack_of_fit
from difffric.diagnosis.score_test import SIGNIFICANT, Score, compute_p_value, run_score_tests
from difffric.diagnosis.start import find_better_base, find_better_optimum
from difffric.diagnosis.starting_values import SMOOTH_AT_NULL
from difffric.estimation.ensembles import ensemble, ensemble_refits
from difffric.estimation.ensembles.ensemble import Fits
from difffric.estimation.extended_model import PRESLIDING
from difffric.rig.catalogue import numbers_of

MOST = 3
"""Causes that are looked for at most."""
_ADDED = 6
"""Effects that are added at most, those that turn out not to matter among them."""
_RESTARTS = 3
"""How often a round begins anew where the fit that it extends turns out not to be the best."""
_HIDING = 0.05
"""The scatter of mu_s beyond which it hides a misfit."""
_NOTHING_LEFT = 0.01
"""Probability above which neither a misfit nor a score test calls for another round."""
_ROUNDS = 40
"""Steps at most of a refit with one more cause: strong effects take many, and what is left has to
be the best fit's."""
_SURELY = 3.0
"""How many times as much as the small effects of its rig an effect that may be one of them must
change F_p or d to be a cause: where pushes are on an edge a little does so."""
_ROUNDS_WITHOUT = 6
"""Steps at most of a refit that leaves a cause out again, which begins near its end."""


class CauseRounds:
    """The rounds of a search, which holds its state."""

    setup: Any
    start: Any
    plain: Any
    base: Any
    whole: Any
    lack: Any
    named: Any
    small: Any
    considered: Any
    scores: Any
    visible: Any
    total: Any
    notes: Any
    validation: Any
    tell: Any
    matters: Any
    share: Any
    usual: Any

    def add_combination(self) -> None:
        """Add the combination that explains a table best of whose distances no k, b and k_v can
        give some: one cause alone hardly mends that."""
        data, task = self.start.data, self.start.data.task

        def tell(what: str, share: float) -> None:
            self.tell(what, 0.25 + 0.1 * share)

        found = explain_table(self.setup, data.measured, self.validation.folds, tell)
        missing = [part for part in found.best.parts if part in self._list_wanted()]
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
        self.notes = found.describe_rivals()
        for effect in missing:
            without = self._leave_out(new, effect)
            drop = float(ensemble.criterion(task, without)[0] - ensemble.criterion(task, new)[0])
            p_value = compute_p_value(effect, drop, len(data.looked_for))
            price = len(numbers_of(effect)) * task.price
            one = CandidateCause(effect, new, drop, 0.0, p_value, drop - price)
            self.named.append(NamedCause(one, (one,), without))
        self.named, self.base = self._drop_needless(self.named, self.base, len(self.named))

    def add_one_by_one(self) -> None:
        """Add one cause after the other, and say what else could be in their places."""
        for k in range(_ADDED):
            if len(self._list_causes()) >= MOST or not self._look_once_more(k):
                break
            self._arrive(k)
        self._add_alternatives()

    def _list_causes(self) -> list[Any]:
        """List what was added and matters."""
        return [one for one in self.named if self._does_matter(one, self.whole or self.base)]

    def _list_wanted(self) -> list[str]:
        """List the effects that are not in the model."""
        there = {name.partition(".")[0] for name in self.start.known}
        there |= {one.best.effect for one in self.named}
        return [effect for effect in self.start.data.looked_for if effect not in there]

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
        where the misfit is known to be large, no other effect explains it and they might.
        """
        task, scales, base = self.start.data.task, self.start.data.scales, self.base
        strong, known = is_misfit_large(task, base), not any(task.open_spread)
        strong &= known or not self.considered  # where no noise is known, once
        strong |= float(base.scatter[0]) > _HIDING

        def explore_part(effects: Sequence[str], part: float) -> list[CandidateCause]:
            def tell(share: float) -> None:
                self.tell("looking for a cause", 0.3 + 0.1 * (k + part * share))

            return explore(task, base, effects, scales, scores, tell, strong)

        found = explore_part([e for e in wanted if e != PRESLIDING], 0.8)
        unexplained = strong and known and all(is_misfit_large(task, c.fits) for c in found)
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

    def _add_alternatives(self) -> None:
        """Add to what the search compared each cause with what else could stand in its place."""
        data, whole = self.start.data, []
        for one in self.named:
            there = {c.effect for c in one.others}
            more = [e for e in data.looked_for if e in SMOOTH_AT_NULL and e not in there]
            found = find_alternatives(data.task, self.plain, self.base, one.best, more)
            whole.append(replace(one, others=(*one.others, *found)))
        self.named = whole

    def _does_matter(self, one: NamedCause, at: Fits) -> bool:
        """Whether an effect of the fit `at` changes as much as matters, and is unusual."""
        changes = measure_changes(self.start.data.task, one.without, at, one.best.effect)
        usual = one.best.effect in self.usual
        if usual or self.share > BACKGROUND:  # mu_s moves by what others do in its place
            small = _SURELY * max(self.share, USUAL_SHARE) * UNIT_CHANGE if usual else 0.0
            return changes.count_reading(one.best.effect, usual) >= max(small, self.matters)
        return changes.as_mu_s >= self.matters

    def _leave_out(self, base: Fits, *effects: str, enough: float = np.inf) -> Fits:
        """Return the fit `base` (an ensemble of one) without some of its effects, all that is free
        fitted anew, to its end where it is worse by less than `enough` in chi-square."""
        if not effects:
            return base
        task = self.start.data.task
        gone = [task.model.coordinates.indices(numbers_of(effect)) for effect in effects]
        return ensemble_refits.refit_without(task, base, self.plain, gone, _ROUNDS_WITHOUT, enough)
