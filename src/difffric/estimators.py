"""mu_s of each push: from the force, from the distance, by equation (7), and by the
statistically optimal combination, each with its standard error.
"""

from __future__ import annotations

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from difffric import parameters
from difffric.family import family
from difffric.fit import Fit, rigs_of
from difffric.inversion import BRACKET, Inversion, invert
from difffric.observables import observe
from difffric.pushes import Pushes
from difffric.rig import Rig
from difffric.simulate import REGIMES
from difffric.surrogate import weighted


@dataclass(frozen=True)
class Estimate:
    """A value with its standard error; None: it does not exist, or nobody knows."""

    value: float | None
    standard_error: float | None = None

    def as_dict(self) -> dict | None:
        """As `result.json` holds it."""
        if self.value is None:
            return None
        return {"value": self.value, "standard_error": self.standard_error}


@dataclass(frozen=True)
class PushFriction:
    """What one push says of mu_s."""

    velocity: float
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
    reason: str | None

    def as_dict(self) -> dict:
        """As `result.json` holds it."""
        return {
            "velocity_m_per_s": self.velocity,
            "condition": self.condition,
            "regime": self.regime,
            "mu_s_force": self.mu_s_force.as_dict(),
            "mu_s_distance": self.mu_s_distance.as_dict(),
            "mu_s_weighted": self.mu_s_weighted.as_dict(),
            "mu_s_optimal": self.mu_s_optimal.as_dict(),
            "weights": self.weights,
            "alternatives": list(self.alternatives),
            "reason": self.reason,
        }


def sensor_errors(rig: Rig) -> tuple[float | None, float | None]:
    """Standard errors of F_p [N] and d [m] that the rig's sensors alone explain.

    d is the difference of two readings, each with its noise and its quantum. None where a
    sensor's noise is not known.
    """
    F, probe = rig.force_sensor.noise, rig.probe
    if probe.noise is None:
        return F, None
    return F, float(np.sqrt(2 * (probe.noise**2 + probe.resolution**2 / 12)))


def identify(
    rig: Rig | Fit,
    pushes: Pushes,
    *,
    range_ratio: float | None = None,
    bracket=BRACKET,
    integrator=None,
) -> list[PushFriction]:
    """mu_s of each push, four ways.

    The errors of F_p and d are the pushes' own, else the fit's spreads, else the sensors'
    noise. Given a `Fit`, its uncertainty is carried through the exact derivatives (it is
    shared by force and distance, and the optimal combination takes that into account).
    `range_ratio` is equation (7)'s ratio of the ranges [N/m]; by default over 500-5000 mm/min
    and mu_s 0.05-0.30 of this rig.

    Where several mu_s give the measured d, the one whose F_p is nearest to the measured one is
    taken (without a force, the smallest), and all stand in `alternatives`.
    """
    calibration = rig if isinstance(rig, Fit) else None
    if isinstance(rig, Fit):
        rig, fallback = rig.rig, (rig.spread_force, rig.spread_distance)
    else:
        fallback = sensor_errors(rig)
    if range_ratio is None:
        range_ratio = family(rig, integrator=integrator).range_ratio
    rigs = rigs_of(rig, pushes)
    options = {"bracket": bracket, "integrator": integrator}
    force = invert(rigs, pushes.velocity, pushes.peak_force, "peak_force", **options)
    distance = invert(
        rigs, pushes.velocity, pushes.sliding_distance, "sliding_distance", **options
    )
    distance = _supported_by_force(rigs, pushes, force, distance, integrator)
    points = [_best_guess(f, d) for f, d in zip(force, distance, strict=True)]
    gradients = _gradients(rigs, pushes, force, distance, calibration, integrator)
    regimes = _regimes(rigs, pushes, points, integrator)
    se = [
        np.where(np.isnan(own), np.nan if other is None else other, own)
        for own, other in zip(
            (pushes.peak_force_se, pushes.sliding_distance_se), fallback, strict=True
        )
    ]
    return [
        _combine(
            pushes, i, force[i], distance[i], (se[0][i], se[1][i]), gradients[i], calibration,
            range_ratio, regimes[i],
        )
        for i in range(len(pushes))
    ]  # fmt: skip


def _best_guess(force: Inversion, distance: Inversion) -> float:
    known = [x.value for x in (force, distance) if x.value is not None]
    return float(np.mean(known)) if known else np.nan


