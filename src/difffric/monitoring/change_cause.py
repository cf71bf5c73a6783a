"""Which parameter changed: what each of them would do to the pushes after a change, held against
what they did.

A change of the logarithm of a parameter by delta moves log mu_s and the contrast of a push in a way
that the model says, exactly at every delta. The score test at delta = 0, as `diagnose` makes it,
predicts what each candidate explains; a refit by Gauss-Newton says it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.compute import pytrees
from difffric.compute.xla_options import soon_compiled
from difffric.identification.tabulated_inversion import Curve
from difffric.measurements.pushes import Pushes
from difffric.monitoring.readings import Reader, values
from difffric.rig import catalogue, parameters
from difffric.simulation.observables import observe

CANDIDATES = {
    "mu_s": "friction",
    "k_N_per_m": "stiffness",
    "b_N_s_per_m": "damping",
    "force_gain.factor": "gain of the force sensor",
    "probe_scale.factor": "scale of the probe",
}
"""Parameters that may have changed, in words."""
NAMED = 0.9
"""Probability from which the likeliest is named."""
UNEXPLAINED = 1e-3
"""p-value below which what is left is more than noise."""
MOST = 0.9
"""Share of the misfit from which a parameter is named although more than noise is left."""
_TYPICAL = 0.3  # [log] size of a change before anything is known of it
_LARGEST = 1.0  # [log] that is looked at
_STEPS = 8


@dataclass(frozen=True)
class Setting:
    """Pushes of a part at one speed before the change, SI units; NaN: the rig's own."""

    velocity: float
    mass: float
    stroke: float
    sigma: tuple[float, float]
    """errors of F_p [N] and d [m]; infinite: not measured"""
    log_mu_s: float
    contrast: float
    variances: tuple[float, float]
    """of those two means"""
    spreads: tuple[float, float]
    """variance of one push: of log mu_s over h, and of the contrast"""
    counts: tuple[float, float]
    """of pushes behind those variances"""


class After(NamedTuple):
    """A push after the change."""

    setting: int
    log_mu_s: float
    h: float
    contrast: float
    """NaN: not known"""


@dataclass(frozen=True)
class Candidate:
    """A parameter that may have changed."""

    parameter: str
    change: float
    """relative"""
    standard_error: float | None
    """of it; None: the pushes do not feel it"""
    predicted: float
    """drop of chi-square by the score test"""
    drop: float
    """by the refit"""
    explained: float
    """the share of chi-square that this is"""
    left: float
    """p-value of what it leaves, by an F-test, as the spreads before are estimates too"""
    probability: float = 0.0
    """among the candidates"""

    @property
    def words(self) -> str:
        """For a person, with its size."""
        error = "" if self.standard_error is None else f" ± {100 * self.standard_error:.1f}"
        return f"{CANDIDATES[self.parameter]} {100 * self.change:+.1f}{error} %"

    def as_dict(self) -> dict:
        """As `result.json` holds it."""
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


def candidates(
    reader: Reader, settings: Sequence[Setting], after: Sequence[After]
) -> list[Candidate]:
    """What may have changed before the pushes `after`, the likeliest first; none where there is
    nothing to compare with.

    Each change is taken to be normal with a standard deviation of 0.3 beforehand, and the
    probabilities are those of the candidates against each other, by Laplace's approximation.
    """
    if not after:
        return []
    known = parameters.names(_with_sensors(reader.rig))
    data = _Data(settings, after, tuple(n for n in CANDIDATES if n in known and n != "mu_s"))
    found = [_refit(reader, data, name) for name in ("mu_s", *data.names)]
    found = [x for x in found if x is not None]
    evidence = np.array(
        [0.5 * c.drop - 0.5 * np.log1p(_TYPICAL**2 * information) for c, information in found]
    )
    share = np.exp(evidence - evidence.max())
    share /= share.sum()
    told = [
        Candidate(**{**c.__dict__, "probability": float(p)})
        for (c, _), p in zip(found, share, strict=True)
    ]
    return sorted(told, key=lambda c: -c.probability)


def verdict(found: Sequence[Candidate]) -> tuple[str | None, str]:
    """(the parameter that is named, or None; what to say of it)."""
    if not found:
        return None, "nothing to compare with"
    best = found[0]
    rest = "" if best.left >= UNEXPLAINED else ", and leaves more than noise"
    if rest and best.explained < 0.5:
        return None, "none of the parameters explains it"
    if best.probability >= NAMED:
        named = not rest or best.explained >= MOST
        return best.parameter if named else None, best.words + (" fits best" + rest) * bool(rest)
    alike = [c for c in found if c.probability > 0.05 * best.probability]
    return None, "cannot be told: " + ", or ".join(c.words for c in alike) + rest


