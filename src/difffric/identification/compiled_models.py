"""The compiled programs behind an inversion: many pushes as functions of mu_s, and the roots.

They serve what NumPy does not: laws without a closed form, a user's own laws, and more pushes than
some thousand. Only what is called imports them, as JAX comes with them.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int

from difffric.compute.program_cache import cache_program
from difffric.compute.xla_options import compile_soon
from difffric.estimation import coordinates
from difffric.identification.crossing import find_crossing
from difffric.identification.slide_equation import K_V, STEPS, log_distance, start_above
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.observables import Observables, observe
from difffric.simulation.segments import Integrator


def observe_at(
    rig: Rig,
    velocity: Float[ArrayLike, ""],
    mu_s: Float[ArrayLike, ""],
    integrator: Integrator | None = None,
) -> Observables:
    """What is measured of a push at `velocity` [m/s] if its mu_s were this one; traceable."""
    return observe(parameters.with_values(rig, {"mu_s": mu_s}), velocity, integrator)


@cache_program
def observe_batch(
    rigs: Rig, velocity: Float[Array, " n"], integrator: Integrator | None, mu_s: Float[Array, " n"]
) -> tuple[
    tuple[Float[Array, " n"], Float[Array, " n"]],
    tuple[Float[Array, " n"], Float[Array, " n"]],
    Int[Array, " n"],
]:
    """(F_p, d), their derivatives by mu_s, and the kind of each of n pushes."""

    def observe_one(rig, velocity, mu_s):
        def read(value):
            seen = observe_at(rig, velocity, value, integrator)
            return (seen.peak_force, seen.sliding_distance), seen.kind

        return jax.jvp(read, (mu_s,), (jnp.ones_like(mu_s),), has_aux=True)

    return jax.vmap(observe_one)(rigs, velocity, mu_s)


@cache_program
def solve_batch(rigs: Rig, velocity, integrator, target, by_force, bracket, rising):
    """The crossing in the bracket of each of n pushes, as `crossing.find_crossing` gives it."""

    def solve_one(rig, velocity, target, by_force, bracket, rising):
        return find_crossing(rig, velocity, target, by_force, bracket, rising, integrator)

    return jax.vmap(solve_one)(rigs, velocity, target, by_force, bracket, rising)


@compile_soon
def differentiate_batch(rigs: Rig, velocity, integrator, mu_s, names: tuple[str, ...]):
    """The derivatives (n, 2, k) of F_p and d by the coordinates of `names`, and the regime, of each
    of n pushes at its own mu_s."""

    def differentiate_one(rig, velocity, mu_s):
        def read(shift):
            values = parameters.values(rig)
            new = {
                name: coordinates.shift_value(name, values[name], shift[i])
                for i, name in enumerate(names)
            }
            rig_at = parameters.with_values(rig, {**new, "mu_s": mu_s})
            seen = observe(rig_at, velocity, integrator)
            both = jnp.stack([seen.peak_force, seen.sliding_distance])
            return both, seen.regime

        return jax.jacfwd(read, has_aux=True)(jnp.zeros(len(names)))

    return jax.vmap(differentiate_one)(rigs, velocity, mu_s)


@cache_program
def solve_slides(rigs: Rig, velocity: Float[Array, " n"], d: Float[Array, " n"]):
    """What `free_slide` solves with NumPy, of laws that need JAX."""

    def solve_one(rig, v, d):
        log_v, k_v = jnp.log(v), jnp.asarray(parameters.values(rig)[K_V])

        def improve(_, x):
            value, slope = jax.jvp(lambda z: log_distance(rig, z, log_v, k_v), (x,), (1.0,))
            return x - (value - jnp.log(d)) / slope

        x = jax.lax.fori_loop(0, STEPS, improve, start_above(rig, v, d))

        def log_d(*at):
            return log_distance(rig, *at)

        return x, jnp.stack(jax.jacfwd(log_d, (0, 1, 2))(x, log_v, k_v)), log_d(x, log_v, k_v)

    return jax.vmap(solve_one)(rigs, velocity, d)
