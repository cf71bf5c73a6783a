"""The cause of a change: which parameter, if it had changed, explains the pushes after an alarm.

Where the logarithm of a parameter changes by delta, log mu_s and the contrast of a push move, and
the model says by how much, exactly at every delta. The score test at delta = 0, as `diagnose` makes
it, predicts how much of the misfit each candidate explains; a refit by Gauss-Newton says it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.compute import pytrees
from difffric.compute.xla_options import compile_soon
from difffric.identification.tabulated_model import TabulatedModel
from difffric.measurements.pushes import Pushes
from difffric.monitoring.readings import Reader
from difffric.rig import catalogue, parameters
from difffric.simulation.observables import observe

CANDIDATES = {
    "mu_s": "friction",
    "k_N_per_m": "stiffness",
    "b_N_s_per_m": "damping",
    "force_gain.factor": "gain of the force sensor",
    "probe_scale.factor": "scale of the probe",
}
"""Parameters that may have changed, and what a person calls them."""
NAMED = 0.9
"""Probability from which the likeliest parameter is named."""
UNEXPLAINED = 1e-3
"""p-value below which what a parameter leaves unexplained is more than noise."""
MOST = 0.9
"""Share of the misfit from which a parameter is named although more than noise is left."""
_TYPICAL = 0.3  # standard deviation [log] of a change before anything is known of it
_LARGEST = 1.0  # largest change [log] that is looked at: a factor of e
_STEPS = 8  # of Gauss-Newton at most; it ends before where it has converged

Pair = Sequence[NDArray] | NDArray
"""A vector (n,) of log mu_s and one of the contrast."""


@dataclass(frozen=True)
class Setting:
    """The pushes of a part at one speed before the change, in SI units."""

    velocity: float
    mass: float
    """NaN: the rig's own"""
    stroke: float
    """NaN: the rig's own"""
    sigma: tuple[float, ...]
    """errors of F_p [N] and d [m]; infinite: not measured"""
    log_mu_s: float
    """mean over the pushes"""
    contrast: float
    """mean over the pushes; NaN: not known"""
    variances: tuple[float, ...]
    """of those two means; infinite: not known"""
    spreads: tuple[float, ...]
    """variance of one push: of log mu_s over h, and of the contrast"""
    counts: tuple[float, ...]
    """numbers of pushes behind those two"""

    def as_list(self) -> list[Any]:
        """Return the fields as a state file holds them: in order, null where one is not finite."""
        return _to_json(astuple(self))

    @classmethod
    def read(cls, saved: Sequence[Any]) -> Setting:
        """Return the setting that `as_list` gave."""
        return cls(*_from_json(saved))


@dataclass(frozen=True)
class After:
    """A push after the change."""

    cell: str
    """whose setting it belongs to"""
    log_mu_s: float
    h: float
    """variance of log_mu_s, but for a factor that is the setting's"""
    contrast: float
    """NaN: not known"""

    def as_list(self) -> list[Any]:
        """Return the fields as a state file holds them: in order, null where one is not finite."""
        return _to_json(astuple(self))

    @classmethod
    def read(cls, saved: Sequence[Any]) -> After:
        """Return the push that `as_list` gave."""
        return cls(*_from_json(saved))


@dataclass(frozen=True)
class ChangeCause:
    """A parameter that may have changed, and how well that explains the pushes after the change."""

    parameter: str
    change: float
    """the size that explains them best, relative"""
    standard_error: float | None
    """of the change; None: the pushes do not feel the parameter"""
    predicted: float
    """drop of chi-square, as the score test predicts it"""
    drop: float
    """drop of chi-square by the refit"""
    explained: float
    """the drop as a share of chi-square"""
    left: float
    """p-value of what is left, by an F-test, as the spreads before are estimates too"""
    probability: float = 0.0
    """of this parameter among all candidates"""

    @property
    def words(self) -> str:
        """The parameter and its change, for a person."""
        error = "" if self.standard_error is None else f" ± {100 * self.standard_error:.1f}"
        return f"{CANDIDATES[self.parameter]} {100 * self.change:+.1f}{error} %"

    def as_dict(self) -> dict:
        """Return the cause as `result.json` holds it."""
        return {
            "parameter": self.parameter,
            "text": CANDIDATES[self.parameter],
            "change": self.change,
            "standard_error": self.standard_error,
            "chi2_drop_predicted": self.predicted,
            "chi2_drop": self.drop,
            "explained": self.explained,
            "p_value": self.left,
            "probability": self.probability,
        }


