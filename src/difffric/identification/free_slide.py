"""mu_s from a free slide alone: its release speed and its distance, without the push."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from difffric.compute.program_cache import kept
from difffric.errors import InputError
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.oscillator import Slide

_STEPS = 50


@kept
def _solve(rigs, velocity, d):
    """log mu_s at which each slide has its distance, and the derivatives of log d there by
    log mu_s, log v, and k_v [1/(N s/m)]."""

    def one(rig, v, d):
        def log_d(log_mu, log_v, k_v):
            new = {"mu_s": jnp.exp(log_mu), "k_v_N_s_per_m": k_v}
            at = parameters.with_values(rig, new)
            slide = Slide(-at.free(0.0), -jax.jacfwd(at.free)(0.0))
            return jnp.log(slide.rest(jnp.exp(log_v))[1])

        k_v = jnp.asarray(parameters.values(rig)["k_v_N_s_per_m"])
        # Without viscosity d = v^2 / (2 mu_k g): a start from above, from where Newton's steps
        # in the logarithm go down all the way.
        ratio = parameters.values(rig)["mu_k_over_mu_s"]
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

    return jax.vmap(one)(rigs, velocity, d)


def slide_friction(
    rigs: Rig,
    velocity: NDArray,
    velocity_se: NDArray,
    d: NDArray,
    d_se: NDArray,
    k_v_se: NDArray | float = 0.0,
) -> tuple[NDArray, NDArray]:
    """(mu_s, standard errors), each (n,), of free slides that leave at `velocity` [m/s] and rest
    after `d` [m]; `rigs` is spread over them, `k_v_se` [N s/m] its viscosity's standard error.

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
    mu = np.where(found, np.exp(np.where(found, x, 0.0)), np.nan)
    parts = [d_se / s, slope[:, 1] * velocity_se / v, slope[:, 2] * k_v_se]
    variance = sum(np.square(p / slope[:, 0]) for p in parts)
    return mu, mu * np.sqrt(variance)
