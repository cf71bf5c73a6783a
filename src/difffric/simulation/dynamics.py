"""Equation (2) under any laws: the rates of a push in each of its modes, and its guards.

A guard is a smooth function of the state that falls through zero at an event.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from difffric.compute.smooth_extension import extend_odd
from difffric.compute.xla_options import hold
from difffric.rig.force_balance import accelerate
from difffric.rig.rig import Rig
from difffric.simulation.events import Event, Mode
from difffric.units import GRAVITY

SMALLEST_COMPRESSION, LARGEST_COMPRESSION = 1e-9, 1e3
"""Compressions [m] between which one that carries a force is looked for: far beyond what a contact
does at either end."""


class PhasePoint(NamedTuple):
    """The state of a push, or with each field per second its rate of change."""

    t: Float[Array, ""]
    """time [s]"""
    z: Float[Array, ""]
    """compression of the contact [m], negative where tip and part are apart"""
    u: Float[Array, ""]
    """the part's speed [m/s]"""
    y: Float[Array, ""]
    """the tip's travel [m]"""
    q: Float[Array, ""] | Any = None
    """deflection of the bristles [m], where there are any"""

    def after(self, h: Float[Array, ""], rate: PhasePoint) -> PhasePoint:
        """The state a step h [s] further at these rates."""
        return jax.tree.map(lambda a, b: a + h * b, self, rate)


class Course(NamedTuple):
    """What of a push changes by events alone."""

    mode: Int[Array, ""]
    touching: Bool[Array, ""]
    """whether the part is in contact"""
    moved: Bool[Array, ""]
    """whether the part has ever slid"""
    stopped: Bool[Array, ""]
    """whether the pusher's command has stopped"""
    t_stop: Float[Array, ""]
    """when it did [s]"""
    V_stop: Float[Array, ""]
    """at what speed [m/s]"""
    beyond: Bool[Array, ""]
    """whether the part is past the place where the load jumps"""
    corners: Int[Array, ""]
    """corners of the pusher's speed that lie behind: where its ramp ended, for example"""
    way: Float[Array, ""]
    """1 where the part moves forwards, -1 where bristles push it back"""
    slipped: Bool[Array, ""] | Any = None
    """whether bristles are bent as far as they go, and slip; None: there are none"""


