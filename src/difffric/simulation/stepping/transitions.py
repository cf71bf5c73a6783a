"""What the events of a push change: its mode, its contact, what is counted, whether it is over."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from difffric.simulation.dynamics import (
    BOTTOM,
    BREAK,
    CLOSING,
    CORNER,
    EDGE,
    FREE,
    GRIP,
    HALT,
    REBOUNDING,
    STOP,
    STUCK,
    SUMMIT,
    TURN,
    Motion,
    Point,
)
from difffric.simulation.stepping.state import March
from difffric.units import GRAVITY

MAX_CONTACTS = 16
MAX_REBOUNDS = 60
"""Rebounds that a pusher without a stroke is followed for without a loss of contact."""

MAX_HALTS = 1000
"""Halts on bristles, after which a part that hardly swings any more counts as at rest."""

NO_EVENT = -1
STEADY = 1e-9
_REACHED = 1e-9  # of the compression under the part's weight
_SETTLED = 1e-6  # of the bristles' slip force


class Rules(NamedTuple):
    """A push's motion and its scales."""

    motion: Motion
    z_0: Array
    """about the compression under the part's own weight [m]"""

    @property
    def u_0(self):
        """A speed [m/s] of the push's own."""
        return jnp.sqrt(self.z_0 * GRAVITY)

    @property
    def time(self):
        """A time [s]."""
        return jnp.sqrt(self.z_0 / GRAVITY)

    def breaks(self, course, s):
        """Whether a part at rest in contact starts to slide at once."""
        if self.motion.bristles is not None:
            return course.touching
        held = course._replace(mode=jnp.asarray(STUCK))
        force = self.motion.force(held, s)
        return course.touching & (force >= self.motion.breakaway(held, s))

    def rests(self, m: March):
        """Whether the part is at rest for good: what travel the tip has left does not move it."""
        c, s = m.course, m.s
        V, dy = self.motion.tip(c, s)
        left = jnp.where(c.stopped, self.motion.rig.pusher.lag() * V, jnp.inf)
        z = s.z + left
        force = self.motion.approach(jnp.where(jnp.isfinite(z), z, s.z), dy)
        weak = force < self.motion.breakaway(c, s)
        return (c.mode == STUCK) & c.stopped & ((z < 0) | weak)

    def settles(self, m: March, halt, a):
        """Whether bristles hold the part for good, but for a motion too small to matter."""
        c, s, rig = m.course, m.s, self.motion.rig
        V, _ = self.motion.tip(c, s)
        slip = rig.friction.law.sliding(jnp.zeros_like(s.u), self.motion.load(c, s))
        calm = jnp.abs(a) * rig.mass < _SETTLED * slip
        slow = jnp.abs(s.u) < STEADY * self.u_0
        spent = m.halts >= MAX_HALTS
        away = jnp.where(c.touching, True, s.z + rig.pusher.lag() * V + jnp.abs(s.q) < 0)
        still = V <= STEADY * self.motion.v
        return c.stopped & still & away & ((calm & (halt | slow)) | (spent & halt))

    def passed(self, m: March, event, s: Point, a) -> March:
        """What an event changes at the state s, where the part's acceleration is a [m/s^2];
        nothing for no event."""
        motion, c = self.motion, m.course
        pusher = motion.rig.pusher

        def on(code):
            return event == code

        V, dy = motion.tip(c, s)
        mode = c.mode
        turn, halt, grip, stop = on(TURN), on(HALT), on(GRIP), on(STOP)
        s = s._replace(u=jnp.where(turn, dy, jnp.where(halt | (mode == STUCK), 0.0, s.u)))
        pulls = motion.rig.contact.damped & (dy < s.u)
        s = s._replace(z=jnp.where(grip & ~pulls, 0.0, s.z))
        release = grip & (mode == REBOUNDING)
        catch = grip & (mode == FREE)
        touch = grip & (mode == STUCK)
        stands = release & pusher.stops_at_release() & ~c.stopped
        stops = stop | stands
        lost_moving = jnp.where(release, ~c.stopped, m.lost_moving)
        c = c._replace(
            stopped=c.stopped | stops,
            t_stop=jnp.where(stops, s.t, c.t_stop),
            V_stop=jnp.where(stops, V, c.V_stop),
            touching=(c.touching & ~release) | catch | touch,
            beyond=c.beyond | on(EDGE),
            risen=c.risen | on(CORNER),
        )
        if motion.rig.friction.uneven:
            # An edge where another event leaves the part is passed with it: a step of no length
            # would not tell whether contact, just lost, is there again.
            left = motion.rig.friction.edge - motion.position(s)
            passes = (event != NO_EVENT) & (s.u > 0) & (left <= _REACHED * self.z_0)
            c = c._replace(beyond=c.beyond | passes)
        _, dy = motion.tip(c, s)
        back = turn & (mode == REBOUNDING)
        ends = back & c.stopped & (dy <= 0)
        new = mode
        new = jnp.where(turn & (mode == CLOSING), REBOUNDING, new)
        new = jnp.where(back, jnp.where(ends, STUCK, CLOSING), new)
        if motion.bristles is None:
            new = jnp.where(halt, STUCK, new)
        else:
            # Before a standing tip the part turns where it halts.
            both = (turn | halt) & (dy <= 0)
            ahead = a > 0
            c = c._replace(way=jnp.where(halt | both, jnp.where(ahead, 1.0, -1.0), c.way))
            turned = jnp.where(ahead, REBOUNDING, CLOSING)
            new = jnp.where(both & c.touching, turned, new)
        new = jnp.where(release, FREE, new)
        new = jnp.where(catch, jnp.where(dy - s.u >= 0, CLOSING, REBOUNDING), new)
        new = jnp.where(stop & (mode == CLOSING) & (dy <= s.u), REBOUNDING, new)
        new = jnp.where(on(BREAK), CLOSING, new)
        # A rebound that would pull is over before it begins.
        gone = (new == REBOUNDING) & (s.z < motion.rig.contact.edge(dy - s.u))
        new = jnp.where(gone, FREE, new)
        release = release | gone
        lost_moving = jnp.where(gone, ~c.stopped, lost_moving)
        c = c._replace(mode=new, touching=c.touching & ~gone)
        held = (new == STUCK) & self.breaks(c, s)
        c = c._replace(mode=jnp.where(held, CLOSING, new), moved=c.moved | on(BREAK) | held)
        changed = c.mode != mode
        # Energy only falls where nothing feeds it: what the first rebound did not part, no later
        # one will.
        rebounds = m.rebounds + back
        fed = not pusher.constant or motion.rig.friction.uneven
        patience = MAX_REBOUNDS if fed else 1
        never = back & pusher.stops_at_release() & ~m.lost & (rebounds >= patience)
        contacts = m.contacts + catch + touch
        m = m._replace(
            s=s,
            course=c,
            target=jnp.asarray(NO_EVENT),
            contacts=contacts,
            sticks=m.sticks + (halt & (dy > 0)),
            halts=m.halts + halt,
            lost=m.lost | release,
            lost_moving=lost_moving,
            x_lost=jnp.where(release, motion.position(s), m.x_lost),
            summited=(m.summited & ~changed) | on(SUMMIT),
            slowed=(m.slowed & ~changed) | on(BOTTOM),
            rebounds=rebounds,
            endless=m.endless | never,
            over=m.over | never | (contacts > MAX_CONTACTS),
        )
        # Behind a standing tip an overdamped rebound comes to rest only asymptotically.
        creeps = (
            (c.mode == REBOUNDING)
            & (dy == 0)
            & (s.u < STEADY * self.u_0)
            & (jnp.abs(a) * self.time < STEADY * self.u_0)
        )
        if motion.bristles is not None:
            return m._replace(over=m.over | self.settles(m, halt, a))
        m = m._replace(course=c._replace(mode=jnp.where(creeps, STUCK, c.mode)))
        return m._replace(over=m.over | self.rests(m))
