"""What a diagnosis says: the verdict, its causes, and what they gained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.result import Fit
from difffric.diagnosis.cross_validation import Remaining
from difffric.diagnosis.data import DiagnosisData
from difffric.diagnosis.exploration import CandidateCause
from difffric.diagnosis.impossible_measurements import Certificate
from difffric.diagnosis.lack_of_fit import LackOfFit
from difffric.diagnosis.location import Location
from difffric.diagnosis.misfit import Misfit
from difffric.diagnosis.next_experiment import Experiment
from difffric.estimation import ensemble
from difffric.estimation.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import CATALOGUE, RATIO, component_of, numbers_of
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup

ADEQUATE, NAMED, AMBIGUOUS, UNEXPLAINED = "adequate", "named", "ambiguous", "unexplained"
_RATIO_TEXT = "mu_k / mu_s is not what the set-up says"
_DRIFT, _DWELL = "friction_drift.drift", "static_dwell.amplitude"
_TAU = next(key.null for key in CATALOGUE["static_dwell"].keys if key.name == "tau_s")
"""Time [s] after which a rest begins to count, which is fixed."""
_STEP = 1e-3
"""Relative change of mu_s by which F_p and d are differentiated: far above the error with which
a push is followed, and so small that nothing but the slope is seen."""
_TELLS = 0.1
"""Relative change of F_p, or of d, by that of mu_s: below, nobody infers mu_s from it."""


@dataclass(frozen=True)
class Changes:
    """What an effect changes: relative, root mean square over the pushes."""

    mu_s: float
    """of the mu_s that is inferred, all that is free fitted anew without the effect"""
    peak_force: float
    """of F_p, all else as it is"""
    sliding_distance: float
    """of d likewise"""
    as_mu_s: float
    """the largest of the three as a share of mu_s: F_p and d count as the change of mu_s that
    changes them as much"""


@dataclass(frozen=True)
class Cause:
    """One effect that the data show."""

    id: str
    component: str
    text: str
    """what a person reads"""
    probability: float
    """among the effects of the catalogue, one more being there"""
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

    @property
    def change(self) -> float:
        """By how much it changes what a push does: the larger change of F_p and d."""
        return max(self.change_peak_force, self.change_sliding_distance)

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
    """what the set-up lacks, the largest change first"""
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
    """of each push, drift and dwell included, by the model with all that was detected"""
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
                f"{cause.probability:.2f}" + (f", confusable with {alike}" if alike else "")
            )
            for name, (value, error) in cause.parameters.items():
                sure = f"+/- {error:.2g}" if isfinite(error) else "(error not determined)"
                lines.append(f"        {name} = {value:.5g} {sure}")
        lines += [f"    negligible: {cause.id}" for cause in self.negligible]
        g = self.gain
        lines.append(
            f"    error on held-out pushes, in units of the noise: {g.before:.3g} before, "
            f"{g.after:.3g} after ({g.noise_floor:.3g} is perfect)"
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
        probability=1.0,
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
    )


def measure_changes(task: EnsembleTask, without: Fits, at: Fits, effect: str) -> Changes:
    """Measure what an effect changes in the fit `at`; `without` is a fit that lacks it (both
    ensembles of one).

    Pushes without a d, with the effect or without it, say nothing of d.
    """
    n, index = task.n, task.model.coordinates.indices(numbers_of(effect))
    c = np.repeat(at.c, 4 * n, axis=0).reshape(4, n, -1)
    c[:, :, 0] = at.mu[0, task.condition] + at.own[0]
    c[1][:, index] = without.c[0, index]
    c[2:, :, 0] += np.array([[_STEP], [-_STEP]])
    none = np.zeros((0, c.shape[2]))
    answers = task.model.answers(np.tile(np.arange(n), 4), c.reshape(4 * n, -1), none)
    there, without_it, up, down = answers.model.reshape(4, n, 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        change = there / without_it - 1
        slope = (up - down) / (2 * _STEP * there)
    force, distance = (_take_rms(x) for x in change.T)
    moved = _take_rms(find_friction(task, at) - find_friction(task, without))
    slopes = (max(_take_rms(x), _TELLS) for x in slope.T)
    by_force, by_distance = (x / y for x, y in zip((force, distance), slopes, strict=True))
    return Changes(moved, force, distance, max(moved, by_force, by_distance))


def _take_rms(x: NDArray) -> float:
    """Return the root mean square of what is finite of x (n,), 0 where nothing is."""
    x = x[np.isfinite(x)]
    return float(np.sqrt(np.mean(x**2))) if len(x) else 0.0


def find_friction(task: EnsembleTask, fits: Fits) -> NDArray:
    """Return the log mu_s (n,) that each push had by a fit (an ensemble of one): with the drift up
    to it, and what static friction grew by in the rest before it."""
    coordinates = task.model.coordinates
    found = fits.mu[0, task.condition] + fits.own[0]
    if _DRIFT in coordinates.names:
        (drift,) = coordinates.values(fits.c[0], (_DRIFT,))
        found = found + np.log1p(drift * np.asarray(task.model.pushes.share))
    if _DWELL in coordinates.names:
        (amplitude,) = coordinates.values(fits.c[0], (_DWELL,))
        found = found + np.log1p(amplitude * _grow_in_rest(task.model.pushes))
    return found


def compute_friction_errors(task: EnsembleTask, fits: Fits, unseen: float = 0.0) -> NDArray:
    """Return the standard errors (n,) of the log mu_s of `find_friction`; `unseen` is what a small
    effect that no push can tell from mu_s (a normal force, where all have one mass) does to it.

    A push's own mu_s is known as well as its own data and the scatter say, where the parameters
    are known; their covariance adds what they do to it. All is as much larger as what the fit
    leaves beyond the noise.
    """
    if not task.mu_free:
        return np.zeros(task.n)
    parts = ensemble.split_by_push(task, fits)
    weight = parts.z[0] + 1.0 / fits.scatter[0] ** 2
    slope = -parts.h[0] / weight[:, None]
    slope[np.arange(task.n), task.condition] += 1.0
    columns = [*task.shared, *fits.extra[0]]
    for i, change in differentiate_friction(task, fits.c[0]).items():
        if i in columns:
            slope[:, task.conditions + columns.index(i)] += change
    covariance = ensemble.covariance(task, fits)[0]
    variance = 1.0 / weight + np.einsum("np,pq,nq->n", slope, covariance, slope)
    squares = np.einsum("nk,k->", fits.gram[0, ..., -1, -1], fits.spread[0] ** -2.0)
    freedom = max(task.counts.sum() - slope.shape[1] - task.n, 1.0)
    return np.sqrt(variance * max(float(squares) / freedom, 1.0) + unseen**2)


def differentiate_friction(task: EnsembleTask, c: NDArray) -> dict[int, NDArray]:
    """Return the derivatives (n,) of each push's log mu_s by those of the coordinates c (K,) that
    say how it changes from push to push, by their numbers."""
    coordinates, found = task.model.coordinates, {}
    for name in (_DRIFT, _DWELL):
        for i in coordinates.indices([name]) if name in coordinates.names else ():
            pushes = task.model.pushes
            by = np.asarray(pushes.share) if name == _DRIFT else _grow_in_rest(pushes)
            (value,) = coordinates.values(c, (name,))
            found[i] = coordinates.unit[i] * by / (1.0 + value * by)
    return found


def _grow_in_rest(pushes: Any) -> NDArray:
    """By what share of the amplitude of a dwell static friction grew in the rest before each
    push."""
    return np.log1p(np.asarray(pushes.rest) / _TAU)
