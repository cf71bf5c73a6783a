"""mu_s of each push: from the force, from the distance, by equation (7), by the statistically
optimal combination, from the free slide, and from whole recordings, each with its standard error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from difffric.calibration.result import Fit
from difffric.compute import pytrees
from difffric.compute.pytrees import pick
from difffric.compute.xla_options import soon_compiled
from difffric.estimation import coordinates
from difffric.estimation.coordinates import shift_value, to_value
from difffric.estimation.push_rigs import rigs_of
from difffric.estimation.stacked_data import sensor_errors
from difffric.identification.estimates import NONE, Estimate, Identified, PushFriction
from difffric.identification.free_slide import slide_friction
from difffric.identification.inversion import BRACKET, Inversion, both_at, invert, model_at
from difffric.identification.surrogates import weighted
from difffric.identification.whole_recording import trace_friction
from difffric.measurements.checks import checked_data
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.measurements.reduction.reduce import Reduction, reduce_recordings
from difffric.progress import Tell, silent
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup, check_rig
from difffric.simulation.families import MU_S, SPEEDS_MM_MIN
from difffric.simulation.observables import observe, regime_of
from difffric.simulation.segments import REGIMES, default_integrator
from difffric.units import from_mm_min


@dataclass(frozen=True)
class Calibration:
    """What is known of the rig: its values by condition, and how uncertain they are."""

    rig: Rig
    names: tuple[str, ...]
    """calibrated parameters, without mu_s"""
    of: Callable[[str], tuple[Rig, NDArray]]
    """condition -> rig, covariance of the coordinates of `names`"""
    spreads: tuple[float, float]
    """of F_p [N] and d [m], as the calibration found them; NaN: it did not"""

    @classmethod
    def read(cls, rig: Rig | Setup | Fit) -> Calibration:
        """From a fit its covariance, from a set-up its standard errors (without correlations)."""
        if isinstance(rig, Fit):
            fit = rig
            names = tuple(dict.fromkeys(n for n in fit.names if n != "mu_s"))

            def of_fit(condition: str) -> tuple[Rig, NDArray]:
                at, columns = fit.for_condition(condition)
                here = [j for j, n in enumerate(names) if n in columns]
                found = [columns[names[j]] for j in here]
                covariance = np.zeros((len(names), len(names)))
                covariance[np.ix_(here, here)] = fit.covariance[np.ix_(found, found)]
                return at, covariance

            return cls(fit.rig, names, of_fit, (fit.spread_force, fit.spread_distance))
        setup = rig if isinstance(rig, Setup) else Setup(rig)
        values = parameters.values(setup.rig)
        errors = {
            name: x.standard_error
            for name, x in setup.extras.items()
            if name in values and name != "mu_s" and x.standard_error
        }
        variance = [(e / coordinates.slope(n, float(values[n]))) ** 2 for n, e in errors.items()]
        return cls(
            setup.rig,
            tuple(errors),
            lambda condition: (setup.rig, np.diag(variance)),
            (np.nan, np.nan),
        )


def identify(
    rig: Rig | Setup | Fit,
    data: Pushes | Recordings,
    *,
    range_ratio: float | None = None,
    bracket=BRACKET,
    use_data_mass: bool = False,
    skip_bad: bool = False,
    tell: Tell = silent,
    integrator=None,
) -> Identified:
    """mu_s of each push: from F_p, from d, by (7), the optimal combination; from a recording
    also from all its samples; from a release speed and d also from the free slide alone.

    The errors of F_p and d are the pushes' own, else the fit's spreads, else the sensors'
    noise. A `Fit`'s covariance is carried through the exact derivatives (it is shared by force
    and distance, and the optimal combination takes that into account), of a `Setup` the
    standard errors that it states, as if they were uncorrelated.
    `range_ratio` is equation (7)'s ratio of the ranges [N/m]; by default over 500-5000 mm/min
    and mu_s 0.05-0.30 of this rig. `tell(what, share done)` hears of the progress.

    Where several mu_s give the measured d, the one whose F_p is nearest to the measured one is
    taken (without a force, the smallest), and all stand in `alternatives`.

    Raises `InputError` for data that cannot be used with the rig (`data_checks`).
    """
    known = Calibration.read(rig)
    check_rig(known.rig)
    reduction = None
    if isinstance(data, Recordings):
        data = checked_data(data, known.rig, use_data_mass=use_data_mass, skip_bad=skip_bad)
        tell("reducing the recordings", 0.0)
        reduction = reduce_recordings(data, skip_bad=skip_bad)
        pushes = reduction.pushes
    else:
        pushes = checked_data(data, known.rig, use_data_mass=use_data_mass, skip_bad=skip_bad)
    integrator = integrator or default_integrator(known.rig)
    of = [known.of(c) for c in pushes.condition]
    rigs = rigs_of(known.rig, pushes)
    for name in dict.fromkeys((*known.names, "mu_s")):
        own = jnp.array([float(parameters.values(r)[name]) for r, _ in of])
        if name != "mass_kg":
            rigs = parameters.with_values(rigs, {name: own})
    roots = np.stack([root_of(c) for _, c in of])
    if pushes.free_slides:
        answers = [
            PushFriction(np.nan, c, None, NONE, NONE, NONE, NONE, None, (), None, None)
            for c in pushes.condition
        ]
    else:
        tell("inverting forces and distances", 0.2)
        options = {"bracket": bracket, "integrator": integrator}
        answers = _inverted(known, rigs, pushes, roots, range_ratio, options)
    answers = _with_slides(known, rigs, pushes, roots, answers)
    if reduction is not None:
        tell("fitting every sample", 0.6)
        answers = _with_traces(known, [r for r, _ in of], reduction, roots, answers, integrator)
    tell("done", 1.0)
    return Identified(tuple(answers), pushes.skipped)


def root_of(covariance: NDArray) -> NDArray:
    """R with R R^T the covariance, which may be singular: of a parameter that is held."""
    variance, axes = np.linalg.eigh(covariance)
    return axes * np.sqrt(np.maximum(variance, 0.0))


def _inverted(known, rigs, pushes, roots, range_ratio, options) -> list[PushFriction]:
    """Force, distance, (7) and the optimum of every push."""
    integrator = options["integrator"]
    if range_ratio is None:
        range_ratio = range_ratio_of(known.rig, integrator)
    velocity = pushes.velocity
    force = invert(rigs, velocity, pushes.peak_force, "peak_force", **options)
    distance = invert(rigs, velocity, pushes.sliding_distance, "sliding_distance", **options)
    distance = supported_by_force(rigs, pushes, distance, integrator)
    gradients, regimes = around(rigs, pushes, force, distance, known.names, integrator)
    fallback = [
        sensor if np.isnan(spread) else spread
        for spread, sensor in zip(known.spreads, sensor_errors(known.rig), strict=True)
    ]
    own_se = (pushes.peak_force_se, pushes.sliding_distance_se)
    se = [
        np.where(np.isnan(own), np.nan if other is None else other, own)
        for own, other in zip(own_se, fallback, strict=True)
    ]
    return [
        combine(
            pushes, i, force[i], distance[i], (se[0][i], se[1][i]), gradients[i], roots[i],
            range_ratio, regimes[i],
        )
        for i in range(len(pushes))
    ]  # fmt: skip


def range_ratio_of(rig: Rig, integrator) -> float:
    """Delta F / Delta d of equation (7) [N/m], as `Family.range_ratio`, over the paper's range."""
    v, mu_s = (x.ravel() for x in np.meshgrid(from_mm_min(SPEEDS_MM_MIN), MU_S, indexing="ij"))
    rigs = pytrees.replicate(rig, mu_s.size)
    (F, d), _, _ = both_at(rigs, v, mu_s, integrator)
    return float(np.ptp(F) / (np.nanmax(d) - np.nanmin(d)))


