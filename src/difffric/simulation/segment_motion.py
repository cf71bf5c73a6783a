"""Force, position and speed within a segment of a push, written once for JAX and for NumPy."""

from __future__ import annotations

from typing import Any

from difffric.compute import arrays as xp
from difffric.compute.lanes import change_where
from difffric.rig.number import Number
from difffric.rig.rig import Rig
from difffric.simulation.events import Mode
from difffric.simulation.segments import Segment


def move_within(
    rig: Rig, integrator: Any, s: Segment, time: Number
) -> tuple[Number, Number, Number]:
    """(contact force [N], position [m], speed [m/s]) at a time [s] that lies in the segment `s`.

    The force is zero before t = 0.
    """
    dt = xp.maximum(time - s.t, 0.0)
    closing, free = s.mode == Mode.CLOSING, s.mode == Mode.FREE
    pushed = closing | (s.mode == Mode.REBOUNDING)

    def push(_: Any, rig: Rig, s: Segment, dt: Number, closing: Any, pushed: Any) -> Any:
        # No mode is followed where it does not hold.
        t = xp.where(pushed, dt, 0.0)
        return integrator.evaluate_pushed(rig, closing, s.z, s.u, s.v_p, t)

    def slide(_: Any, rig: Rig, s: Segment, dt: Number, free: Any) -> Any:
        slid, u = integrator.evaluate_free(rig, s.u, xp.where(free, dt, 0.0))
        return s.z + s.v_p * dt - slid, u

    at = s.z + s.v_p * dt, xp.zeros_like(dt)
    at = change_where(pushed, push, at, rig, s, dt, closing, pushed)
    z, u = change_where(free, slide, at, rig, s, dt, free)
    w = s.v_p - u
    rebound, approach = rig.contact.rebound(z, w), rig.contact.approach(z, w)
    force = xp.where(s.mode == Mode.REBOUNDING, rebound, approach)
    touching = (s.mode != Mode.FREE) & (z >= 0) & (time >= 0)
    return xp.where(touching, force, 0.0), s.y + s.v_p * dt - z, u
