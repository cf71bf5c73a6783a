"""What every integrator of legs answers with: one leg of a push, up to the event that ends it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from difffric.compute import arrays as xp
from difffric.simulation.events import Event

if TYPE_CHECKING:
    from jaxtyping import Array, ArrayLike, Float, Int


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
    dt, event = xp.asarray(events[0][0], float), xp.asarray(events[0][1])
    for time, code in events[1:]:
        earlier = time < dt
        dt, event = xp.where(earlier, time, dt), xp.where(earlier, code, event)
    return dt, xp.where(xp.isinf(dt), Event.NONE, event)
