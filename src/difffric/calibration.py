"""Calibration: the rig's parameters from pushes whose friction is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from numpy.typing import NDArray

from difffric import parameters
from difffric.errors import InputError, NumericalError
from difffric.observables import observe
from difffric.pushes import Pushes
from difffric.rig import Rig
from difffric.setup_file import checked

FREE = ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m")
"""What a calibration with known mu_s determines by default."""

_FACTORS = (1 / 3, 1.0, 3.0)
_STEPS, _ROUNDS = 100, 20
_ARRIVED = 1e-6
"""A fit has arrived where less than this is left to gain in chi-square."""

_MAY_VANISH = ("b_N_s_per_m", "k_v_N_s_per_m")
_NOTHING = 1e-3
"""A parameter whose e-fold change moves no residual by more than this many spreads is gone."""
_UNDETERMINED = 1e12
"""Variance of the logarithm along what is not determined at all."""

_UNKNOWN = 1.0
"""A standard error of the logarithm above this says that the data do not determine the value."""


@dataclass(frozen=True)
class Fit:
    """A calibrated rig, with what the data say of each parameter.

    `covariance` is that of the logarithms of the free parameters. It holds for the spreads
    `spread_force` [N] and `spread_distance` [m], which are estimated from the residuals, so
    that the reduced chi-square is 1 by construction, unless standard errors were given.
    A spread that was not estimated is NaN.
    """

    rig: Rig
    free: tuple[str, ...]
    vanished: tuple[str, ...]
    """free parameters that went to their lower bound, zero; their covariance is zero"""
    covariance: NDArray
    spread_force: float
    spread_distance: float
    reduced_chi2: float
    converged: bool
    starts_at_optimum: tuple[int, int]
    """starts that reached the optimum, of how many"""
    peak_force: NDArray
    """the calibrated model's F_p [N]"""
    sliding_distance: NDArray
    """the calibrated model's d [m], NaN where it does not exist"""

    def value(self, name: str) -> float:
        """A parameter's value [SI]."""
        return float(parameters.values(self.rig)[name])

    def standard_error(self, name: str) -> float | None:
        """A free parameter's standard error [SI]; None at its bound."""
        if name in self.vanished:
            return None
        i = self.free.index(name)
        return self.value(name) * float(np.sqrt(self.covariance[i, i]))

    @property
    def correlation(self) -> NDArray:
        """Correlations of the free parameters; 0 for one at its bound."""
        s = np.sqrt(np.diag(self.covariance))
        s = np.where(s > 0, s, np.inf)
        return self.covariance / np.outer(s, s) + np.diag(np.isinf(s).astype(float))

    @property
    def not_identifiable(self) -> list[dict]:
        """Free parameters that these data do not determine, with the reason."""
        out = []
        for i, name in enumerate(self.free):
            if name in self.vanished:
                out.append({"parameters": [name], "reason": "at its lower bound, zero"})
                continue
            relative = float(np.sqrt(self.covariance[i, i]))
            if not relative < _UNKNOWN:
                factor = np.exp(min(relative, 50.0))
                reason = f"flat: one standard error is a factor of {factor:.3g}"
                out.append({"parameters": [name], "reason": reason})
        return out

    def as_dict(self) -> dict:
        """The calibration as `result.json` holds it."""
        correlation = self.correlation
        return {
            "parameters": {
                name: {"value": self.value(name), "standard_error": self.standard_error(name)}
                for name in self.free
            },
            "correlation": {
                a: {b: float(correlation[i, j]) for j, b in enumerate(self.free) if j > i}
                for i, a in enumerate(self.free[:-1])
            },
            "not_identifiable": self.not_identifiable,
            "reduced_chi2": self.reduced_chi2,
            "converged": self.converged,
            "spread_peak_force_N": self.spread_force,
            "spread_sliding_distance_m": self.spread_distance,
        }


def rigs_of(rig: Rig, pushes: Pushes) -> Rig:
    """The rig spread over the pushes, each with its own mass and stroke where they say so."""
    rigs = parameters.spread(rig, len(pushes))
    mass = jnp.where(jnp.isnan(pushes.mass), rigs.mass, pushes.mass)
    rigs = parameters.with_values(rigs, {"mass_kg": mass})
    if not np.isnan(pushes.stroke).all():
        default = jnp.inf if rigs.pusher.stroke is None else rigs.pusher.stroke
        stroke = jnp.where(jnp.isnan(pushes.stroke), default, pushes.stroke)
        rigs = parameters.with_stroke(rigs, stroke)
    return rigs


