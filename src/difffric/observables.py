"""What is measured of a push: the peak push force F_p, the free-sliding distance d, and how
the push went. All of it can be differentiated and batched.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from difffric import simulate as sim


class Observables(NamedTuple):
    """F_p and d of one push, in SI units, with its regime.

    NaN stands in `sliding_distance` where `reason` is not 0 (`REASONS` says why), and in
    both where the push could not be followed.
    """

    peak_force: Array
    sliding_distance: Array
    reason: Array
    regime: Array
    stuck_first: Array
    contacts: Array
    kind: Array
    """a number that changes wherever a derivative may jump"""


def observables(push: sim.Push, state: sim.State) -> Observables:
    """Read F_p, d and the regime off the last state of a push."""
    failed = jnp.where(
        state.contacts > sim.MAX_CONTACTS,
        sim.TOO_MANY_CONTACTS,
        jnp.where(state.cycles >= sim.MAX_CYCLES, sim.TOO_MANY_CYCLES, sim.OK),
    )
    left = state.lost & ~state.in_contact
    reason = jnp.where(
        failed != sim.OK,
        failed,
        jnp.where(
            state.endless, sim.NEVER_RELEASED, jnp.where(left, sim.OK, sim.RESTS_IN_CONTACT)
        ),
    )
    regime = jnp.where(
        ~state.moved,
        sim.NO_MOTION,
        jnp.where(
            ~left,
            sim.PUSHED_TO_REST,
            jnp.where(state.lost_moving, sim.RELEASED_BY_REBOUND, sim.RELEASED_AT_STOP),
        ),
    )
    stuck_first = push.integrator.breakaway(push.rig, push.velocity) > 0
    kind = regime + 4 * stuck_first
    for count in (state.contacts, state.sticks, state.peak_contact):
        kind = kind * 1024 + count
    return Observables(
        peak_force=jnp.where(failed != sim.OK, jnp.nan, state.peak),
        sliding_distance=jnp.where(reason != sim.OK, jnp.nan, state.slid),
        reason=reason,
        regime=regime,
        stuck_first=stuck_first,
        contacts=state.contacts,
        kind=kind,
    )
