"""What `identify` answers with: mu_s of each push, each estimate with its standard error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, overload

import numpy as np
from numpy.typing import NDArray

from difffric.units import to_mm_min

if TYPE_CHECKING:
    from jaxtyping import Float

WAYS = {
    "mu_s_force": "force",
    "mu_s_distance": "distance",
    "mu_s_weighted": "equation (7)",
    "mu_s_optimal": "optimal",
    "mu_s_slide": "free slide",
    "mu_s_trace": "whole recording",
}
"""The ways to mu_s, as results name them, and in words."""

MISFIT = 2.0
"""A reduced chi-square of a whole recording above this says that the model does not follow it:
noise alone brings that of a hundred samples to 1.5 once in a thousand recordings."""


@dataclass(frozen=True)
class Estimate:
    """A value with its standard error; None: it does not exist, or nobody knows."""

    value: float | None
    standard_error: float | None = None
    shared: tuple[float, ...] = field(default=(), repr=False)
    """the calibration's part of the standard error, along axes that are the same for all pushes
    of a condition: two of them have the inner product of theirs as covariance"""

    def as_dict(self) -> dict | None:
        """As `result.json` holds it."""
        if self.value is None:
            return None
        return {"value": self.value, "standard_error": self.standard_error}

    def __str__(self) -> str:
        if self.value is None:
            return "–"
        error = "" if self.standard_error is None else f" ± {self.standard_error:.2g}"
        return f"{self.value:.5g}{error}"


NONE = Estimate(None)


@dataclass(frozen=True)
class Estimates:
    """One way's mu_s of n pushes."""

    value: Float[NDArray, " n"]
    """NaN: there is none"""
    standard_error: Float[NDArray, " n"]
    """NaN: not known"""
    shared: Float[NDArray, "n k"]
    """the calibration's part of the error along its k axes (`Estimate.shared`)"""

    def row(self, i: int) -> Estimate:
        """That of one push."""
        value, error, shared = self.value[i], self.standard_error[i], self.shared[i]
        if not np.isfinite(value):
            return NONE
        part = tuple(map(float, shared)) if np.isfinite(shared).all() else ()
        return Estimate(float(value), float(error) if np.isfinite(error) else None, part)


@dataclass(frozen=True)
class PushFriction:
    """What one push says of mu_s."""

    velocity: float
    """[m/s]; NaN for a free slide"""
    condition: str
    regime: str | None
    mu_s_force: Estimate
    mu_s_distance: Estimate
    mu_s_weighted: Estimate
    mu_s_optimal: Estimate
    weights: dict[str, float] | None
    """equation (7)'s, force and distance"""
    alternatives: tuple[float, ...]
    """all mu_s in the bracket that give the measured distance, where there are several"""
    disagreement: float | None
    """mu_force minus mu_dist in standard deviations of that difference"""
    reason: str | None
    mu_s_slide: Estimate = NONE
    """from the free slide alone: release speed and distance"""
    mu_s_trace: Estimate = NONE
    """from every sample of the recording"""
    trace_reduced_chi2: float | None = None
    """how well the model with that mu_s fits the recording; 1: to the noise"""
    name: str = ""
    trace_disagreement: float | None = None
    """that of the whole recording minus that of force and distance (of the slide where they give
    none), in standard deviations of the difference"""

    @property
    def misfits(self) -> bool:
        """Whether the model does not follow the whole recording."""
        return self.trace_reduced_chi2 is not None and self.trace_reduced_chi2 > MISFIT

    @property
    def best_way(self) -> str | None:
        """The way to the best estimate (`WAYS`): of those that fit, that which uses most of the
        data."""
        order = ["mu_s_trace", "mu_s_optimal", "mu_s_slide"]
        if self.misfits:
            order = [*order[1:], order[0]]
        return next((way for way in order if getattr(self, way).value is not None), None)

    @property
    def best(self) -> Estimate:
        """The estimate that uses most of the data, of those that fit."""
        return NONE if self.best_way is None else getattr(self, self.best_way)

    def as_dict(self) -> dict:
        """As `result.json` holds it."""
        return {
            "velocity_m_per_s": self.velocity,
            "condition": self.condition,
            "regime": self.regime,
            **{way: getattr(self, way).as_dict() for way in WAYS},
            "weights": self.weights,
            "alternatives": list(self.alternatives),
            "disagreement_in_standard_deviations": self.disagreement,
            "trace_reduced_chi2": self.trace_reduced_chi2,
            "trace_disagreement_in_standard_deviations": self.trace_disagreement,
            "best": self.best_way,
            "reason": self.reason,
            "name": self.name or None,
        }


@dataclass(frozen=True)
class Identified(Sequence[PushFriction]):
    """mu_s of all pushes, an entry a push."""

    pushes: tuple[PushFriction, ...]
    skipped: tuple[str, ...] = ()
    """what of the data was left out, a line each"""
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.pushes)

    @overload
    def __getitem__(self, index: int) -> PushFriction: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[PushFriction, ...]: ...
    def __getitem__(self, index):
        return self.pushes[index]

    def values(self, way: str) -> NDArray:
        """(n,) the estimates of one way (`WAYS`), NaN where there is none."""
        return np.array([np.nan if (x := getattr(p, way).value) is None else x for p in self])

    def standard_errors(self, way: str) -> NDArray:
        """(n,) their standard errors, NaN where there is none."""
        found = (getattr(p, way).standard_error for p in self)
        return np.array([np.nan if x is None else x for x in found])

    def as_dict(self) -> dict:
        """As `result.json` holds it."""
        return {
            "pushes": [p.as_dict() for p in self],
            "skipped": list(self.skipped),
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        used = [w for w in WAYS if np.isfinite(self.values(w)).any()]
        lines = ["  mm/min  " + "".join(f"{w:<20}" for w in used)]
        for p in self:
            speed = "       –" if np.isnan(p.velocity) else f"{to_mm_min(p.velocity):8.0f}"
            cells = "".join(f"{getattr(p, w)!s:<20}" for w in used)
            lines.append(f"{speed}  {cells}{p.reason or ''}".rstrip())
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])