def _combine(pushes, i, force, distance, se, gradient, calibration, range_ratio, regime):
    """One push: the two inversions, (7), and generalised least squares on both."""
    pair = (force, distance)
    exists = np.array([x.value is not None for x in pair])
    mu = np.array([np.nan if x.value is None else x.value for x in pair])
    slope = np.array([np.nan if x.slope is None else x.slope for x in pair])
    covariance = np.diag((np.array(se) / slope) ** 2)
    if calibration is not None:
        by_parameter = gradient / slope[:, None]
        covariance = covariance + by_parameter @ calibration.covariance @ by_parameter.T

    def error(weights):
        used = weights != 0
        variance = weights[used] @ covariance[np.ix_(used, used)] @ weights[used]
        return float(np.sqrt(variance)) if np.isfinite(variance) else None

    def estimate(weights):
        used = weights != 0
        return Estimate(float(weights[used] @ mu[used]), error(weights))

    none = Estimate(None)
    single = [estimate(np.eye(2)[j]) if exists[j] else none for j in range(2)]
    by_7, weights, best = none, None, none
    if exists.all():
        _, w_F, w_d = weighted(*mu, *slope, range_ratio)
        weights = {"force": float(w_F), "distance": float(w_d)}
        by_7 = estimate(np.array([w_F, w_d]))
        if np.isfinite(covariance).all():
            w = np.linalg.solve(covariance, np.ones(2))
            best = estimate(w / w.sum())
    elif exists.any():
        best = single[int(np.argmax(exists))]
    reasons = [x.reason for x in pair if x.reason]
    return PushFriction(
        velocity=float(pushes.velocity[i]),
        condition=pushes.condition[i],
        regime=regime,
        mu_s_force=single[0],
        mu_s_distance=single[1],
        mu_s_weighted=by_7,
        mu_s_optimal=best,
        weights=weights,
        alternatives=distance.alternatives,
        reason="; ".join(reasons) or None,
    )


@eqx.filter_jit
def _observe_at(rigs, velocity, mu_s, integrator):
    def one(rig, velocity, mu_s):
        seen = observe(parameters.with_values(rig, {"mu_s": mu_s}), velocity, integrator)
        return seen.peak_force, seen.regime

    return jax.vmap(one)(rigs, velocity, mu_s)


def _supported_by_force(rigs, pushes, force, distance, integrator):
    """Among several mu_s for one distance, the one that the measured force supports."""
    chosen = list(distance)
    for i, inversion in enumerate(distance):
        if not inversion.alternatives or np.isnan(pushes.peak_force[i]):
            continue
        several = np.array(inversion.alternatives)
        copies = jax.tree.map(lambda leaf, i=i: jnp.repeat(leaf[i], len(several)), rigs)
        velocity = np.full(len(several), pushes.velocity[i])
        F, _ = _observe_at(copies, velocity, several, integrator)
        nearest = int(np.argmin(np.abs(np.asarray(F) - pushes.peak_force[i])))
        chosen[i] = inversion.at(nearest)
    return chosen


def _regimes(rigs, pushes, mu_s, integrator) -> list[str | None]:
    safe = np.where(np.isnan(mu_s), 0.1, mu_s)
    _, regime = _observe_at(rigs, pushes.velocity, safe, integrator)
    return [
        None if np.isnan(mu) else REGIMES[int(r)]
        for mu, r in zip(mu_s, np.asarray(regime), strict=True)
    ]


@eqx.filter_jit
def _gradient_batch(rigs, velocity, mu_force, mu_dist, free, integrator):
    """Derivatives of F_p (at mu_force) and d (at mu_dist) by the logarithms of `free`."""

    def one(rig, velocity, mu_force, mu_dist):
        def measured(shift):
            values = parameters.values(rig)
            new = {name: values[name] * jnp.exp(shift[i]) for i, name in enumerate(free)}
            rig_F = parameters.with_values(rig, {**new, "mu_s": mu_force})
            rig_d = parameters.with_values(rig, {**new, "mu_s": mu_dist})
            F = observe(rig_F, velocity, integrator).peak_force
            return jnp.stack([F, observe(rig_d, velocity, integrator).sliding_distance])

        return jax.jacfwd(measured)(jnp.zeros(len(free)))

    return jax.vmap(one)(rigs, velocity, mu_force, mu_dist)


def _gradients(rigs, pushes, force, distance, calibration, integrator) -> NDArray:
    """One (2, number of calibrated parameters) array a push."""
    if calibration is None:
        return np.zeros((len(pushes), 2, 0))
    mu = [np.array([0.1 if x.value is None else x.value for x in xs]) for xs in (force, distance)]
    return np.asarray(
        _gradient_batch(rigs, pushes.velocity, *mu, calibration.free, integrator)
    )