def _estimate(value, error, shared) -> Estimate:
    if not np.isfinite(value):
        return NONE
    part = tuple(map(float, shared)) if np.isfinite(shared).all() else ()
    return Estimate(float(value), float(error) if np.isfinite(error) else None, part)


def _with_slides(known, rigs, pushes, roots, answers) -> list[PushFriction]:
    """The answers with what the free slides say, where a release speed was measured."""
    v, d = pushes.release_velocity, pushes.sliding_distance
    if not (np.isfinite(v) & np.isfinite(d)).any() or not rigs.friction.affine:
        return answers
    k_v = np.zeros((len(pushes), roots.shape[2]))
    if "k_v_N_s_per_m" in known.names:
        k_v = to_value("k_v_N_s_per_m", roots[:, known.names.index("k_v_N_s_per_m")])
    d_se = pushes.sliding_distance_se
    sensor = sensor_errors(known.rig)[1]
    d_se = np.where(np.isnan(d_se), np.nan if sensor is None else sensor, d_se)
    v_se = pushes.release_velocity_se
    v_se = np.where(np.isnan(v_se) & pushes.free_slides, 0.0, v_se)
    mu, error = slide_friction(rigs, v, v_se, d, d_se, np.linalg.norm(k_v, axis=1))
    nothing = np.zeros(len(pushes))
    _, per_k_v = slide_friction(rigs, v, nothing, d, nothing, nothing + 1.0)
    shared = -per_k_v[:, None] * k_v  # what viscosity takes more, friction takes less
    out = []
    for i, x in enumerate(answers):
        found, reason = _estimate(mu[i], error[i], shared[i]), x.reason
        if found.value is None and pushes.free_slides:
            reason = "no mu_s gives this distance: k_v alone would stop the part sooner"
            if not (np.isfinite(v[i]) and np.isfinite(d[i])):
                reason = "a free slide needs its release speed and its distance"
        out.append(replace(x, mu_s_slide=found, reason=reason))
    return out


