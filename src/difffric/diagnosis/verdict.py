"""What a diagnosis says: the verdict, its causes, and what they bought."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite
from typing import Any

from difffric.calibration.result import Fit
from difffric.diagnosis.impossible_measurements import Certificate
from difffric.diagnosis.location import Location
from difffric.diagnosis.misfit import Misfit
from difffric.diagnosis.next_experiment import Experiment
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup

ADEQUATE, NAMED, AMBIGUOUS, UNEXPLAINED = "adequate", "named", "ambiguous", "unexplained"


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
    parameters: dict[str, tuple[float, float]]
    """key -> (value, standard error) [SI]; NaN: these data do not determine the error"""
    chi2_drop: float
    chi2_drop_predicted: float
    """by the score test at the null, without a refit"""
    p_value: float
    heldout_gain: float
    """drop of chi-square on held-out pushes"""
    change_mu_s: float = 0.0
    """relative change (rms over the pushes) of the identified mu_s, all causes together"""
    change_peak_force: float = 0.0
    """relative change (rms over the pushes) of F_p that it makes"""
    change_sliding_distance: float = 0.0
    """the same of d"""

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
        }


@dataclass(frozen=True)
class Gain:
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
class Diagnosis:
    """What the simulation gets wrong, why, how sure, and what it bought."""

    verdict: str
    p_value: float | None
    """of the lack of fit of the plain model"""
    causes: tuple[Cause, ...]
    negligible: tuple[Cause, ...]
    location: Location | None
    gain: Gain
    not_visible: tuple[str, ...]
    impossible: dict[str, str]
    """effects that these data cannot show, with the reason"""
    plain: Fit
    rig: Rig
    """the plain rig refitted with its causes"""
    setup: Setup
    """the same as it is written to a file"""
    mu_s: tuple[float, ...]
    """of each push, by the extended model"""
    considered: tuple[Cause, ...] = ()
    """the leading effects on top of the plain model alone, the best first"""
    certificates: tuple[Certificate, ...] = ()
    """measurements that no value of the plain model's parameters can give"""
    experiments: tuple[Experiment, ...] = ()
    """pushes that would tell more, the most wanted first"""
    misfit: tuple[Misfit, ...] = ()
    """where the plain model misses, and what is left with the causes"""
    notes: tuple[str, ...] = ()
    work: Any = field(default=None, repr=False)
    """the search's own state, for figures"""

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
            "not_visible": list(self.not_visible),
            "impossible": dict(self.impossible),
            "next_experiment": self.experiments[0].as_dict() if self.experiments else None,
            "experiments": [one.as_dict() for one in self.experiments],
            "misfit": [one.as_dict() for one in self.misfit],
            "mu_s": list(self.mu_s),
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        lines = [f"[[Diagnosis]] {self.verdict}"]
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
