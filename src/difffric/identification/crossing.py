"""The mu_s at which a push's F_p or d takes a measured value, in a bracket that holds one."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float

from difffric.compute.bracketed_newton import BracketedNewton
from difffric.identification.push_models import observe_at
from difffric.rig.rig import Rig
from difffric.simulation.segments import Integrator


class Crossing(NamedTuple):
    """Where the bracketed Newton iteration ended."""

    mu_s: jax.Array
    slope: jax.Array
    """derivative of the quantity by mu_s [N or m], to 1e-9"""
    solved: jax.Array
    """whether the quantity takes the target's value there"""


def find_crossing(
    rig: Rig,
    velocity: ArrayLike,
    target: ArrayLike,
    by_force: Bool[ArrayLike, ""],
    bracket: tuple[ArrayLike, ArrayLike] | Float[Array, "2"],
    rising: Bool[ArrayLike, ""],
    integrator: Integrator | None = None,
) -> Crossing:
    """The mu_s in the bracket at which F_p (where `by_force`) or d takes the value `target`
    [N or m].

    Traceable; by_force and rising (whether the quantity grows with mu_s there) too, so that one
    program serves both quantities. Where the quantity does not exist it counts as less than
    any target.
    """
    lower, upper = jnp.log(bracket[0]), jnp.log(bracket[1])

    def excess(log_mu_s, _):
        mu_s = jnp.exp(log_mu_s)
        seen = observe_at(rig, velocity, mu_s, integrator)
        ratio = jnp.where(by_force, seen.peak_force, seen.sliding_distance) / target
        # d is close to a power of mu_s, F_p to a straight line: each its own scale for Newton.
        value = jnp.where(by_force, ratio - 1.0, jnp.log(jnp.where(by_force, 1.0, ratio)))
        return jnp.where(jnp.isnan(ratio), -1.0, value)

    solution = optx.root_find(
        excess,
        BracketedNewton(),
        0.5 * (lower + upper),
        options={"lower": lower, "upper": upper, "rising": rising},
        max_steps=200,
        throw=False,
    )
    mu_s, end = jnp.exp(solution.value), solution.state
    return Crossing(mu_s, end.slope * target / mu_s, end.arrived)