def _predict(rigs, velocity, free, log_values, active, integrator):
    """(F_p, d) of all pushes with the free parameters at exp(log_values), or gone."""

    def one(rig, velocity):
        new = {n: jnp.where(active[i], jnp.exp(log_values[i]), 0.0) for i, n in enumerate(free)}
        seen = observe(parameters.with_values(rig, new), velocity, integrator)
        return seen.peak_force, seen.sliding_distance

    return jax.vmap(one)(rigs, velocity)


def _residuals(rigs, velocity, measured, spreads, free, active, log_values, integrator):
    """(measured - model) / spread, forces first, 0 where nothing was measured; and the model."""
    F, d = _predict(rigs, velocity, free, log_values, active, integrator)
    # Where the model's part never leaves the tip it slides no distance: d counts as 0.
    both = jnp.stack([F, jnp.where(jnp.isnan(d), 0.0, d)])
    r = (measured - both) / spreads
    return jnp.where(jnp.isnan(measured), 0.0, r).ravel(), (F, d)


@eqx.filter_jit
def _descend(rigs, velocity, measured, spreads, free, active, starts, integrator):
    """Levenberg-Marquardt from every start at once: where each ends. Which parameters are active
    is a run-time choice: one program serves all."""

    def residuals(log_values, _):
        args = (rigs, velocity, measured, spreads, free, active, log_values, integrator)
        return _residuals(*args)[0]

    def one(start):
        solution = optx.least_squares(
            residuals,
            optx.LevenbergMarquardt(rtol=1e-8, atol=1e-8),
            start,
            max_steps=_STEPS,
            throw=False,
        )
        return solution.value

    return jax.lax.map(one, starts)


@eqx.filter_jit
def _linearise(rigs, velocity, measured, spreads, free, active, ends, integrator):
    """Residuals, their exact Jacobian and the model's (F_p, d) at every end."""

    def residuals(log_values):
        args = (rigs, velocity, measured, spreads, free, active, log_values, integrator)
        r, model = _residuals(*args)
        return r, (r, *model)

    jacobian, (r, F, d) = jax.lax.map(jax.jacfwd(residuals, has_aux=True), ends)
    return r, jacobian, F, d


