"""Equation (2) under any laws: the rates of a push in each of its modes, and its guards.

A guard is a smooth function of the state that falls through zero at an event.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from difffric.compute.smooth_extension import odd
from difffric.rig.rig import Rig
from difffric.units import GRAVITY

STUCK, CLOSING, REBOUNDING, FREE = range(4)
"""Modes: held by friction (in contact or not); pushed, w >= 0; pushed, w < 0; sliding free."""

TURN, BREAK, HALT, GRIP, STOP, EDGE, SUMMIT, BOTTOM, CORNER = range(9)
"""Events: w = 0; breakaway; u = 0; contact lost or begun; the pusher stops; the load jumps; the
contact force is highest; the part is slowest; the command has risen."""


class Point(NamedTuple):
    """The state of a push: time [s], compression [m], the part's speed [m/s], the tip's travel
    [m]."""

    t: Array
    z: Array
    u: Array
    y: Array
    q: Any = None
    """deflection of the bristles [m], where there are any"""

    def after(self, h, rate: Point) -> Point:
        """The state a step h [s] further at these rates."""
        return jax.tree.map(lambda a, b: a + h * b, self, rate)


class Course(NamedTuple):
    """What of a push changes by events alone."""

    mode: Array
    touching: Array
    """whether the part is in contact"""
    moved: Array
    stopped: Array
    """whether the pusher's command has stopped; when [s], and at what speed [m/s]"""
    t_stop: Array
    V_stop: Array
    beyond: Array
    """whether the part is past the place where the load jumps"""
    risen: Array
    """whether the pusher's command has come to its speed"""
    way: Array
    """1 where the part moves forwards, -1 where bristles push it back"""


class Motion(NamedTuple):
    """A rig whose pusher's command comes to v [m/s]."""

    rig: Rig
    v: Array

    @property
    def bristles(self):
        """The law of the bristles that replace the stuck mode; None: there are none."""
        law = self.rig.friction
        return law if hasattr(law, "bend") else None

    def tip(self, course: Course, s: Point):
        """(V, y'): the tip's speed [m/s] before any ripple, and with it."""
        pusher = self.rig.pusher
        fall = pusher.fall(jnp.where(course.stopped, s.t - course.t_stop, 0.0), course.V_stop)
        V = jnp.where(course.stopped, fall, pusher.rise(s.t, self.v, course.risen))
        return V, V * pusher.ripple(s.y)

    def position(self, s: Point):
        """x, the part's [m]."""
        return s.y - self.rig.contact.gap - s.z

    def load(self, course: Course, s: Point):
        """Normal force at the part's place [N]."""
        return self.rig.load(self.position(s), course.beyond)

    def breakaway(self, course: Course, s: Point):
        """The contact force at which a part at rest starts to slide [N]."""
        friction, load = self.rig.friction, self.load(course, s)
        first = friction.first_breakaway(load)
        return self.rig.slope + jnp.where(course.moved, friction.breakaway(load), first)

    def approach(self, z, w):
        """Contact force [N] on approach."""
        law = self.rig.contact
        return law.approach(z, w) if law.continues else odd(lambda z: law.approach(z, w), z)

    def rebound(self, z, w):
        """Contact force [N] on rebound."""
        law = self.rig.contact
        return law.rebound(z, w) if law.continues else odd(lambda z: law.rebound(z, w), z)

    def force(self, course: Course, s: Point):
        """The contact force N [N]."""
        _, dy = self.tip(course, s)
        w = dy - s.u
        mode = course.mode
        rebounds = (mode == REBOUNDING) | ((mode == STUCK) & (w < 0))
        pushed = jnp.where(rebounds, self.rebound(s.z, w), self.approach(s.z, w))
        return jnp.where(course.touching, pushed, 0.0)

    def rates(self, course: Course, s: Point) -> Point:
        """Equation (2): the state's rate of change in the course's mode."""
        rig, friction = self.rig, self.rig.friction
        _, dy = self.tip(course, s)
        load = self.load(course, s)
        held = course.mode == STUCK
        if self.bristles is not None:
            drag, dq = self.bristles.bend(s.u, course.way, s.q, load)
            dq = jnp.where(held, 0.0, dq)
        elif friction.continues:
            drag, dq = friction.sliding(s.u, load), None
        else:
            drag, dq = odd(lambda u: friction.sliding(u, load), s.u), None
        a = (self.force(course, s) - drag - rig.slope) / rig.mass
        return Point(jnp.ones_like(s.t), dy - s.u, jnp.where(held, 0.0, a), dy, dq)

    def guards(self, course: Course, s: Point):
        """(guards, N): the guard of each kind of event that the laws and the mode know, 1 where
        an event cannot come, and the contact force."""
        rig, mode = self.rig, course.mode
        V, dy = self.tip(course, s)
        w, force = dy - s.u, self.force(course, s)
        closing, rebounding, free = mode == CLOSING, mode == REBOUNDING, mode == FREE
        # Where contact is lost the compression falls to 0, or the rebound's force where that is
        # earlier; both guards cross zero with a slope.
        pulls = rig.contact.damped & (w < 0)
        weight = rig.mass * GRAVITY
        grip = jnp.where(pulls, self.rebound(s.z, jnp.minimum(w, 0.0)) / weight, s.z)
        short = self.breakaway(course, s) - force
        reach = free | ((mode == STUCK) & ~course.touching)
        sliding = closing | free if self.bristles is None else closing | free | rebounding
        found = {
            TURN: jnp.where(closing, w, jnp.where(rebounding, -w, 1.0)),
            BREAK: jnp.where((mode == STUCK) & course.touching, short, 1.0),
            HALT: jnp.where(sliding, s.u if self.bristles is None else s.u * course.way, 1.0),
            GRIP: jnp.where(rebounding, grip, jnp.where(reach, -grip, 1.0)),
        }
        if rig.pusher.stroke is not None:
            left = rig.pusher.stroke - s.y - rig.pusher.lag() * V
            runs = ~course.stopped & jnp.isfinite(rig.pusher.stroke)
            found[STOP] = jnp.where(runs, left, 1.0)
        if rig.friction.uneven:
            edge = rig.friction.edge
            ahead = jnp.where(jnp.isfinite(edge), edge, 0.0) - self.position(s)
            waits = ~course.beyond & jnp.isfinite(edge) & (mode != STUCK)
            found[EDGE] = jnp.where(waits, ahead, 1.0)
        return found, force