def find_causes(
    reader: Reader, settings: Mapping[str, Setting], after: Sequence[After]
) -> list[ChangeCause]:
    """Find what may have changed before the pushes `after`, the likeliest first.

    `settings` has the pushes before the change, by cell. Pushes of other cells are left out; where
    none is left there is nothing to compare with, and the answer is empty.

    Each change is taken to be normal with a standard deviation of 0.3 beforehand, and the
    probabilities are those of the candidates against each other, by Laplace's approximation.
    """
    after = [x for x in after if x.cell in settings]
    if not after:
        return []
    known = parameters.names(_add_sensors(reader.rig))
    names = tuple(n for n in CANDIDATES if n in known and n != "mu_s")
    data = _Residuals(settings, after, names)
    found = [_refit(reader, data, name) for name in ("mu_s", *data.names)]
    found = [x for x in found if x is not None]
    evidence = np.array(
        [0.5 * c.drop - 0.5 * np.log1p(_TYPICAL**2 * information) for c, information in found]
    )
    share = np.exp(evidence - evidence.max())
    share /= share.sum()
    causes = [
        replace(cause, probability=float(p)) for (cause, _), p in zip(found, share, strict=True)
    ]
    return sorted(causes, key=lambda c: -c.probability)


def conclude(found: Sequence[ChangeCause]) -> tuple[str | None, str]:
    """Return the parameter that is named, None where none can be, and what to say to a person.

    `found` is what `find_causes` gave.
    """
    if not found:
        return None, "nothing to compare with"
    best = found[0]
    rest = "" if best.left >= UNEXPLAINED else ", and leaves more than noise"
    if rest and best.explained < 0.5:
        return None, "none of the parameters explains it"
    if best.probability >= NAMED:
        named = not rest or best.explained >= MOST
        words = f"{best.words} fits best{rest}" if rest else best.words
        return best.parameter if named else None, words
    alike = [c for c in found if c.probability > 0.05 * best.probability]
    return None, "cannot be told: " + ", or ".join(c.words for c in alike) + rest


class _Residuals:
    """Residuals of the pushes after the change against the means before, and their covariance.

    `names` are the parameters other than mu_s that may have changed.
    """

    def __init__(
        self, settings: Mapping[str, Setting], after: Sequence[After], names: tuple[str, ...]
    ):
        cells = list(dict.fromkeys(x.cell for x in after))
        self.settings, self.names = [settings[cell] for cell in cells], names
        self.at = np.array([cells.index(x.cell) for x in after])
        means = np.array([[s.log_mu_s, s.contrast] for s in self.settings])
        variances = np.array([s.variances for s in self.settings])
        spreads = np.array([s.spreads for s in self.settings])
        seen = np.array([[x.log_mu_s, x.contrast] for x in after])
        residual = (seen - means[self.at]).T
        same = self.at[:, None] == self.at
        h = np.array([[x.h, 1.0] for x in after])
        self.residual, self.inverse = [], []
        for j in (0, 1):
            V = np.diag(spreads[self.at, j] * h[:, j]) + np.where(same, variances[self.at, j], 0.0)
            gone = ~np.isfinite(residual[j])
            V[gone] = V[:, gone] = 0.0
            V[gone, gone] = 1.0
            weight = np.linalg.inv(V)
            weight[gone, gone] = 0.0
            self.residual.append(np.where(gone, 0.0, residual[j]))
            self.inverse.append(weight)
        self.numbers = int(np.isfinite(residual).sum())
        used = sorted(set(self.at.tolist()))
        self.count = max(float(sum(sum(self.settings[i].counts) for i in used)), 1.0)

    def compute_p_value(self, left: float, fitted: int) -> float:
        """Return the p-value of a chi-square that is left after so many numbers were fitted."""
        free = max(self.numbers - fitted, 1)
        return float(scipy.stats.f.sf(left / free, free, self.count))

    def product(self, a: Pair, b: Pair) -> float:
        """The product of two pairs of vectors over the covariance."""
        return float(sum(x @ W @ y for x, W, y in zip(a, self.inverse, b, strict=True)))


def _add_sensors(rig):
    """Return the rig with gains of its sensors that can change."""
    new = {"force_gain": {"factor": 1.0}, "probe_scale": {"factor": 1.0}}
    there = {name.split(".")[0] for name in catalogue.parameter_names(rig)}
    return catalogue.extended(rig, {k: x for k, x in new.items() if k not in there})


