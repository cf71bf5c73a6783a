"""Given measured data: what the simulation gets wrong, the cause, and what mending it gains.

The plain model is fitted; then all small effects with it, and the set of causes is looked for that
stands out of them (`background`). What of it changes too little to matter is told, and is no cause.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from difffric.compute.precision import require_float64
from difffric.diagnosis.background.bristles import (
    looks_like_bristles,
    may_stand_for_bristles,
    search_beside_bristles,
    weigh_bristles,
)
from difffric.diagnosis.background.cause_sets import compute_price
from difffric.diagnosis.background.curve_comparison import compare_with_curves
from difffric.diagnosis.background.curve_fit import NEARLY_ALL, CurveFit, fit_curve_for_causes
from difffric.diagnosis.background.evidence import PossibleCause
from difffric.diagnosis.background.friction_estimate import average_over_sets, estimate_friction
from difffric.diagnosis.background.joint_search import ARRIVED
from difffric.diagnosis.background.naming import (
    BACKGROUND,
    USUAL_SHARE,
    choose_by_fits,
    choose_foreseen,
    choose_significant,
    compare_rivals,
    find_unseen,
    fit_causes,
    fit_singles,
    list_outstanding,
)
from difffric.diagnosis.background.search import (
    BackgroundSearch,
    begin_search,
    fit_beside_background,
    search_beyond_edge,
    search_from,
)
from difffric.diagnosis.combinations.cause_rounds import CauseRounds
from difffric.diagnosis.conclusion import Findings, NamedCause, conclude
from difffric.diagnosis.cross_validation import CrossValidation, assign_folds
from difffric.diagnosis.exploration import CandidateCause, explore_bristles
from difffric.diagnosis.extended_setup import describe_plain
from difffric.diagnosis.impossible_measurements import find_unreachable
from difffric.diagnosis.inferred.friction import DWELL_EFFECT
from difffric.diagnosis.inferred.push_offsets import describe_offsets
from difffric.diagnosis.lack_of_fit import LackOfFit, is_misfit_large, measure_lack_of_fit
from difffric.diagnosis.location import Location
from difffric.diagnosis.score_test import SIGNIFICANT, Score, run_score_tests
from difffric.diagnosis.start import (
    SearchStart,
    calibrate_plain,
    fit_plain_model,
    prepare_start,
    shift_by_offsets,
)
from difffric.diagnosis.verdict import Diagnosis
from difffric.errors import InputError, NumericalError
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.extended_model import PRESLIDING
from difffric.known_so_far import tell_answer
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.progress import Tell, silent
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup

PUSH, SPEED = "push", "speed"
MATTERS = 0.005
"""Share of mu_s by which a cause must change what is inferred to be one: a third of the scatter
of a good rig from push to push."""
_FEWEST = 3
"""Pushes from which on one can be held out."""
_FAR_ABOVE = 20.0
"""How many times its price a cause is worth whose refit without it need not go to its end."""


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

    `matters`: the share of mu_s by which a cause changes mu_s, or F_p or d as much as that does;
    beside a background, of F_p or d themselves. What changes less is listed as negligible.
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
class _CauseSearch(CauseRounds):
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
    """standard deviations at which each effect would be seen at its typical size"""
    total: float | None = None
    """what there was to explain, in -2 log likelihood"""
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
    outside: Location | None = None
    """where it is fitted beside a background, what it says"""
    share: float = 0.0
    """of their units by which small effects scatter"""
    friction: tuple[np.ndarray, np.ndarray] | None = None
    """log mu_s of each push and its standard errors, averaged over what there may be"""

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
        if tell is not silent:  # a fleet's rig has its answer in the end, or none
            tell_answer("the plain fit, without error bars", describe_plain(task, plain))
        lack = measure_lack_of_fit(task, plain)
        validation = CrossValidation(task, folds)
        return cls(setup, start, validation, matters, tell, plain, lack, plain)

    def run(self) -> Findings:
        """Look for causes, round by round, and return all that was found."""
        task = self.start.data.task
        if task.model.in_columns:
            self.add_combination()
        elif task.n < _FEWEST:
            self.notes = (f"{task.n} pushes: too few to hold any out: no cause is looked for",)
        elif task.model.recordings:
            self._add_standing()
        else:
            self.add_one_by_one()
        certificates = find_unreachable(self.start.data.measured, self.setup.rig)
        question = tuple(c for c in self.considered if c.penalised_drop > 0)
        if certificates and question and not self.named:  # they may mend the plain model
            self.named = [NamedCause(question[0], question, self.plain)]
            self.base = question[0].fits
        causes = self._list_causes()
        slight = [one for one in self.named if one not in causes]
        return Findings(
            setup=self.setup,
            data=self.start.data,
            fit=calibrate_plain(self.start, self.plain),
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
            notes=(*self.notes, *describe_offsets(self.start.offsets)),
            explained=self.explained,
            curves=self.curves,
            outside=self.outside,
            unseen=find_unseen(self.start.data, self.share),
            friction=self.friction,
        )

    def _add_standing(self) -> None:
        """Add the causes that stand out of a background of small effects."""
        data, task = self.start.data, self.start.data.task
        if self._shift_starts(self.plain):
            return self._add_standing()
        wanted = self._list_wanted()
        small = [effect for effect in wanted if effect != PRESLIDING]
        self.tell("looking for causes", 0.3)
        large = PRESLIDING in wanted and is_misfit_large(task, self.plain)
        if large and self._add_bristles([self.plain], alone=True):  # else nothing arrives
            return
        if large and self._bristles is not None and self._shift_starts(self._bristles.fits):
            return self._add_standing()
        search = begin_search(data, self.plain, self.start.guess, small, self.matters > 0)
        if self._shift_starts(search.joint):
            return self._add_standing()
        found = search_from(search)
        if self._shift_starts(found.joint):
            return self._add_standing()
        self.scores = run_score_tests(task, self.plain, small)
        self.visible |= {effect: score.visible for effect, score in self.scores.items()}
        found, p_values, base, curve = self._weigh_causes(found)
        without, bristles = found.joint, None
        sure = curve is not None and curve.share > NEARLY_ALL
        if PRESLIDING in wanted and not sure and self._is_poor(found, p_values, base):
            if self._add_bristles([base, found.joint]):
                return
            outside = self.explained is False and self.share > BACKGROUND
            if self.matters > 0 and (outside or looks_like_bristles(found)):
                bristles = search_beside_bristles(found, self.plain)
        rests = bristles is None and curve is None and self.matters > 0
        if rests and (beyond := search_beyond_edge(found, self.start.guess)) is not None:
            self._take_task(beyond.data.task)
            found, p_values, base, curve = self._weigh_causes(beyond)
        task = found.data.task
        if bristles is not None:
            found, p_values, base = self._choose_causes(bristles)
            self.explained = True
        elif curve is not None:
            self.outside, self.explained = curve.location, False
            return
        items, share = tuple(p_values), self.share
        self.base = self.whole = base
        if items and self.tell is not silent:
            tell_answer("what stands out, before it is judged", [x.effect for x in items])
        if self.base is not self.plain:
            bristly = [PRESLIDING] * (bristles is not None)
            bare = self._leave_out(self.base, *(item.effect for item in items), *bristly)
            value = ensemble.criterion(task, ensemble.join(self.plain, bare))
            if value[1] < value[0]:
                self.plain, self.lack = bare, measure_lack_of_fit(task, bare)
                self.considered = fit_singles(task, bare, found)
        if share > BACKGROUND:
            assumed, self.whole = fit_beside_background(found.data, found, items)
            self._take_task(assumed)
        elif not items and found.evidence.excess < ARRIVED:
            self.friction = average_over_sets(found.evidence, base, found.sets)
        self._add_causes(found, p_values)
        # A fit that has not arrived is not averaged; a dwell that is no cause is not in mu_s.
        if share > BACKGROUND and found.evidence.excess < ARRIVED:
            told = {one.best.effect for one in self.named}
            told -= {DWELL_EFFECT} - {one.best.effect for one in self._list_causes()}
            kept = tuple(item for item in items if item.effect in told)
            self.friction = estimate_friction(found.evidence, kept, USUAL_SHARE)
        if bristles is not None:
            one = weigh_bristles(self.start.data, self.whole or self.base, without)
            self.named, self.considered = [*self.named, NamedCause(one, (one,), without)], [one]
        self.total = max(self.lack.excess, *(one.best.drop for one in self.named), 1.0)

    def _shift_starts(self, at: Fits) -> bool:
        """Begin anew with each push corrected, where the fit `at` says that its trigger, zero or
        speed was off."""
        start = shift_by_offsets(self.setup, self.start, at, self.tell)
        if start is None:
            return False
        folds = self.validation.folds
        anew = self.begin(self.setup, start, folds, self.matters, self.tell)
        self.start, self.validation = anew.start, anew.validation
        self.plain, self.lack, self.base = anew.plain, anew.lack, anew.base
        self.__dict__.pop("_bristles", None)  # which were fitted to the samples as they were
        return True

    def _weigh_causes(
        self, found: BackgroundSearch
    ) -> tuple[BackgroundSearch, dict[PossibleCause, float], Fits, CurveFit | None]:
        """Do as `_choose_causes`, and return the curve too that explains more, if any."""
        found, p_values, base = self._choose_causes(found)
        curve, beside = None, self.share > BACKGROUND
        self.explained, self.curves = None, ()
        if p_values or beside:
            self.tell("comparing with free curves", 0.6)
            compared = compare_with_curves(found.data, found, tuple(p_values), self.plain, base)
            # What a curve changes by less than matters is left, and is told as what is left.
            self.explained = not compared.is_outside or compared.change < self.matters
            self.curves = compared.leading
            if beside:
                curve = fit_curve_for_causes(found, p_values, compared, self.lack.excess)
        return found, p_values, base, curve

    def _take_task(self, task: EnsembleTask) -> None:
        """Fit with another task from now on."""
        self.start = replace(self.start, data=replace(self.start.data, task=task))
        self.validation = CrossValidation(task, self.validation.folds)

    def _choose_causes(
        self, found: BackgroundSearch
    ) -> tuple[BackgroundSearch, dict[PossibleCause, float], Fits]:
        """Choose the causes that stand out where a search ended: return the search with their set
        as its best, their p-values, and the fit with them and no background."""
        task = self.start.data.task
        self.considered = fit_singles(task, found.plain, found)
        found = choose_by_fits(task, found.plain, found, self.considered)
        items, p_values = choose_significant(task, found, SIGNIFICANT)
        if self.matters > 0:
            outstanding = list_outstanding(found.evidence, items)
            self.usual = frozenset(item.effect for item in items) - outstanding
        self.share = found.evidence.estimate_share(items)
        base = fit_causes(task, found.plain, found, items)
        if items and self.share <= BACKGROUND and self.validation.speaks_against(base, self.plain):
            found, fewer = choose_foreseen(self.validation, found, items, SIGNIFICANT)
            return found, fewer, found.fitted or found.plain
        return found, dict(zip(items, p_values, strict=True)), base

    def _is_poor(
        self, found: BackgroundSearch, items: Collection[PossibleCause], base: Fits
    ) -> bool:
        """Whether the causes that were chosen leave room for bristles, or may stand for them."""
        if self.explained is False or may_stand_for_bristles(found, items):
            return True
        nothing = not items and self.share <= BACKGROUND
        return nothing and not self.validation.is_at_floor(base)

    def _add_causes(self, found: BackgroundSearch, p_values: Mapping[PossibleCause, float]) -> None:
        """Add causes with their p-values, but for those without which the fit is as good."""
        task, items, named = self.start.data.task, tuple(p_values), []
        for item, p_value in p_values.items():
            whole = self.whole or self.base
            price = 2 * compute_price(found.evidence, [item])
            without = self._leave_out(whole, item.effect, enough=_FAR_ABOVE * price)
            value = ensemble.criterion(task, ensemble.join(without, whole))
            drop = float(value[0] - value[1])
            if drop < price:
                self.base, self.whole = self._leave_out(self.base, item.effect), without
                left = {one: p for one, p in p_values.items() if one is not item}
                return self._add_causes(found, left)
            predicted = self.scores[item.effect].drop if item.effect in self.scores else 0.0
            one = CandidateCause(item.effect, whole, drop, predicted, p_value, drop - price)
            by_fits = self.share <= BACKGROUND
            others = compare_rivals(found.data.task, self.base, found, items, one, by_fits)
            named.append(NamedCause(one, others, without))
        self.named += named
        return None

    @cached_property
    def _bristles(self) -> CandidateCause | None:
        """Bristles on top of the plain fit, where they explain it."""
        data = self.start.data
        return explore_bristles(data.task, self.plain, data.scales, len(data.looked_for))

    def _add_bristles(self, rivals: Sequence[Fits], alone: bool = False) -> bool:
        """Add bristles, and tell so, where they beat the `rivals` and, `alone`, leave but noise."""
        self.tell("looking for bristles", 0.3 if alone else 0.65)
        task, plain, one = self.start.data.task, self.plain, self._bristles
        if one is None or (alone and not self.validation.is_at_floor(one.fits)):
            return False
        value = ensemble.criterion(task, ensemble.join(plain, *rivals))
        more = np.array([len(rival.extra[0]) - len(plain.extra[0]) for rival in rivals])
        if one.penalised_drop <= (value[0] - value[1:] - task.price * more).max():
            return False
        self.base = self.whole = one.fits
        self.named, self.considered = [NamedCause(one, (one,), plain)], [one]
        self.total, self.explained = max(self.lack.excess, one.drop), True
        return True