class _Data:
    """Residuals of the pushes after against the means before, and their covariance."""

    def __init__(self, settings: Sequence[Setting], after: Sequence[After], names):
        self.settings, self.names = settings, names
        self.at = np.array([x.setting for x in after])
        means = np.array([[s.log_mu_s, s.contrast] for s in settings])
        variances = np.array([s.variances for s in settings])
        spreads = np.array([s.spreads for s in settings])
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
        self.count = max(float(sum(sum(settings[i].counts) for i in used)), 1.0)

    def chance(self, left: float, fitted: int) -> float:
        """p-value of a chi-square that is left."""
        free = max(self.numbers - fitted, 1)
        return float(scipy.stats.f.sf(left / free, free, self.count))

    def product(self, a, b) -> float:
        """Of two pairs of (n,) vectors, over the covariance."""
        return float(sum(x @ W @ y for x, W, y in zip(a, self.inverse, b, strict=True)))


def _with_sensors(rig):
    """The rig with gains that can change."""
    new = {"force_gain": {"factor": 1.0}, "probe_scale": {"factor": 1.0}}
    there = {name.split(".")[0] for name in catalogue.parameter_names(rig)}
    return catalogue.extended(rig, {k: x for k, x in new.items() if k not in there})


def _shifts(reader: Reader, data: _Data, name: str, delta: float) -> tuple[NDArray, NDArray]:
    """(settings, 2) by how much log mu_s and contrast change, and its derivative by delta."""
    shift, slope = np.full((2, len(data.settings), 2), np.nan)
    for i, s in enumerate(data.settings):
        if name == "mu_s":
            shift[i], slope[i] = (delta, 0.0), (1.0, 0.0)
            continue
        curve = reader.curve(s.velocity, s.mass, s.stroke)
        F_d, by = _moved(curve, s.log_mu_s, data.names, data.names.index(name), delta)
        there = np.isfinite(s.sigma)
        (F, d), se = np.where(there, F_d, np.nan), np.where(there, s.sigma, np.nan)
        push = Pushes(*np.array([[s.velocity], [F], [d]]), mass=np.array([s.mass]),
                      stroke=np.array([s.stroke]), peak_force_se=se[:1],
                      sliding_distance_se=se[1:])  # fmt: skip
        read = reader.read(push, s.log_mu_s)
        if read.reason[0]:
            continue
        x = read.log_mu_s
        J = np.nan_to_num(values(curve, x)[1][:, 0]) / s.sigma
        rho = np.nan_to_num(by) / s.sigma
        size = np.hypot(*J)
        shift[i] = x[0] - s.log_mu_s, read.contrast[0]
        slope[i] = J @ rho / size**2, (rho[1] * J[0] - rho[0] * J[1]) / size
    return shift, slope


def _moved(curve: Curve, log_mu_s: float, names, which: int, delta: float):
    """(F_p, d) of a setting where the logarithm of one parameter has changed by delta, and their
    derivatives by it."""
    along = np.eye(len(names))[which]
    rig = pytrees.as_arrays(_with_sensors(curve.rig))
    given = (np.asarray(x, float) for x in (curve.velocity, log_mu_s, along, delta))
    both, by = _observed(rig, *given, names, curve.integrator)
    return np.asarray(both), np.asarray(by)


@soon_compiled
def _observed(rig, velocity, log_mu_s, along, delta, names, integrator):
    def measured(delta):
        now = parameters.values(rig)
        new = {n: now[n] * jnp.exp(delta * along[i]) for i, n in enumerate(names)}
        at = parameters.with_values(rig, {**new, "mu_s": jnp.exp(log_mu_s)})
        seen = observe(at, velocity, integrator)
        return jnp.stack([seen.peak_force, seen.sliding_distance])

    return jax.jvp(measured, (delta,), (jnp.ones_like(delta),))


def _refit(reader: Reader, data: _Data, name: str) -> tuple[Candidate, float] | None:
    """A candidate with its best delta, and the information on it; None: the model cannot say."""
    nothing = data.product(data.residual, data.residual)

    def at(delta):
        shift, slope = (np.nan_to_num(x[data.at].T) for x in _shifts(reader, data, name, delta))
        left = [r - s for r, s in zip(data.residual, shift, strict=True)]
        return left, slope, data.product(left, left)

    delta, (left, slope, worst) = 0.0, at(0.0)
    information, gradient = data.product(slope, slope), data.product(slope, left)
    if information <= 0:
        return Candidate(name, 0.0, None, 0.0, 0.0, 0.0, data.chance(nothing, 0)), 0.0
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
    drop, p_value = nothing - worst, data.chance(worst, 1)
    return Candidate(name, change, error, predicted, drop, drop / nothing, p_value), information