class Motion(NamedTuple):
    """Equation (2) of a rig whose pusher's command comes to v [m/s]."""

    rig: Rig
    v: Float[Array, ""]

    @property
    def bristles(self) -> Any:
        """The law of the bristles that replace the stuck mode; None: there are none."""
        law = self.rig.friction
        return law if hasattr(law, "bend") else None

    def tip(self, course: Course, s: PhasePoint) -> tuple[Array, Array]:
        """(V, y'): the tip's speed [m/s] before any ripple, and with it."""
        pusher = self.rig.pusher
        fall = pusher.fall(jnp.where(course.stopped, s.t - course.t_stop, 0.0), course.V_stop)
        V = jnp.where(course.stopped, fall, pusher.rise(s.t, self.v, course.corners))
        return hold((V, V * pusher.ripple(s.y)))

    def position(self, s: PhasePoint) -> Float[Array, ""]:
        """x, the part's position [m]."""
        return s.y - self.rig.contact.gap - s.z

    def load(self, course: Course, s: PhasePoint) -> Float[Array, ""] | float:
        """Normal force at the part's place [N]."""
        return hold(self.rig.load(self.position(s), course.beyond))

    def deflection(self, course: Course, s: PhasePoint) -> Float[Array, ""]:
        """The bristles' deflection [m]. Where they slip it follows the load: how they come to slip
        would be stiff, and is over within some micrometres."""
        slips = self.bristles.find_yield(course.way, self.load(course, s))
        return jnp.where(course.slipped, slips, s.q)

    def breakaway(self, course: Course, s: PhasePoint) -> Float[Array, ""] | float:
        """The contact force at which a part at rest starts to slide [N]."""
        friction, load = self.rig.friction, self.load(course, s)
        first = friction.first_breakaway(load)
        return self.rig.slope + jnp.where(course.moved, friction.breakaway(load), first)

    def approach(self, z: Float[Array, ""], w: Float[Array, ""]) -> Float[Array, ""]:
        """Contact force [N] on approach, at the compression z [m] that grows at the rate w
        [m/s]."""
        law = self.rig.contact
        return law.approach(z, w) if law.continues else extend_odd(lambda z: law.approach(z, w), z)

    def rebound(self, z: Float[Array, ""], w: Float[Array, ""]) -> Float[Array, ""]:
        """Contact force [N] on rebound, at the compression z [m] that grows at the rate w [m/s]."""
        law = self.rig.contact
        return law.rebound(z, w) if law.continues else extend_odd(lambda z: law.rebound(z, w), z)

    def force(self, course: Course, s: PhasePoint) -> Float[Array, ""]:
        """The contact force N [N]."""
        _, dy = self.tip(course, s)
        w = dy - s.u
        mode = course.mode
        rebounds = (mode == Mode.REBOUNDING) | ((mode == Mode.STUCK) & (w < 0))
        pushed = jnp.where(rebounds, self.rebound(s.z, w), self.approach(s.z, w))
        return hold(jnp.where(course.touching, pushed, 0.0))

    def rates(self, course: Course, s: PhasePoint) -> PhasePoint:
        """Equation (2): the state's rate of change in the course's mode."""
        rig, friction = self.rig, self.rig.friction
        _, dy = self.tip(course, s)
        load = self.load(course, s)
        held = course.mode == Mode.STUCK
        if self.bristles is not None:
            q = self.deflection(course, s)
            drag, dq = self.bristles.bend(s.u, course.way, q, load)
            dq = jnp.where(held | course.slipped, 0.0, dq)
        elif friction.continues:
            drag, dq = friction.sliding(s.u, load), None
        else:
            drag, dq = extend_odd(lambda u: friction.sliding(u, load), s.u), None
        a = accelerate(self.force(course, s), hold(drag), rig.slope, rig.mass)
        return PhasePoint(jnp.ones_like(s.t), dy - s.u, jnp.where(held, 0.0, a), dy, dq)

    def guards(
        self, course: Course, s: PhasePoint
    ) -> tuple[dict[Event, Float[Array, ""]], Float[Array, ""]]:
        """(guards, N): the guard of each kind of event that the laws and the mode know, 1 where
        an event cannot come, and the contact force [N]."""
        rig, mode = self.rig, course.mode
        V, dy = self.tip(course, s)
        w, force = dy - s.u, self.force(course, s)
        stuck, closing = mode == Mode.STUCK, mode == Mode.CLOSING
        rebounding, free = mode == Mode.REBOUNDING, mode == Mode.FREE
        # Where contact is lost the compression falls to 0, or the rebound's force where that is
        # earlier; both guards cross zero with a slope.
        pulls = rig.contact.damped & (w < 0)
        weight = rig.mass * GRAVITY
        grip = jnp.where(pulls, self.rebound(s.z, jnp.minimum(w, 0.0)) / weight, s.z)
        short = self.breakaway(course, s) - force
        nears = free | (stuck & ~course.touching)
        sliding = closing | free if self.bristles is None else closing | free | rebounding
        found = {
            Event.TURN: jnp.where(closing, w, jnp.where(rebounding, -w, 1.0)),
            Event.BREAKAWAY: jnp.where(stuck & course.touching, short, 1.0),
            Event.HALT: jnp.where(sliding, s.u if self.bristles is None else s.u * course.way, 1.0),
            Event.CONTACT: jnp.where(rebounding, grip, jnp.where(nears, -grip, 1.0)),
        }
        if rig.pusher.stroke is not None:
            left = rig.pusher.find_travel_left(s.t, s.y, rig.pusher.lag() * V, self.v)
            runs = ~course.stopped & jnp.isfinite(left)
            found[Event.STOP] = jnp.where(runs, left, 1.0)
        if rig.friction.uneven:
            edge = rig.friction.edge
            ahead = jnp.where(jnp.isfinite(edge), edge, 0.0) - self.position(s)
            waits = ~course.beyond & jnp.isfinite(edge) & (mode != Mode.STUCK)
            found[Event.LOAD_JUMP] = jnp.where(waits, ahead, 1.0)
        return found, force


def find_compression(
    force_at: Callable[[Float[Array, ""]], Any], force: Float[Array, ""] | float
) -> Float[Array, ""]:
    """A compression [m] at which a contact law's force carries `force` [N]: at most four times the
    least that does; beyond `LARGEST_COMPRESSION` where none does."""

    def is_short(z):
        return (force_at(z) < force) & (z < LARGEST_COMPRESSION)

    return jax.lax.while_loop(is_short, lambda z: 4 * z, jnp.asarray(SMALLEST_COMPRESSION))
