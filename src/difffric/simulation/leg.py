"""What every integrator of legs answers with: one leg of a push, up to the event that ends it."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import ArrayLike, Float, Int

from difffric.simulation.events import Event


class Leg(NamedTuple):
    """One leg: its duration [s], its event, the state at its end, and what was measured in it."""

    dt: Float[ArrayLike, ""]
    event: Int[ArrayLike, ""]
    z: Float[ArrayLike, ""]
    """the compression at its end [m]"""
    u: Float[ArrayLike, ""]
    """the part's speed at its end [m/s]"""
    slid: Float[ArrayLike, ""]
    """distance covered without contact [m]"""
    peak: Float[ArrayLike, ""]
    """largest contact force of a closing [N]"""


def first_event(*events: tuple[Float[ArrayLike, ""], Event]) -> tuple[Array, Array]:
    """The earliest of some (time [s], event), and at a tie the one named first; `Event.NONE` where
    all times are infinite."""
    dt, event = jnp.asarray(events[0][0], float), jnp.asarray(events[0][1])
    for time, code in events[1:]:
        earlier = time < dt
        dt, event = jnp.where(earlier, time, dt), jnp.where(earlier, code, event)
    return dt, jnp.where(jnp.isinf(dt), Event.NONE, event)
