"""What a calibration gives: the rig, and how well the data determine each number of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.calibration.report_text import format_fit
from difffric.estimation.coordinates import has_vanished, slope, to_value
from difffric.estimation.descent import Model, Settled
from difffric.estimation.open_parameters import list_undetermined, open_units
from difffric.estimation.stacked_data import RECORDINGS, SLIDES, FitData
from difffric.measurements.pushes import Pushes
from difffric.rig import parameters
from difffric.rig.parameters import PARAMETERS, Parameter
from difffric.rig.rig import Rig
from difffric.rig.setup import Extras, Setup

LEVELS = (0.68, 0.95, 0.997)
"""The confidence levels of intervals: one, two and three standard deviations."""


@dataclass(frozen=True)
class FitState:
    """Where the search of a fit ended: what profiles, predictions and designs go on from."""

    model: Model
    """what of the rig was free"""
    data: FitData
    """the measurements as the search took them"""
    at: Settled
    """the optimum"""


@dataclass(frozen=True)
class Fit:
    """A calibrated rig, with what the data say of each free parameter.

    `free` and the arrays of that length stand in one order, `conditions` and the arrays (n,) in
    that of the pushes.
    """

    rig: Rig
    """mu_s is the mean where conditions differ"""
    kind: str
    """`table`, `slides` or `recordings`"""
    free: tuple[str, ...]
    """labels as results write them: `k_N_per_m`, `mu_s[DRY]`"""
    names: tuple[str, ...]
    """the parameter behind each label"""
    theta: NDArray
    """(free,) where the fit ended, in coordinates (`estimation.coordinates`)"""
    held: tuple[str, ...]
    """free parameters that went to a bound"""
    covariance: NDArray
    """(free, free) of the coordinates, for the noise as it was known or estimated: it is not scaled
    by the reduced chi-square"""
    ahead: NDArray
    """(free,) how far beyond its bound the unbounded estimate of one that is held lies"""
    freedom: NDArray
    """(free,) degrees of freedom of the t-distribution of each: `restricted_likelihood`"""
    scatter: float
    """relative standard deviation of mu_s from push to push"""
    scatter_se: float
    """NaN: it was not estimated, or is zero"""
    spread_force: float
    """[N] the estimated standard error of F_p; NaN: it was known"""
    spread_distance: float
    """[m] the estimated standard error of d; NaN: it was known"""
    chi2: float
    """the sum of the squared residuals, each in units of its standard error"""
    degrees_of_freedom: int
    """measured numbers less what was fitted"""
    converged: bool
    """settled, and on an answer that can be one: `notes` says why not"""
    starts_at_optimum: tuple[int, int]
    """starts that reached the optimum, of how many"""
    conditions: tuple[str, ...]
    """an entry a push"""
    mu_s: NDArray
    """(n,) each push's own"""
    mu_s_se: NDArray
    """(n,) its standard error"""
    start: NDArray
    """(n,) start offsets [s]"""
    peak_force: NDArray
    """(n,) the calibrated model's F_p [N]"""
    sliding_distance: NDArray
    """(n,) the calibrated model's d [m], NaN where it does not exist"""
    state: FitState
    """the end of the search, for profiles and predictions. Not in `result.json`"""
    setup: Setup
    """the set-up that the fit started from"""
    pushes: Pushes
    """what it was fitted to, checked; recordings as they were reduced. Not in `result.json`"""
    noise: dict[str, dict[str, float]] = field(default_factory=dict)
    """what is known of each channel's noise: level, correlation"""
    samples: int = 0
    """how many numbers were measured"""
    left_out: int = 0
    """samples (block means) left out because they lie beside a jump"""
    notes: tuple[str, ...] = ()
    """what a reader should know"""
    skipped: tuple[str, ...] = ()
    """pushes that were left out, each with the reason"""
    push_names: tuple[str, ...] = ()
    """of the recordings' groups, an entry a push; empty for other data"""

    @property
    def vanished(self) -> tuple[str, ...]:
        """Free parameters that went to zero."""
        return tuple(x for x in self.held if self.value(x) <= self._parameter(x).zero)

    def _parameter(self, label: str) -> Parameter:
        """What is known of the parameter behind a label."""
        return PARAMETERS[self.names[self.index(label)]]

    @property
    def reduced_chi2(self) -> float:
        """Chi-square over its degrees of freedom."""
        return self.chi2 / max(self.degrees_of_freedom, 1)

    def index(self, label: str) -> int:
        """Where a label stands among the free parameters."""
        return self.free.index(label)

    def value(self, label: str) -> float:
        """A parameter's value [SI], by its label, or by the name of one that is not free."""
        if label in self.free:
            i = self.index(label)
            if label in self.held and has_vanished(label, self.theta[i]):
                return 0.0
            return float(to_value(self.names[i], self.theta[i]))
        return float(parameters.values(self.rig)[label])

    def standard_error(self, label: str, scaled: bool = False) -> float | None:
        """A free parameter's standard error [SI]; None at a bound, and where nothing depends on
        the parameter.

        With `scaled` it is multiplied by the root of the reduced chi-square, as befits noise that
        is known up to a factor only.
        """
        i = self.index(label)
        if label in self.held or self.covariance[i, i] == 0:
            return None
        error = abs(slope(self.names[i], self.value(label))) * np.sqrt(self.covariance[i, i])
        return float(error * (np.sqrt(self.reduced_chi2) if scaled else 1.0))

    def interval(self, label: str, level: float = 0.95) -> tuple[float, float] | None:
        """A free parameter's confidence interval [SI], from the t-distribution of its coordinate.

        At a bound the interval reaches from there to where that of the unbounded estimate ends,
        which may be the bound itself. None where the data do not feel the parameter any more.
        """
        i = self.index(label)
        variance = self.covariance[i, i]
        if label in self.held and variance == 0:
            return None
        half = scipy.stats.t.ppf(0.5 + level / 2, self.freedom[i]) * np.sqrt(variance)
        centre = self.theta[i] + self.ahead[i]
        with np.errstate(over="ignore"):  # what is not determined reaches to infinity
            low, high = (float(to_value(self.names[i], centre + s * half)) for s in (-1, 1))
        if label in self.held:
            value = self.value(label)
            low, high = (value, max(value, high)) if self.ahead[i] < 0 else (min(value, low), value)
        return (max(low, 0.0), high)

    @property
    def correlation(self) -> NDArray:
        """Correlations of the free parameters, without bounds; 0 for one that went to zero where
        no data feel it."""
        s = np.sqrt(np.diag(self.covariance))
        s = np.where(s > 0, s, np.inf)
        return self.covariance / np.outer(s, s) + np.diag(np.isinf(s).astype(float))

    @property
    def not_identifiable(self) -> list[dict]:
        """Free parameters that these data do not determine, in groups with the reason: they are
        at a bound, or their covariance leaves them open (`estimation.open_parameters`)."""
        out = []
        for label in self.free:
            if label in self.held:
                at = "zero" if label in self.vanished else f"{self.value(label):.6g}"
                side = "lower" if self._at_lower(label) else "upper"
                out.append({"parameters": [label], "reason": f"at its {side} bound, {at}"})
        open_ = [i for i, label in enumerate(self.free) if label not in self.held]
        covariance = self.covariance[np.ix_(open_, open_)]
        names = [self.names[i] for i in open_]
        unit = open_units(self.rig, names, self.fastest_speed)
        return out + list_undetermined([self.free[i] for i in open_], names, covariance, unit)

    @property
    def fastest_speed(self) -> float:
        """The fastest of the pushes, or of the slides' releases [m/s]."""
        pushes = self.state.data.pushes
        slides = self.kind == SLIDES
        return float(np.max(pushes.release_velocity if slides else pushes.velocity))

    @property
    def estimates_scatter(self) -> bool:
        """Whether the scatter of mu_s was estimated, and not held."""
        return self.state.model.estimate_scatter

    @property
    def chi2_per_sample(self) -> NDArray | None:
        """(n,) each recording's squared residuals per sample, in units of the noise: 1 is
        perfect; None for other data."""
        if self.kind != RECORDINGS:
            return None
        data, at = self.state.data, self.state.at
        r = data.weights * np.asarray(at.end.rows)[: data.n, :, -1]
        return (r**2).sum(axis=1) / data.samples_of

    def _at_lower(self, label: str) -> bool:
        return label in self.vanished or self.value(label) < self._parameter(label).upper

    def for_condition(self, condition: str) -> tuple[Rig, dict[str, int]]:
        """The rig of one condition, and where its free parameters (but mu_s) stand in `free`."""
        columns, new = {}, {}
        for j, (label, name) in enumerate(zip(self.free, self.names, strict=True)):
            if label in (name, f"{name}[{condition}]"):
                new[name] = self.value(label)
                if name != "mu_s":
                    columns[name] = j
        return parameters.with_values(self.rig, new), columns

    @property
    def fitted_setup(self) -> Setup:
        """The set-up with the fitted values and their standard errors."""
        old = self.setup
        extras = dict(old.extras)
        for label, name in zip(self.free, self.names, strict=True):
            known = extras.get(name, Extras())
            one = label == name
            extras[name] = Extras(
                standard_error=self.standard_error(label) if one else None,
                free=True,
                lower=known.lower,
                upper=known.upper,
            )
        scatter = old.mu_s_scatter
        if np.isfinite(self.scatter_se) or (self.scatter == 0 and scatter is not None):
            scatter = self.scatter
        return replace(old, rig=self.rig, mu_s_scatter=scatter, extras=extras)

    def as_dict(self) -> dict:
        """The calibration as `result.json` holds it."""
        correlation = self.correlation
        found = {}
        for label in self.free:
            interval = self.interval(label)
            found[label] = {
                "value": self.value(label),
                "standard_error": self.standard_error(label),
                "standard_error_scaled": self.standard_error(label, scaled=True),
                "interval_95": None if interval is None else list(interval),
                "degrees_of_freedom": self.freedom[self.index(label)],
            }
        return {
            "parameters": found,
            "correlation": {
                a: {b: float(correlation[i, j]) for j, b in enumerate(self.free) if j > i}
                for i, a in enumerate(self.free[:-1])
            },
            "not_identifiable": self.not_identifiable,
            "reduced_chi2": self.reduced_chi2,
            "chi2": self.chi2,
            "degrees_of_freedom": self.degrees_of_freedom,
            "converged": self.converged,
            "starts_at_optimum": list(self.starts_at_optimum),
            "mu_s_scatter": {"value": self.scatter, "standard_error": self.scatter_se},
            "spread_peak_force_N": self.spread_force,
            "spread_sliding_distance_m": self.spread_distance,
            "data": self.kind,
            "samples": self.samples,
            "left_out_beside_jumps": self.left_out,
            "noise": self.noise,
            "pushes": [
                {
                    "condition": condition,
                    "mu_s": {"value": self.mu_s[i], "standard_error": self.mu_s_se[i]},
                    "start_offset_s": self.start[i],
                    "peak_force_N": self.peak_force[i],
                    "sliding_distance_m": self.sliding_distance[i],
                }
                for i, condition in enumerate(self.conditions)
            ],
            "notes": list(self.notes),
            "skipped": list(self.skipped),
        }

    def __str__(self) -> str:
        return format_fit(self.as_dict())
