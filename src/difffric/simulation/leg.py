"""What every integrator answers with: one leg of a push, up to the event that ends it."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

NONE, STOP, TURN, HALT, RELEASE, CATCH = range(6)
"""How a leg ends: never; the pusher stops; w = 0; u = 0; loss of contact; next contact."""


class Leg(NamedTuple):
    """One leg: its duration [s], its event, the state at its end, and what it measured."""

    dt: Array | float
    event: Array | int
    z: Array | float
    u: Array | float
    slid: Array | float
    """distance covered without contact [m]"""
    peak: Array | float
    """largest contact force of a closing [N]"""


def first_event(*events):
    """The earliest (time, event); at a tie the one named first. `NONE` where all are infinite."""
    dt, event = jnp.asarray(events[0][0], float), jnp.asarray(events[0][1])
    for time, code in events[1:]:
        earlier = time < dt
        dt, event = jnp.where(earlier, time, dt), jnp.where(earlier, code, event)
    return dt, jnp.where(jnp.isinf(dt), NONE, event)