def fit(
    rig: Rig,
    pushes: Pushes,
    *,
    free: Sequence[str] = FREE,
    several_starts: bool = True,
    integrator=None,
) -> Fit:
    """Calibrate the free parameters of a rig on pushes whose mu_s is known (`mu_s_gauge`).

    Least squares in log-parameters by optimistix's Levenberg-Marquardt on exact forward-mode
    Jacobians, from the rig's values and (`several_starts`) factors of 3 about k and b. Where no
    standard errors are given, the spreads of F_p and of d are estimated with the rest
    (restricted maximum likelihood: each squared sum over its own degrees of freedom, repeated
    until it stands).

    Raises `InputError` without a gauge or with fewer measurements than free parameters, and
    `NumericalError` where no start gives a finite misfit.
    """
    checked(rig)
    free = tuple(free)
    known = [name for name in parameters.names(rig) if name != "mu_s"]
    if not free or not set(free) <= set(known):
        raise InputError(f"fit: free must be some of {', '.join(known)}; got {', '.join(free)}")
    if np.isnan(pushes.mu_s_gauge).any():
        raise InputError("fit: mu_s_gauge is missing in at least one push; it is needed here")
    rigs = rigs_of(rig, pushes)
    rigs = parameters.with_values(rigs, {"mu_s": jnp.asarray(pushes.mu_s_gauge)})
    measured = np.stack([pushes.peak_force, pushes.sliding_distance])
    given = np.stack([pushes.peak_force_se, pushes.sliding_distance_se])
    present = np.isfinite(measured)
    if present.sum() <= len(free):
        raise InputError(f"fit: {present.sum()} measurements cannot determine {len(free)} values")
    velocity = jnp.asarray(pushes.velocity)
    values = parameters.values(rig)
    centre = np.log([max(float(values[name]), 1e-3) for name in free])
    starts = _starts(free, centre) if several_starts else jnp.asarray(centre)[None]

    spread = [np.std(row[p]) if p.any() else 1.0 for row, p in zip(measured, present, strict=True)]
    spread = np.maximum(0.05 * np.array(spread), 1e-12)
    estimated = present & np.isnan(given)
    active, every, settled = np.ones(len(free), bool), True, False
    for _ in range(_ROUNDS):
        # All starts at once, then the best one only (in the same program) while the spreads
        # settle, and all of them again to see how many arrive.
        starting = starts if every else jnp.broadcast_to(best_end, starts.shape)
        spreads = np.where(np.isnan(given), spread[:, None], given)
        problem = (rigs, velocity, measured, spreads, free, active)
        ends = np.asarray(_descend(*problem, starting, integrator))
        r, jacobian, F, d = map(np.asarray, _linearise(*problem, ends, integrator))
        chi2 = np.sum(r**2, axis=1)
        if not np.isfinite(chi2).any():
            raise NumericalError("fit: no start gives a finite misfit")
        best = int(np.nanargmin(chi2))
        best_end, r, jacobian = jnp.asarray(ends[best]), r[best], jacobian[best]
        gone = _gone(free, jacobian) & active
        new = _spreads(r, jacobian, present, spreads, spread, given)
        settled = np.allclose(new, spread, rtol=1e-5) and not gone.any()
        if settled and every:
            break
        active, every, spread = active & ~gone, settled, new

    fitted = np.where(active, np.exp(np.asarray(best_end)), 0.0)
    reached = int(np.sum(np.abs(chi2 - chi2[best]) < 1e-6 * max(chi2[best], 1.0)))
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(active, active)] = _inverse(jacobian[:, active].T @ jacobian[:, active])
    return Fit(
        rig=parameters.with_values(rig, dict(zip(free, fitted.tolist(), strict=True))),
        free=free,
        vanished=tuple(name for name, on in zip(free, active, strict=True) if not on),
        covariance=covariance,
        spread_force=float(spread[0]) if estimated[0].any() else np.nan,
        spread_distance=float(spread[1]) if estimated[1].any() else np.nan,
        reduced_chi2=float(chi2[best] / (present.sum() - active.sum())),
        converged=_still_to_gain(r, jacobian) < _ARRIVED and settled,
        starts_at_optimum=(reached, len(chi2)),
        peak_force=F[best],
        sliding_distance=d[best],
    )


def _still_to_gain(r, jacobian):
    """The drop of chi-square that one more Gauss-Newton step predicts."""
    gradient = jacobian.T @ r
    return float(gradient @ _inverse(jacobian.T @ jacobian) @ gradient)


def _gone(free, jacobian):
    """Which parameters have run towards zero so far that the data no longer feel them."""
    unfelt = np.abs(jacobian).max(axis=0) < _NOTHING
    return unfelt & np.array([name in _MAY_VANISH for name in free])


def _starts(free, centre):
    """The rig's own values, and factors of 3 about its stiffness and damping."""
    grid = [centre]
    for name in ("k_N_per_m", "b_N_s_per_m"):
        if name in free:
            shift = np.eye(len(free))[free.index(name)]
            grid = [g + np.log(f) * shift for g in grid for f in _FACTORS]
    return jnp.asarray(np.stack([centre, *grid]))


def _spreads(r, jacobian, present, spreads, spread, given):
    """New spreads of F_p and d: squared residuals over the degrees of freedom they keep."""
    leverage = np.einsum("ij,jk,ik->i", jacobian, _inverse(jacobian.T @ jacobian), jacobian)
    misfit = (r.reshape(spreads.shape) * spreads) ** 2
    leverage = leverage.reshape(spreads.shape)
    new = spread.copy()
    for i in range(2):
        use = present[i] & np.isnan(given[i])
        if use.any():
            freedom = max(use.sum() - leverage[i][use].sum(), 1.0)
            new[i] = np.sqrt(misfit[i][use].sum() / freedom)
    return np.maximum(new, 1e-12)


def _inverse(information):
    """Inverse information, with a huge variance along what is not determined at all."""
    values, vectors = np.linalg.eigh(information)
    known = values > 1e-12 * values.max()
    inverse = np.where(known, 1.0 / np.where(known, values, 1.0), _UNDETERMINED)
    return (vectors * inverse) @ vectors.T
