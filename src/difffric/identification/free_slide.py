"""mu_s from a free slide alone: its release speed and its distance, without the push."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from difffric.compute.lanes import differentiate
from difffric.errors import InputError
from difffric.estimation.coordinates import to_value
from difffric.identification.estimates import Estimates
from difffric.identification.resolved_pushes import ResolvedPushes
from difffric.identification.slide_equation import K_V, STEPS, log_distance, start_above
from difffric.rig import parameters
from difffric.rig.rig import Rig

if TYPE_CHECKING:
    from jaxtyping import Float


def _solve_columns(
    rigs: Rig, v: Float[NDArray, " n"], d: Float[NDArray, " n"]
) -> tuple[NDArray, NDArray, NDArray]:
    """log mu_s at which each slide has its distance, the derivatives (n, 3) of log d there by
    log mu_s, log v, and k_v [1/(N s/m)], and log d there."""
    log_v, log_d, k_v = np.log(v), np.log(d), parameters.values(rigs)[K_V]
    along = tuple(direction[:, None] for direction in np.eye(3))
    with np.errstate(all="ignore"):  # a slide that viscosity alone would stop runs to no number
        x = start_above(rigs, v, d)
        for _ in range(STEPS):
            value, slope = differentiate(
                lambda z: log_distance(rigs, z, log_v, k_v), x, np.ones(())
            )
            x = x - (value - log_d) / slope
        value, slope = differentiate(lambda at: log_distance(rigs, *at), (x, log_v, k_v), along)
    return x, slope.T, value


def invert_slides(
    rigs: Rig, velocity: Float[NDArray, " n"], d: Float[NDArray, " n"]
) -> tuple[Float[NDArray, " n"], Float[NDArray, "n 3"]]:
    """mu_s of n free slides that leave at `velocity` [m/s] and rest after `d` [m], and the
    derivatives (n, 3) of log d there by log mu_s, log v, and k_v [1/(N s/m)]. `rigs` is spread
    over the slides.

    NaN where viscosity alone would stop the part sooner, and where something was not measured.
    Raises `InputError` for a friction law without a closed form.
    """
    if not rigs.friction.affine:
        raise InputError(
            f"free slides need friction affine in the speed; {type(rigs.friction).__name__} is not"
        )
    measured = np.isfinite(velocity) & np.isfinite(d)
    v, s = np.where(measured, velocity, 1.0), np.where(measured, d, 1.0)
    solve: Any = _solve_columns
    if not rigs.only_own_laws:
        from difffric.identification.compiled_models import solve_slides as solve
    x, slope, log_d = map(np.asarray, solve(rigs, v, s))
    found = measured & np.isfinite(x) & (np.abs(log_d - np.log(s)) < 1e-9)
    return np.where(found, np.exp(np.where(found, x, 0.0)), np.nan), slope


def estimate_by_slides(pushes: ResolvedPushes) -> Estimates | None:
    """mu_s from each push's free slide alone, from its release speed and d. None where no push
    says both, or where the friction law has no closed form.

    The release speed of a slide without a push is taken as exact unless its error is said.
    """
    v, d = pushes.pushes.release_velocity, pushes.pushes.sliding_distance
    rigs = pushes.models.rigs
    measured = np.isfinite(v) & np.isfinite(d)
    if not measured.any() or not rigs.friction.affine:
        return None
    k_v = np.zeros((len(pushes), pushes.roots.shape[2]))
    if K_V in pushes.names:
        k_v = to_value(K_V, pushes.roots[:, pushes.names.index(K_V)])
    v_se = pushes.pushes.release_velocity_se
    v_se = np.where(np.isnan(v_se) & pushes.pushes.free_slides, 0.0, v_se)
    mu_s, slope = invert_slides(rigs, v, d)
    v, s = np.where(measured, v, 1.0), np.where(measured, d, 1.0)
    d_se = pushes.sensor_errors[:, 1]
    parts = [d_se / s, slope[:, 1] * v_se / v, slope[:, 2] * np.linalg.norm(k_v, axis=1)]
    error = mu_s * np.sqrt(sum(np.square(p / slope[:, 0]) for p in parts))
    per_k_v = mu_s * np.abs(slope[:, 2] / slope[:, 0])
    # What viscosity takes more, friction takes less.
    return Estimates(mu_s, error, -per_k_v[:, None] * k_v)
