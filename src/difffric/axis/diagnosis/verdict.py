"""What a diagnosis of an axis says."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from difffric.axis.result import AxisFit
from difffric.axis.setup import AxisSetup
from difffric.number_text import format_number, format_pair

ADEQUATE, NAMED, AMBIGUOUS, UNEXPLAINED = "adequate", "named", "ambiguous", "unexplained"


@dataclass(frozen=True)
class AxisCause:
    """An effect that the data show."""

    id: str
    component: str
    text: str
    parameters: dict[str, tuple[float, float]]
    """key -> (value, standard error)"""
    chi2_drop: float
    """of -2 log likelihood, by the refit"""
    chi2_drop_predicted: float
    """by the screening"""
    p_value: float
    """of so large a drop by chance, all looks counted"""
    probability: float
    """among the effects of the table, one more being there"""
    confusable_with: tuple[str, ...]
    force: float
    """[N] root mean square of what it adds, beside what plain parameters could take over"""
    change: float
    """that force as a share of Coulomb friction"""

    def as_dict(self) -> dict:
        """Return what `result.json` holds."""
        return {
            "id": self.id,
            "component": self.component,
            "text": self.text,
            "probability": self.probability,
            "confusable_with": list(self.confusable_with),
            "parameters": {
                key: {"value": value, "standard_error": error}
                for key, (value, error) in self.parameters.items()
            },
            "chi2_drop_predicted": self.chi2_drop_predicted,
            "chi2_drop": self.chi2_drop,
            "p_value": self.p_value,
            "force_N": self.force,
            "change": self.change,
        }


@dataclass(frozen=True)
class AxisGain:
    """Errors on stretches held out, in units of the noise: 1 is perfect."""

    before: float | None
    after: float | None


@dataclass(frozen=True)
class AxisRemainder:
    """What is left after all causes."""

    force: float
    """[N] root mean square of a force that nothing explains"""
    p_value: float
    share: float
    """of Coulomb friction"""
    location: str


@dataclass(frozen=True)
class AxisDiagnosis:
    """What the plain axis lacks."""

    verdict: str
    causes: tuple[AxisCause, ...]
    negligible: tuple[AxisCause, ...]
    gain: AxisGain
    remaining: AxisRemainder | None
    lack_of_fit: float
    """p-value of the plain axis with an encoder that is all the noise there is"""
    not_visible: tuple[str, ...]
    next_experiment: str | None
    plain: AxisFit
    fit: AxisFit
    """with all causes"""

    @property
    def setup(self) -> AxisSetup:
        """The extended set-up."""
        return self.fit.setup

    @property
    def location(self) -> str | None:
        """Where the misfit sits where no effect explains it."""
        return self.remaining.location if self.verdict == UNEXPLAINED and self.remaining else None

    def summarise(self) -> Iterator[str]:
        """Yield what it says in a line or two."""
        yield f"Verdict: {self.verdict}."
        for cause in self.causes:
            numbers = ", ".join(
                f"{key} = {' ± '.join(format_pair(*pair))}"
                for key, pair in cause.parameters.items()
            )
            others = f"; or {', '.join(cause.confusable_with)}" if cause.confusable_with else ""
            yield f"{cause.text} ({cause.id}: {numbers}){others}."
        for cause in self.negligible:
            yield f"Negligible: {cause.id} ({cause.force:.3g} N)."
        if self.remaining is not None:
            left = self.remaining
            yield (
                f"Left over: a force of {format_number(left.force, 3)} N rms "
                f"({100 * left.share:.2g} % of Coulomb friction, p = {left.p_value:.2g}) that "
                f"nothing in the table explains, by its shape of: {left.location}."
            )
        if self.next_experiment:
            yield f"Next: {self.next_experiment}."
        for one in self.fit.not_identifiable:
            yield f"Open: {', '.join(one['parameters'])}: {one['reason']}."
        for note in self.fit.notes:
            yield f"Note: {note}."

    def as_dict(self) -> dict:
        """Return what `result.json` holds."""
        left = self.remaining
        return {
            "kind": "axis",
            "verdict": self.verdict,
            "lack_of_fit": {"p_value": self.lack_of_fit},
            "causes": [x.as_dict() for x in self.causes],
            "negligible": [x.as_dict() for x in self.negligible],
            "location": self.location,
            "gain": {
                "heldout_nrmse_before": self.gain.before,
                "heldout_nrmse_after": self.gain.after,
                "noise_floor": 1.0,
            },
            "remaining": None
            if left is None
            else {
                "force_N": left.force,
                "p_value": left.p_value,
                "share_of_coulomb": left.share,
                "location": left.location,
                "heldout_nrmse": self.gain.after,
            },
            "not_visible": list(self.not_visible),
            "next_experiment": self.next_experiment,
            "fit": self.fit.as_dict(),
        }

    def __str__(self) -> str:
        return "\n".join(self.summarise())
