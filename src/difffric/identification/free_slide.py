"""mu_s from a free slide alone: its release speed and its distance, without the push."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from difffric.compute.program_cache import cache_program
from difffric.errors import InputError
from difffric.estimation.coordinates import to_value
from difffric.identification.estimates import Estimates
from difffric.identification.resolved_pushes import ResolvedPushes
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.oscillator import ViscousSlide

_K_V = "k_v_N_s_per_m"

_STEPS = 50
"""Newton steps. From their start they approach the root from one side, and where viscosity alone
would stop the part they never arrive; a fixed number serves all slides of a batch. The bracketed
Newton iteration would end in other last digits."""


@cache_program
def _solve(rigs, velocity, d):
    """log mu_s at which each slide has its distance, the derivatives of log d there by log mu_s,
    log v, and k_v [1/(N s/m)], and log d there."""

    def solve_one(rig, v, d):
        values, put = parameters.unpack(rig)
        k_v = jnp.asarray(values[_K_V])

        def log_d(log_mu, log_v, k_v):
            at = put({"mu_s": jnp.exp(log_mu), _K_V: k_v})
            slide = ViscousSlide(-at.free(0.0), -jax.jacfwd(at.free)(0.0))
            return jnp.log(slide.rest(jnp.exp(log_v))[1])

        # Without viscosity d = v^2 / (2 mu_k g): a start from above, from where Newton's steps
        # in the logarithm go down all the way.
        ratio = values["mu_k_over_mu_s"]
        start = jnp.log(v**2 / (2 * d * ratio * rig.F_N / rig.mass))

        def improve(_, x):
            value, slope = jax.jvp(lambda z: log_d(z, jnp.log(v), k_v), (x,), (1.0,))
            return x - (value - jnp.log(d)) / slope

        x = jax.lax.fori_loop(0, _STEPS, improve, start)
        return (
            x,
            jnp.stack(jax.jacfwd(log_d, (0, 1, 2))(x, jnp.log(v), k_v)),
            log_d(x, jnp.log(v), k_v),
        )

    return jax.vmap(solve_one)(rigs, velocity, d)


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
    x, slope, log_d = map(np.asarray, _solve(rigs, jnp.asarray(v), jnp.asarray(s)))
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
    if _K_V in pushes.names:
        k_v = to_value(_K_V, pushes.roots[:, pushes.names.index(_K_V)])
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
