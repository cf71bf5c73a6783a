"""What a fit of an axis gives: its numbers, their errors, and what the data leave open."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import overload

import numpy as np
from numpy.typing import NDArray

from difffric.axis.breakaway import BreakawayForce
from difffric.axis.motion_model import RunData
from difffric.axis.recordings import AxisRecordings
from difffric.axis.setup import AxisSetup
from difffric.number_text import format_pair


@dataclass(frozen=True)
class FrictionLevel:
    """The Coulomb friction that one stretch had."""

    stretch: str
    condition: str | None
    coulomb: float | None
    """[N]; None: the stretch does not say"""
    standard_error: float | None
    reason: str | None = None

    def as_dict(self) -> dict:
        """Return what `result.json` holds of it."""
        answer = {"value": self.coulomb, "standard_error": self.standard_error}
        return {
            "stretch": self.stretch,
            "condition": self.condition,
            "coulomb_N": answer,
            "reason": self.reason,
        }


@dataclass(frozen=True)
class AxisLevels(Sequence[FrictionLevel]):
    """The friction level of each stretch, in their order; prints itself, gives arrays."""

    levels: tuple[FrictionLevel, ...]

    def __len__(self) -> int:
        return len(self.levels)

    @overload
    def __getitem__(self, index: int) -> FrictionLevel: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[FrictionLevel, ...]: ...
    def __getitem__(self, index):
        return self.levels[index]

    @property
    def coulomb(self) -> NDArray:
        """(n,) Coulomb friction [N]; NaN where a stretch does not say."""
        return np.array([x.coulomb for x in self.levels], float)

    @property
    def standard_error(self) -> NDArray:
        """(n,) of it [N]."""
        return np.array([x.standard_error for x in self.levels], float)

    def as_dict(self) -> dict:
        """Return what `result.json` holds of it."""
        return {"stretches": [x.as_dict() for x in self.levels]}

    def __str__(self) -> str:
        rows = []
        for x in self.levels:
            value, error = format_pair(x.coulomb, x.standard_error)
            said = x.reason or f"{value} ± {error} N"
            rows.append(f"{x.stretch}: {said}")
        return "\n".join(rows)


@dataclass(frozen=True)
class AxisNoise:
    """Noise as it was found in the data."""

    encoder: float
    """[m] white, of one sample"""
    encoder_coloured: float
    """[m] of one sample, correlated over 20 ms and more"""
    force: float
    """[N] root mean square of a force that neither drive nor friction explains"""
    force_p_value: float | None
    """of such a force by chance; None: not tested"""


@dataclass(frozen=True)
class AxisFit:
    """A fitted axis."""

    setup: AxisSetup
    """with the fitted numbers"""
    names: tuple[str, ...]
    """of the free parameters, without the break-away force"""
    covariance: NDArray
    """(names, names)"""
    scatter: float
    """relative standard deviation of the friction level from stretch to stretch"""
    scatter_error: float
    noise: AxisNoise
    levels: tuple[FrictionLevel, ...]
    breakaway: BreakawayForce | None
    not_identifiable: tuple[dict, ...]
    """each: `parameters`, `reason`, `next_stretch`"""
    chi2: float
    degrees_of_freedom: int
    criterion: float
    """-2 log restricted likelihood"""
    converged: bool
    imposed: bool
    """whether the motion was imposed, and the force is what answers"""
    notes: tuple[str, ...]
    data: AxisRecordings
    """cut into the stretches that were fitted"""
    runs: Sequence[RunData] = field(default=(), repr=False)
    """what was fitted, run by run"""

    @property
    def rig(self) -> AxisSetup:
        """The fitted axis, as `Fit.rig` is the fitted rig."""
        return self.setup

    @property
    def fitted_setup(self) -> AxisSetup:
        """The fitted axis with its standard errors, as it is written back."""
        return self.setup

    def value(self, name: str) -> float:
        """Return a parameter's value, such as that of `mass_kg`."""
        return self.setup.values[name]

    def standard_error(self, name: str) -> float | None:
        """Return a parameter's standard error; None where it was held, or is left open."""
        if name == "breakaway_N":
            return None if self.breakaway is None else self.breakaway.standard_error
        if name not in self.names:
            return None
        i = self.names.index(name)
        return math.sqrt(max(self.covariance[i, i], 0.0))

    @property
    def reduced_chi2(self) -> float:
        """Squared residuals in units of the noise, by degrees of freedom."""
        return self.chi2 / max(self.degrees_of_freedom, 1)

    @property
    def correlation(self) -> NDArray:
        """(names, names)"""
        sigma = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        return self.covariance / np.outer(sigma, sigma)

    def list_parameters(self) -> list[str]:
        """Return all free parameters, the break-away force where something stuck."""
        return [*self.names, *(["breakaway_N"] if self.breakaway is not None else [])]

    def as_dict(self) -> dict:
        """Return what `result.json` holds."""
        correlation = self.correlation
        listed = self.list_parameters()
        return {
            "kind": "axis",
            "parameters": {
                x: {"value": self.value(x), "standard_error": self.standard_error(x)}
                for x in listed
            },
            "correlation": {
                a: {b: correlation[i, j] for j, b in enumerate(self.names) if i != j}
                for i, a in enumerate(self.names)
            },
            "not_identifiable": [dict(x) for x in self.not_identifiable],
            "reduced_chi2": self.reduced_chi2,
            "converged": self.converged,
            "scatter": {"value": self.scatter, "standard_error": self.scatter_error},
            "noise": {
                "encoder_m": self.noise.encoder,
                "encoder_coloured_m": self.noise.encoder_coloured,
                "force_N": self.noise.force,
                "force_p_value": self.noise.force_p_value,
            },
            "motion": "imposed" if self.imposed else "driven",
            "stretches": [x.as_dict() for x in self.levels],
            "breakaways": [] if self.breakaway is None else self.breakaway.events,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        lines = ["Axis fitted" if self.converged else "Axis, NOT converged"]
        for name in self.list_parameters():
            value, error = format_pair(self.value(name), self.standard_error(name))
            lines.append(f"  {name:<20} {value} ± {error}")
        lines += [f"  open: {', '.join(x['parameters'])}: {x['reason']}"
                  for x in self.not_identifiable]  # fmt: skip
        return "\n".join([*lines, *(f"  note: {x}" for x in self.notes)])


def collect_reasons(open_parameters: Sequence[dict]) -> str:
    """Return in one line which parameters are open, for a summary; empty where none is."""
    return ", ".join(name for one in open_parameters for name in one["parameters"])
