"""What a diagnosis concludes from what its search found: the verdict, and what would tell more."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from difffric.calibration.result import Fit
from difffric.diagnosis.cross_validation import FLOOR, CrossValidation, Remaining
from difffric.diagnosis.data import DiagnosisData
from difffric.diagnosis.exploration import CandidateCause
from difffric.diagnosis.extended_setup import extend_rig, extend_setup, strip_effects
from difffric.diagnosis.impossible_measurements import Certificate
from difffric.diagnosis.inferred.friction import (
    DWELL_EFFECT,
    compute_friction_errors,
    find_friction,
)
from difffric.diagnosis.lack_of_fit import LackOfFit, is_misfit_large, measure_lack_of_fit
from difffric.diagnosis.location import Location, locate, locate_first_among, settle_location
from difffric.diagnosis.misfit import Misfit, describe_remaining, measure_misfits
from difffric.diagnosis.next_experiment import Experiment, Pair, hide_effects, plan_experiments
from difffric.diagnosis.score_test import SIGNIFICANT, Score
from difffric.diagnosis.verdict import (
    ADEQUATE,
    AMBIGUOUS,
    NAMED,
    UNEXPLAINED,
    Cause,
    Diagnosis,
    DiagnosisState,
    HeldOutGain,
    describe_cause,
)
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.stacked_data import SLIDES
from difffric.progress import Tell
from difffric.rig.free_form import FORMS
from difffric.rig.setup import Setup

LEFT = 0.3
"""Share of the systematic error that, left over, makes the misfit unexplained."""
ALIKE = 2 * np.log(20.0)
"""Drops of -2 log likelihood within this of each other do not tell two effects apart: odds of 20
to 1."""
_MUCH, _SURELY = 0.5, 6.0
"""The same where no curve explains it better than the causes, and standard deviations by which what
is left is more than noise."""
TOO_MANY = 5
"""Causes that no rig has at once without small effects besides."""
_HALF = 0.5
"""Share of what causes explain that a curve in their place has to."""
_DOUBTED = 0.1
"""The same from which a lone cause is held against components that may bend freely."""
_MISJUDGED = 0.3
"""Share of the noise's squares by which these are misjudged at most, where it is correlated and the
rest before the pushes was short: so much says nothing where no curve explains any of it."""
_FAR_MORE = 3.0
"""How many times the squares that small effects leave a plain model leaves that is wrong by far
more than they are."""
_MISSED = 0.02
"""Probability that the cause is none of those compared, or was not found where it explains most:
six of 264 made causes that were told at more than 0.99 were another."""
_VISIBLE = 3.0
"""Standard deviations at its typical size from which an effect can be seen."""
_SAME = 0.01
"""Relative difference of the mean mu_s up to which two plain fits are the same."""


@dataclass(frozen=True)
class NamedCause:
    """A cause that the search found, and what it was compared with."""

    best: CandidateCause
    others: tuple[CandidateCause, ...]
    without: Fits
    """the model that the cause is part of, refitted without it (an ensemble of one)"""

    @property
    def alike(self) -> tuple[str, ...]:
        """The effects that explain nearly as much, with which the cause is confused."""
        limit = self.best.penalised_drop
        others = (c for c in self.others if c is not self.best)
        return tuple(c.effect for c in others if limit - c.penalised_drop < ALIKE)

    @property
    def probability(self) -> float:
        """Of the cause among all that were compared, one of them being there unless missed."""
        most = self.best.penalised_drop
        weights = [np.exp(0.5 * (c.penalised_drop - most)) for c in self.others]
        total = sum(weights) + np.exp(-0.5 * most)
        return float((1.0 - _MISSED) / max(total, 1.0))


@dataclass(frozen=True)
class Findings:
    """What the search found."""

    setup: Setup
    """as it was given, with the effects that it has"""
    data: DiagnosisData
    fit: Fit
    """of the plain set-up, as `calibration` has it"""
    validation: CrossValidation
    plain: Fits
    """the best plain model, an ensemble of one"""
    whole: Fits
    """the same with all that was detected: the causes and `slight`"""
    extended: Fits
    """the same with the causes alone"""
    lack: LackOfFit
    """of the plain model"""
    causes: tuple[NamedCause, ...]
    slight: tuple[NamedCause, ...]
    """what was found like them, and is too small to matter"""
    negligible: tuple[NamedCause, ...]
    """significant in the last round, and too small to matter"""
    considered: tuple[CandidateCause, ...]
    """the first round's leaders"""
    scores: Mapping[str, Score]
    """the first round's score tests"""
    visible: Mapping[str, float]
    """the standard deviations at which each effect would be seen at its typical size, beside all
    that was found before"""
    certificates: tuple[Certificate, ...]
    total: float | None
    """what there was to explain in -2 log likelihood; None: nothing was found"""
    notes: tuple[str, ...]
    explained: bool | None = None
    """whether the causes, and a background of small effects beside them, explain the data better
    than a curve of no particular form; None: they were not compared"""
    curves: tuple[str, ...] = tuple(FORMS)
    """the free forms that may explain them"""
    outside: Location | None = None
    """what a curve in place of causes explains, where it was fitted beside a background"""
    unseen: float = 0.0
    """the relative change of mu_s by a small effect that no push can tell from it"""
    friction: tuple[np.ndarray, np.ndarray] | None = None
    """the log mu_s (n,) of the pushes and their standard errors, where small effects or sets of
    causes are averaged over, NaN where that is no friction; None: those of `whole`"""

    @property
    def scale(self) -> float:
        """What there was to explain in -2 log likelihood, or what would be noise."""
        return self.total or max(self.lack.excess, 1.0)

    @cached_property
    def drop(self) -> float:
        """By how much `whole` lowers -2 log likelihood."""
        at = (ensemble.criterion(self.data.task, fits)[0] for fits in (self.plain, self.whole))
        return float(np.subtract(*at))

    @cached_property
    def plain_surprise(self) -> float:
        """-2 log likelihood of the held-out pushes without a cause."""
        return self.validation.measure_surprise(self.plain)

    def describe(
        self, candidate: CandidateCause, without: Fits, at: Fits, alike: Sequence[str] = ()
    ) -> Cause:
        """Describe a candidate by its numbers in the fit `at`, and by what it changes against the
        fit `without` it."""
        gain = self.plain_surprise - self.validation.measure_surprise(candidate.fits)
        score = self.scores.get(candidate.effect)
        predicted = 0.0 if score is None else score.drop
        return describe_cause(self.data.task, without, at, candidate, alike, predicted, gain)