def _compute_shifts(
    reader: Reader, data: _Residuals, name: str, delta: float
) -> tuple[NDArray, NDArray]:
    """Return by how much log mu_s and contrast change in each setting (settings, 2), and the
    derivative of that by delta; NaN where the model cannot say."""
    shift, slope = np.full((2, len(data.settings), 2), np.nan)
    for i, s in enumerate(data.settings):
        if name == "mu_s":
            shift[i], slope[i] = (delta, 0.0), (1.0, 0.0)
            continue
        curve = reader.curve(s.velocity, s.mass, s.stroke)
        F_d, by = _shift_setting(curve, s.log_mu_s, data.names, data.names.index(name), delta)
        there = np.isfinite(s.sigma)
        (F, d), se = np.where(there, F_d, np.nan), np.where(there, s.sigma, np.nan)
        push = Pushes(
            velocity=np.array([s.velocity]),
            peak_force=np.array([F]),
            sliding_distance=np.array([d]),
            mass=np.array([s.mass]),
            stroke=np.array([s.stroke]),
            peak_force_se=se[:1],
            sliding_distance_se=se[1:],
        )
        read = reader.read(push, s.log_mu_s)
        if read.reason[0]:
            continue
        x = read.log_mu_s
        J = np.nan_to_num(curve.observe(x)[1][:, 0]) / s.sigma
        rho = np.nan_to_num(by) / s.sigma
        size = np.hypot(*J)
        shift[i] = x[0] - s.log_mu_s, read.contrast[0]
        slope[i] = J @ rho / size**2, (rho[1] * J[0] - rho[0] * J[1]) / size
    return shift, slope


def _shift_setting(
    curve: TabulatedModel, log_mu_s: float, names: tuple[str, ...], which: int, delta: float
) -> tuple[NDArray, NDArray]:
    """Return F_p and d (2,) of a setting where the logarithm of parameter `which` of `names` has
    changed by delta, and their derivatives by delta."""
    along = np.eye(len(names))[which]
    rig = pytrees.as_arrays(_add_sensors(curve.rig))
    given = (np.asarray(x, float) for x in (curve.velocity, log_mu_s, along, delta))
    both, by = _observe_with_shift(rig, *given, names, curve.integrator)
    return np.asarray(both), np.asarray(by)


@compile_soon
def _observe_with_shift(rig, velocity, log_mu_s, along, delta, names, integrator):
    def measure(delta):
        now = parameters.values(rig)
        new = {n: now[n] * jnp.exp(delta * along[i]) for i, n in enumerate(names)}
        at = parameters.with_values(rig, {**new, "mu_s": jnp.exp(log_mu_s)})
        seen = observe(at, velocity, integrator)
        return jnp.stack([seen.peak_force, seen.sliding_distance])

    return jax.jvp(measure, (delta,), (jnp.ones_like(delta),))


def _refit(reader: Reader, data: _Residuals, name: str) -> tuple[ChangeCause, float] | None:
    """Fit the change of one parameter. Returns the candidate and the information on delta, or None
    where the model cannot say."""
    nothing = data.product(data.residual, data.residual)

    def at(delta):
        shift, slope = (
            np.nan_to_num(x[data.at].T) for x in _compute_shifts(reader, data, name, delta)
        )
        left = [r - s for r, s in zip(data.residual, shift, strict=True)]
        return left, slope, data.product(left, left)

    delta, (left, slope, worst) = 0.0, at(0.0)
    information, gradient = data.product(slope, slope), data.product(slope, left)
    if information <= 0:
        return ChangeCause(name, 0.0, None, 0.0, 0.0, 0.0, data.compute_p_value(nothing, 0)), 0.0
    predicted = gradient**2 / information
    for _ in range(_STEPS):
        step = gradient / information
        for _ in range(5):  # a step that does not help is halved
            new = float(np.clip(delta + step, -_LARGEST, _LARGEST))
            found = at(new)
            if found[2] <= worst:
                break
            step *= 0.5
        else:
            break
        moved, delta = abs(new - delta), new
        left, slope, worst = found
        information, gradient = data.product(slope, slope), data.product(slope, left)
        if moved < 1e-6 or information <= 0:
            break
    if information <= 0:
        return None
    change = float(np.expm1(delta))
    error = float((1.0 + change) / np.sqrt(information))
    drop, p_value = nothing - worst, data.compute_p_value(worst, 1)
    return ChangeCause(name, change, error, predicted, drop, drop / nothing, p_value), information


def _to_json(values: Iterable[Any]) -> list[Any]:
    """Numbers, texts and tuples of numbers as JSON can hold them: null for what is not finite."""
    out: list[Any] = []
    for x in values:
        if isinstance(x, tuple):
            out.append(_to_json(x))
        else:
            out.append(None if isinstance(x, float) and not math.isfinite(x) else x)
    return out


def _from_json(saved: Iterable[Any]) -> list[Any]:
    """Undo `_to_json`: null stands for infinity in a list, for NaN elsewhere."""
    out: list[Any] = []
    for x in saved:
        if isinstance(x, list):
            out.append(tuple(math.inf if v is None else v for v in x))
        else:
            out.append(math.nan if x is None else x)
    return out