def _with_traces(
    known, rigs_by_push, reduction: Reduction, roots, answers, integrator
) -> list[PushFriction]:
    """The answers with what all samples say."""
    guess = np.array([x.mu_s_optimal.value or x.mu_s_force.value or np.nan for x in answers])
    found = trace_friction(rigs_by_push, reduction, guess, integrator)
    every = coordinates.names(known.rig)
    J = found.by_coordinate[:, [every.index(n) for n in known.names]]
    shared = found.mu_s[:, None] * np.einsum("ni,nij->nj", J, roots)
    error = np.sqrt(found.mu_s**2 * found.own_variance + np.sum(shared**2, axis=1))
    return [
        replace(
            x,
            mu_s_trace=_estimate(found.mu_s[i], error[i], shared[i]),
            trace_reduced_chi2=float(found.reduced_chi2[i]),
            name=reduction.recordings[i].name,
        )
        for i, x in enumerate(answers)
    ]


def combine(pushes, i, force, distance, se, gradient, root, range_ratio, regime):
    """One push: the two inversions, (7), and generalised least squares on both."""
    pair = (force, distance)
    exists = np.array([x.value is not None for x in pair])
    mu = np.array([np.nan if x.value is None else x.value for x in pair])
    slope = np.array([np.nan if x.slope is None else x.slope for x in pair])
    covariance = np.diag((np.array(se) / slope) ** 2)
    shared = -(gradient / slope[:, None]) @ root
    covariance = covariance + shared @ shared.T

    def estimate(weights):
        used = weights != 0
        w = weights[used]
        variance = w @ covariance[np.ix_(used, used)] @ w
        return _estimate(w @ mu[used], np.sqrt(variance), w @ shared[used])

    none, reasons = NONE, [x.reason for x in pair if x.reason]
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


@soon_compiled
def _at(rigs, velocity, mu_s, free, integrator):
    """(F_p, d), their derivatives by the coordinates of `free`, and the regime, at each mu_s."""

    def one(rig, velocity, mu_s):
        def measured(shift):
            values = parameters.values(rig)
            new = {name: shift_value(name, values[name], shift[i]) for i, name in enumerate(free)}
            rig_at = parameters.with_values(rig, {**new, "mu_s": mu_s})
            seen = observe(rig_at, velocity, integrator)
            both = jnp.stack([seen.peak_force, seen.sliding_distance])
            return both, (both, seen.regime)

        gradient, (both, regime) = jax.jacfwd(measured, has_aux=True)(jnp.zeros(len(free)))
        return both, gradient, regime

    return jax.vmap(one)(rigs, velocity, mu_s)


def supported_by_force(rigs, pushes, distance, integrator) -> list[Inversion]:
    """Among several mu_s for one distance, the one that the measured force supports."""
    chosen = list(distance)
    open_ = [
        i for i, x in enumerate(distance) if x.alternatives and not np.isnan(pushes.peak_force[i])
    ]
    if not open_:
        return chosen
    which = np.repeat(open_, [len(distance[i].alternatives) for i in open_])
    several = np.concatenate([distance[i].alternatives for i in open_])
    force, _, _ = model_at(
        pick(rigs, which),
        pushes.velocity[which],
        np.log(several)[:, None],
        "peak_force",
        integrator,
    )
    away = np.abs(force[:, 0] - pushes.peak_force[which])
    for i in open_:
        chosen[i] = distance[i].at(int(np.argmin(away[which == i])))
    return chosen


def around(rigs, pushes, force, distance, free, integrator):
    """For each push the derivatives (2, len(free)) of F_p at mu_force and of d at mu_dist by the
    coordinates of the calibrated parameters, and the regime between the two."""
    n = len(pushes)
    mu = np.array([[x.value or np.nan for x in xs] for xs in (force, distance)])
    known = np.isfinite(mu).sum(axis=0)
    middle = np.nansum(mu, axis=0) / np.maximum(known, 1)
    points = np.stack([*mu, middle], axis=1)
    points = np.where(np.isfinite(points) & (points > 0), points, 0.1).ravel()
    which = np.repeat(np.arange(n), 3)
    here = pick(rigs, which), pushes.velocity[which], points
    if free:
        _, gradient, regime = _at(*here, free, integrator)
    else:  # the program that has looked for the roots serves again
        gradient, regime = np.empty(0), regime_of(both_at(*here, integrator)[2])
    gradient = np.asarray(gradient).reshape(n, 3, 2, len(free))
    regime = np.asarray(regime).reshape(n, 3)[:, 2]
    names = [REGIMES[int(r)] if k else None for r, k in zip(regime, known, strict=True)]
    return np.stack([gradient[:, 0, 0], gradient[:, 1, 1]], axis=1), names