def conclude(found: Findings, tell: Tell) -> Diagnosis:
    """Conclude a diagnosis.

    Where the misfit stays unexplained the causes are dropped, and the plain model stands.
    """
    task, plain, whole, causes = found.data.task, found.plain, found.whole, found.causes
    extended, slight = found.extended, found.slight
    after = measure_lack_of_fit(task, whole)
    gain, notes = _measure_gain(found)
    arrived = found.validation.is_at_floor(whole)
    location = _locate_unexplained(found, after, arrived, tell)
    misfit = measure_misfits(found.data, plain, whole)
    if location is not None:
        location = settle_location(task, plain, location, found.data.scales)
        causes, slight, extended, whole = (), (), plain, plain
        gain = replace(gain, after=gain.before)
        misfit = measure_misfits(found.data, plain, plain)
    verdict = _judge(causes, found.certificates, location)
    unseen = _list_invisible(found, causes)
    ambiguous = causes if verdict == AMBIGUOUS else ()
    rig = extend_rig(strip_effects(found.setup)[0].rig, task, extended)
    friction, errors = _infer_friction(found, whole, location)
    errors = np.hypot(errors, _measure_ambiguity(task, causes))
    return Diagnosis(
        verdict=verdict,
        p_value=found.lack.p_value,
        causes=_describe_causes(found, causes, whole),
        considered=tuple(found.describe(c, plain, c.fits) for c in found.considered),
        certificates=found.certificates,
        negligible=(
            *_describe_causes(found, slight, whole),
            *(
                replace(
                    found.describe(one.best, one.without, one.best.fits),
                    probability=one.probability,
                )
                for one in found.negligible
            ),
        ),
        location=location,
        gain=gain,
        remaining=_tell_remaining(found, whole, gain.after, misfit, arrived and location is None),
        not_visible=unseen,
        experiments=_plan_experiments(found, whole, ambiguous, unseen, tell),
        impossible=found.data.impossible,
        plain=found.fit,
        rig=rig,
        setup=extend_setup(found.setup, rig, task, extended),
        mu_s=tuple(np.exp(friction).tolist()),
        mu_s_standard_error=tuple((np.exp(friction) * errors).tolist()),
        change_mu_s=float(np.sqrt(np.mean((friction - find_friction(task, plain)) ** 2))),
        notes=(*_note_plain_fit(found), *found.notes, *notes),
        misfit=misfit,
        state=DiagnosisState(found.data, plain, whole, found.lack, after),
    )


