"""What a diagnosis says: the verdict, its causes, and what they gained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

from difffric.calibration.result import Fit
from difffric.diagnosis.cross_validation import Remaining
from difffric.diagnosis.data import DiagnosisData
from difffric.diagnosis.exploration import CandidateCause
from difffric.diagnosis.impossible_measurements import Certificate
from difffric.diagnosis.inferred.changes import measure_changes
from difffric.diagnosis.lack_of_fit import LackOfFit
from difffric.diagnosis.location import Location
from difffric.diagnosis.misfit import Misfit
from difffric.diagnosis.next_experiment import Experiment
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.number_text import format_number
from difffric.rig.catalogue import CATALOGUE, RATIO, component_of, numbers_of
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup

ADEQUATE, NAMED, AMBIGUOUS, UNEXPLAINED = "adequate", "named", "ambiguous", "unexplained"
_RATIO_TEXT = "mu_k / mu_s is not what the set-up says"


@dataclass(frozen=True)
class Cause:
    """One effect that the data show."""

    id: str
    component: str
    text: str
    """what a person reads"""
    probability: float | None
    """among the effects of the catalogue, one more being there; None: it was not compared"""
    confusable_with: tuple[str, ...]
    """effects that explain nearly as much"""
    parameters: dict[str, tuple[float, float]]
    """key -> (value, standard error) [SI]; NaN: these data do not determine the error"""
    chi2_drop: float
    """drop of -2 log likelihood that the refit with it makes"""
    chi2_drop_predicted: float
    """by the score test at the null, without a refit"""
    p_value: float
    """of so large a drop by chance, all effects and looks counted"""
    heldout_gain: float
    """drop of -2 log likelihood of held-out pushes"""
    change_mu_s: float = 0.0
    """relative change (rms over the pushes) of the identified mu_s, against a fit without it"""
    change_peak_force: float = 0.0
    """relative change (rms over the pushes) of F_p that it makes"""
    change_sliding_distance: float = 0.0
    """the same of d"""
    change_as_mu_s: float = 0.0
    """the largest of the three as a share of mu_s, which decides whether it matters: F_p and d
    count as the change of mu_s that changes them as much"""
    change_of_most: float = 0.0
    """the larger of those of F_p and d, without the push that changes most: what makes a push on an
    edge jump is no larger a cause for that; half of it for what cuts pushes short"""

    def as_dict(self) -> dict[str, Any]:
        """As `result.json` holds it."""
        return {
            "id": self.id,
            "component": self.component,
            "text": self.text,
            "probability": self.probability,
            "confusable_with": list(self.confusable_with),
            "parameters": {
                name: {"value": value, "standard_error": error}
                for name, (value, error) in self.parameters.items()
            },
            "chi2_drop_predicted": self.chi2_drop_predicted,
            "chi2_drop": self.chi2_drop,
            "p_value": self.p_value,
            "heldout_gain": self.heldout_gain,
            "change_mu_s": self.change_mu_s,
            "change_peak_force": self.change_peak_force,
            "change_sliding_distance": self.change_sliding_distance,
            "change_as_mu_s": self.change_as_mu_s,
        }


@dataclass(frozen=True)
class HeldOutGain:
    """Errors on held-out pushes in units of the noise: 1 is perfect."""

    before: float
    after: float
    noise_floor: float

    def as_dict(self) -> dict[str, float]:
        """As `result.json` holds it."""
        return {
            "heldout_nrmse_before": self.before,
            "heldout_nrmse_after": self.after,
            "noise_floor": self.noise_floor,
        }


@dataclass(frozen=True)
class DiagnosisState:
    """Where the search ended: what figures draw, and what a fleet compares rigs by."""

    data: DiagnosisData
    plain: Fits
    """the plain model, an ensemble of one"""
    extended: Fits
    """the same with its causes; the plain model itself where there is none"""
    lack_before: LackOfFit
    """of the plain model"""
    lack_after: LackOfFit
    """of the model with all causes that the search found, those too that did not explain it"""


@dataclass(frozen=True)
class Diagnosis:
    """What the simulation gets wrong, why, how sure that is, and what mending it gains."""

    verdict: str
    """`adequate`, `named`, `ambiguous` or `unexplained`"""
    p_value: float | None
    """of the lack of fit of the plain model; None: the noise is not known"""
    causes: tuple[Cause, ...]
    """what the set-up lacks, the largest change of all pushes but one first"""
    negligible: tuple[Cause, ...]
    """effects that are significant, and change less than what matters"""
    location: Location | None
    """where the misfit sits that no cause explains"""
    gain: HeldOutGain
    remaining: Remaining | None
    """what is left beyond the noise; None: nothing, or the noise is not known"""
    not_visible: tuple[str, ...]
    """effects that these data cannot show, or not at their typical sizes"""
    impossible: dict[str, str]
    """effects that these data cannot show, with the reason"""
    plain: Fit
    """the fit of the plain set-up, from a single start"""
    rig: Rig
    """the plain rig refitted with its causes"""
    setup: Setup
    """the same as it is written to a file"""
    mu_s: tuple[float, ...]
    """of each push, with its drift, and its dwell where that is a cause, by the model with all that
    was detected"""
    mu_s_standard_error: tuple[float, ...]
    """of each of these: of the noise, of the causes' sizes, and of the small effects beside them"""
    change_mu_s: float = 0.0
    """relative change (rms over the pushes) of these by all causes together"""
    considered: tuple[Cause, ...] = ()
    """the leading effects on top of the plain model alone, the best first"""
    certificates: tuple[Certificate, ...] = ()
    """measurements that no value of the plain model's parameters can give"""
    experiments: tuple[Experiment, ...] = ()
    """pushes that would tell more, the most wanted first"""
    misfit: tuple[Misfit, ...] = ()
    """where the plain model misses, and what is left with the causes"""
    notes: tuple[str, ...] = ()
    state: DiagnosisState = field(repr=False, kw_only=True)
    """where the search ended"""

    @property
    def used_recordings(self) -> bool:
        """Whether it compared whole recordings, and not the reduced numbers of a table."""
        return self.state.data.task.model.recordings

    def as_dict(self) -> dict[str, Any]:
        """As `result.json` holds it."""
        return {
            "verdict": self.verdict,
            "lack_of_fit": {"p_value": self.p_value},
            "causes": [cause.as_dict() for cause in self.causes],
            "negligible": [cause.as_dict() for cause in self.negligible],
            "considered": [cause.as_dict() for cause in self.considered],
            "certificates": [one.as_dict() for one in self.certificates],
            "location": None if self.location is None else self.location.component,
            "shape": None if self.location is None else self.location.as_dict(),
            "gain": self.gain.as_dict(),
            "remaining": None if self.remaining is None else self.remaining.as_dict(),
            "not_visible": list(self.not_visible),
            "impossible": dict(self.impossible),
            "next_experiment": self.experiments[0].as_dict() if self.experiments else None,
            "experiments": [one.as_dict() for one in self.experiments],
            "misfit": [one.as_dict() for one in self.misfit],
            "mu_s": list(self.mu_s),
            "mu_s_standard_error": list(self.mu_s_standard_error),
            "change_mu_s": self.change_mu_s,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        lines = [f"[[Diagnosis]] {self.verdict}"]
        if self.remaining is not None:
            lines.append(f"    {self.remaining}")
        if self.p_value is not None:
            lines.append(f"    lack of fit of the plain model: p = {self.p_value:.2g}")
        if self.certificates:
            lines.append(f"    {len(self.certificates)} distances are beyond what any k, b give")
        for cause in self.causes:
            alike = ", ".join(cause.confusable_with)
            lines.append(
                f"    {cause.id} ({cause.component}): {cause.text}; probability "
                f"{format_number(cause.probability, 2)}"
                + (f", confusable with {alike}" if alike else "")
            )
            for name, (value, error) in cause.parameters.items():
                sure = f"+/- {error:.2g}" if isfinite(error) else "(error not determined)"
                lines.append(f"        {name} = {value:.5g} {sure}")
        lines += [f"    negligible: {cause.id}" for cause in self.negligible]
        g = self.gain
        lines.append(
            f"    error on held-out pushes, in units of the noise: {g.before:.3g} before, "
            f"{g.after:.3g} after; the noise floor is {g.noise_floor:.3g}"
        )
        if self.location:
            where = self.location
            lines.append(f"    the misfit sits in: {where.component}, over the {where.quantity}")
        if self.not_visible:
            lines.append(f"    not visible with these data: {', '.join(self.not_visible)}")
        if self.experiments:
            lines.append(f"    next: {self.experiments[0]}")
        return "\n".join([*lines, *(f"    note: {note}" for note in self.notes)])


def describe_cause(
    task: EnsembleTask,
    without: Fits,
    at: Fits,
    candidate: CandidateCause,
    alike: Sequence[str],
    predicted: float,
    gain: float,
) -> Cause:
    """Describe a candidate by its numbers in the fit `at` and by what it changes there.

    `without` is the same fit without it, all else fitted anew (both ensembles of one); `alike`
    names the effects that it is confused with, `predicted` is the score test's drop of chi-square
    and `gain` the drop on held-out pushes.
    """
    effect, coordinates = candidate.effect, task.model.coordinates
    C = ensemble.covariance(task, at)[0][task.conditions :, task.conditions :]
    names = numbers_of(effect)
    keys = ["ratio" if effect == RATIO else name.partition(".")[2] for name in names]
    errors = coordinates.errors(at.c[0], names, [*task.shared, *at.extra[0]], C)
    pairs = zip(coordinates.values(at.c[0], names), errors, strict=True)
    changes = measure_changes(task, without, at, effect)
    return Cause(
        id=effect,
        component=component_of(effect),
        text=_RATIO_TEXT if effect == RATIO else CATALOGUE[effect].text,
        probability=None,
        confusable_with=tuple(alike),
        parameters=dict(zip(keys, pairs, strict=True)),
        chi2_drop=candidate.drop,
        chi2_drop_predicted=predicted,
        p_value=candidate.p_value,
        heldout_gain=gain,
        change_mu_s=changes.mu_s,
        change_peak_force=changes.peak_force,
        change_sliding_distance=changes.sliding_distance,
        change_as_mu_s=changes.as_mu_s,
        change_of_most=changes.of_most,
    )
