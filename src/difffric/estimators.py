"""mu_s of each push: from the force, from the distance, by equation (7), and by the
statistically optimal combination, each with its standard error.
"""

from __future__ import annotations

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from difffric import parameters
from difffric.calibration import rigs_of
from difffric.families import family
from difffric.fit_data import sensor_errors
from difffric.fitted import Fit
from difffric.inversion import BRACKET, Inversion, invert
from difffric.observables import observe
from difffric.parameters import pick
from difffric.push import REGIMES
from difffric.pushes import Pushes
from difffric.rig import Rig
from difffric.setup_file import checked
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
    disagreement: float | None
    """mu_force minus mu_dist in standard deviations of that difference"""
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
            "disagreement_in_standard_deviations": self.disagreement,
            "reason": self.reason,
        }


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
        spreads, rig = (rig.spread_force, rig.spread_distance), rig.rig
    else:
        spreads = (np.nan, np.nan)
    fallback = [
        sensor if np.isnan(spread) else spread
        for spread, sensor in zip(spreads, sensor_errors(rig), strict=True)
    ]
    checked(rig)
    if range_ratio is None:
        range_ratio = family(rig, integrator=integrator).range_ratio
    rigs = rigs_of(rig, pushes)
    options = {"bracket": bracket, "integrator": integrator}
    force = invert(rigs, pushes.velocity, pushes.peak_force, "peak_force", **options)
    distance = invert(rigs, pushes.velocity, pushes.sliding_distance, "sliding_distance", **options)
    distance = _supported_by_force(rigs, pushes, distance, integrator)
    free = calibration.free if calibration else ()
    gradients, regimes = _around(rigs, pushes, force, distance, free, integrator)
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

    none, reasons = Estimate(None), [x.reason for x in pair if x.reason]
    single = [estimate(np.eye(2)[j]) if exists[j] else none for j in range(2)]
    by_7, weights, best, disagreement = none, None, none, None
    if exists.all():
        if not np.isfinite(range_ratio):
            reasons.append("no (7): the model gives no range of d")
        _, w_F, w_d = weighted(mu[0], mu[1], slope[0], slope[1], range_ratio)
        if np.isfinite(w_F):
            weights = {"force": float(w_F), "distance": float(w_d)}
            by_7 = estimate(np.array([w_F, w_d]))
        if np.isfinite(covariance).all():
            w = np.linalg.solve(covariance, np.ones(2))
            best = estimate(w / w.sum())
            apart = covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]
            disagreement = float((mu[0] - mu[1]) / np.sqrt(apart))
        else:
            reasons.append("no optimum: the noise of F_p or of d is not known")
    elif exists.any():
        best = single[int(np.argmax(exists))]
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
        disagreement=disagreement,
        reason="; ".join(reasons) or None,
    )


@eqx.filter_jit
def _at(rigs, velocity, mu_s, free, integrator):
    """(F_p, d), their derivatives by the logarithms of `free`, and the regime, at each mu_s."""

    def one(rig, velocity, mu_s):
        def measured(shift):
            values = parameters.values(rig)
            new = {name: values[name] * jnp.exp(shift[i]) for i, name in enumerate(free)}
            rig_at = parameters.with_values(rig, {**new, "mu_s": mu_s})
            seen = observe(rig_at, velocity, integrator)
            both = jnp.stack([seen.peak_force, seen.sliding_distance])
            return both, (both, seen.regime)

        gradient, (both, regime) = jax.jacfwd(measured, has_aux=True)(jnp.zeros(len(free)))
        return both, gradient, regime

    return jax.vmap(one)(rigs, velocity, mu_s)


def _supported_by_force(rigs, pushes, distance, integrator) -> list[Inversion]:
    """Among several mu_s for one distance, the one that the measured force supports."""
    open_ = [
        i for i, x in enumerate(distance) if x.alternatives and not np.isnan(pushes.peak_force[i])
    ]
    chosen = list(distance)
    for i in open_:
        several = np.array(distance[i].alternatives)
        copies = pick(rigs, np.full(len(several), i))
        velocity = np.full(len(several), pushes.velocity[i])
        both, _, _ = _at(copies, velocity, several, (), integrator)
        nearest = int(np.argmin(np.abs(np.asarray(both)[:, 0] - pushes.peak_force[i])))
        chosen[i] = distance[i].at(nearest)
    return chosen


def _around(rigs, pushes, force, distance, free, integrator):
    """For each push the derivatives (2, len(free)) of F_p at mu_force and of d at mu_dist by the
    logarithms of the calibrated parameters, and the regime between the two."""
    n = len(pushes)
    mu = np.array([[x.value or np.nan for x in xs] for xs in (force, distance)])
    known = np.isfinite(mu).sum(axis=0)
    middle = np.nansum(mu, axis=0) / np.maximum(known, 1)
    points = np.stack([*mu, middle], axis=1)
    points = np.where(np.isfinite(points) & (points > 0), points, 0.1).ravel()
    which = np.repeat(np.arange(n), 3)
    _, gradient, regime = _at(pick(rigs, which), pushes.velocity[which], points, free, integrator)
    gradient = np.asarray(gradient).reshape(n, 3, 2, len(free))
    regime = np.asarray(regime).reshape(n, 3)[:, 2]
    names = [REGIMES[int(r)] if k else None for r, k in zip(regime, known, strict=True)]
    return np.stack([gradient[:, 0, 0], gradient[:, 1, 1]], axis=1), names