def _infer_friction(
    found: Findings, at: Fits, location: Location | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the log mu_s (n,) of the pushes and their standard errors (n,), where the fit `at` (an
    ensemble of one) is what the diagnosis says, with the misfit at a `location` or at none.

    What explains more says more of mu_s: a curve there, or small effects beside a plain model that
    leaves far more than they do."""
    task, told = found.data.task, found.friction
    left = [measure_lack_of_fit(task, fits).chi2.sum() for fits in (found.plain, found.whole)]
    if left[0] > _FAR_MORE * max(left[1], task.counts.sum()):
        at = found.whole
    if location is not None and (at is found.plain or location.penalised_drop > found.drop):
        told = location.friction
    if told is not None and np.isfinite(told).all():
        return told[0], np.hypot(told[1], found.unseen)
    named = {one.best.effect for one in found.causes}
    known = {name.partition(".")[0] for name in strip_effects(found.setup)[1]}
    grown = DWELL_EFFECT in named | known
    errors = compute_friction_errors(task, at, found.unseen, grown)
    return find_friction(task, at, grown), errors


def _tell_remaining(
    found: Findings, at: Fits, nrmse: float, misfit: Sequence[Misfit], arrived: bool
) -> Remaining | None:
    """Tell what is left beyond noise: of held-out pushes, or of all where few can be foreseen."""
    p_value = found.validation.measure_floor_p_value(at)
    sure = measure_lack_of_fit(found.data.task, at).p_value or 0.0
    if arrived and sure < FLOOR and is_misfit_large(found.data.task, at):
        p_value, arrived = sure, p_value is None
    if arrived or p_value is None:
        return None
    return Remaining(nrmse, p_value, describe_remaining(misfit))


def _measure_ambiguity(task: EnsembleTask, causes: Iterable[NamedCause]) -> np.ndarray:
    """Return by how much the log mu_s (n,) would differ if an effect were there that explains as
    much as the cause that is told."""
    apart = np.zeros(task.n)
    for one in causes:
        for other in one.others:
            if other.effect in one.alike:
                both = (
                    find_friction(task, x.fits, x.effect == DWELL_EFFECT) for x in (other, one.best)
                )
                apart = np.maximum(apart, np.abs(np.subtract(*both)))
    return apart


def _judge(
    causes: Sequence[NamedCause], certificates: Sequence[Certificate], location: Location | None
) -> str:
    """Choose the verdict."""
    if location is not None:
        return UNEXPLAINED
    if not causes:
        return UNEXPLAINED if certificates else ADEQUATE
    weak = any(one.best.p_value > SIGNIFICANT for one in causes)
    return AMBIGUOUS if weak or any(one.alike for one in causes) else NAMED


def _measure_gain(found: Findings) -> tuple[HeldOutGain, tuple[str, ...]]:
    """Measure the errors on held-out pushes, and note where they are without meaning."""
    validation, task = found.validation, found.data.task
    held = [
        validation.measure_squares(fits, found.whole.spread, found.plain.scatter)
        for fits in (found.plain, found.whole)
    ]
    numbers = task.counts.sum()
    spent = 0 if validation.single else task.n * (task.mu_free + task.model.recordings)
    floor = float(np.sqrt(max(numbers - spent, 1) / numbers))
    before, after = (float(np.sqrt(h.sum() / numbers)) for h in held)
    notes = ()
    if np.max(held) >= ensemble.REJECTED:
        notes = ("a held-out push could not be followed: its error is without meaning",)
    return HeldOutGain(before, after, floor), notes


def _locate_unexplained(
    found: Findings, after: LackOfFit, arrived: bool, tell: Tell
) -> Location | None:
    """Locate the misfit if the causes do not explain it: too much is left of it, or one component
    that may bend freely explains it better than all of them."""
    task, plain, whole = found.data.task, found.plain, found.whole
    if found.outside is not None or task.model.in_columns:  # no free form is followed in columns
        return found.outside
    left = 0.0 if arrived else float(np.sqrt(max(after.excess, 0.0) / found.scale))
    nothing = not found.causes and not arrived
    drop = found.drop
    if found.explained:
        much = left > _MUCH and after.excess > _SURELY * np.sqrt(2 * after.expected)
        if not much:
            return None
        tell("looking for the component", 0.92)
        location = locate(task, plain, found.data.scales, found.lack.excess)
        # What no curve explains either is left, beside the causes.
        return location if location.penalised_drop > _HALF * drop else None
    if found.explained is not None:
        tell("looking for the component", 0.92)
        given = task, plain, found.data.scales, found.lack.excess
        location = locate_first_among(found.curves, *given)
        # What a curve explains was predicted from where the causes are. Beside a background it has
        # not the whole misfit to explain, and where many causes imitate it no curve need do so.
        fitted = task.prior is None and len(found.causes) < TOO_MANY
        return None if fitted and location.penalised_drop < _HALF * drop else location
    if left < _DOUBTED and len(found.causes) < 2 and not nothing:
        return None
    tell("looking for the component", 0.92)
    location = locate(task, plain, found.data.scales, found.lack.excess)
    numbers = len(whole.extra[0]) - len(plain.extra[0])
    if nothing and location.penalised_drop < 0 and after.excess < _MISJUDGED * after.expected:
        return None
    bent = location.penalised_drop > drop - numbers * task.price
    return location if nothing or left > LEFT or bent else None


def _describe_causes(
    found: Findings, causes: Iterable[NamedCause], whole: Fits
) -> tuple[Cause, ...]:
    """Describe the causes by their numbers in the final fit."""
    described = [
        replace(
            found.describe(one.best, one.without, whole, one.alike), probability=one.probability
        )
        for one in causes
    ]
    # Every rig has many small imperfections, which good sensors see: first what counts.
    return tuple(sorted(described, key=lambda cause: -cause.change_of_most))


def _list_invisible(found: Findings, causes: Iterable[NamedCause]) -> tuple[str, ...]:
    """List the effects that these data cannot show, or not at their typical sizes."""
    seen = {one.best.effect for one in causes}
    small = [e for e, sure in found.visible.items() if sure < _VISIBLE and e not in seen]
    return (*found.data.impossible, *small)


def _plan_experiments(
    found: Findings,
    extended: Fits,
    ambiguous: Sequence[NamedCause],
    unseen: Sequence[str],
    tell: Tell,
) -> tuple[Experiment, ...]:
    """Plan what would tell the first ambiguous cause from those that look like it, and show what is
    not visible at its typical size."""
    task = found.data.task
    # Of a recorded pusher no one knows how its tip will move.
    if task.model.kind == SLIDES or found.data.measured.motion is not None:
        return ()
    tell("looking for the next experiment", 0.96)
    pairs = [
        Pair((one.best.effect, other.effect), one.best.fits, other.fits)
        for one in ambiguous[:1]
        for other in one.others
        if other.effect in one.alike
    ]
    hidden = [effect for effect in unseen if effect not in found.data.impossible]
    return plan_experiments(found.data, [*pairs, *hide_effects(task, extended, hidden)])


def _note_plain_fit(found: Findings) -> list[str]:
    """List what the plain fit says of itself, where the search went on with that fit."""
    task, plain = found.data.task, found.plain
    away = plain.mu[0, task.condition] + plain.own[0] - np.log(found.fit.mu_s)
    if abs(np.mean(away)) < _SAME:
        return [f"the plain fit: {x}" for x in found.fit.notes]
    return ["the plain fit told here is better than where its single start led (`plain`)"]
