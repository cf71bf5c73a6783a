"""What the events of a push change: its mode, its contact, what is counted, whether it is over.

`Rules.pass_event` applies an event to the state of the loop. What each event does to the mode
stands in a function of its own: `turn`, `halt`, `halt_on_bristles`, `release`, `catch`, `stop`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from difffric.simulation.dynamics import Course, Motion, PhasePoint
from difffric.simulation.events import MAX_CONTACTS, Event, Mode
from difffric.simulation.stepping.state import LoopState
from difffric.units import GRAVITY

MAX_REBOUNDS = 60
"""Rebounds that a pusher without a stroke is followed for without a loss of contact."""
MAX_HALTS = 1000
"""Halts on bristles, after which a part that hardly swings any more counts as at rest."""
STEADY = 1e-9
"""Of the push's own speed: what a part may move at that counts as at rest, or as steady."""
_REACHED = 1e-9  # of the compression under the part's weight: as near to an edge as this is at it
_SETTLED = 1e-6  # of the bristles' slip force: what is left of a force that no longer moves a part


class Passage(NamedTuple):
    """An event, and the mode in which it comes."""

    event: Int[Array, ""]
    mode: Int[Array, ""]

    def is_of(self, event: Event) -> Bool[Array, ""]:
        """Whether this is the event."""
        return self.event == event

    @property
    def releases(self) -> Bool[Array, ""]:
        """Whether contact is lost."""
        return self.is_of(Event.CONTACT) & (self.mode == Mode.REBOUNDING)

    @property
    def catches(self) -> Bool[Array, ""]:
        """Whether a sliding part comes into contact."""
        return self.is_of(Event.CONTACT) & (self.mode == Mode.FREE)

    @property
    def touches(self) -> Bool[Array, ""]:
        """Whether the tip comes to a part at rest."""
        return self.is_of(Event.CONTACT) & (self.mode == Mode.STUCK)

    @property
    def turns_back(self) -> Bool[Array, ""]:
        """Whether a rebound ends in contact."""
        return self.is_of(Event.TURN) & (self.mode == Mode.REBOUNDING)


def turn(at: Passage, new: Int[Array, ""], course: Course, dy: Float[Array, ""]) -> Int[Array, ""]:
    """The mode after tip and part had the same speed: from closing to rebounding and back; at rest
    where a rebound ends before a tip that stands."""
    ends = at.turns_back & course.stopped & (dy <= 0)
    new = jnp.where(at.is_of(Event.TURN) & (at.mode == Mode.CLOSING), Mode.REBOUNDING, new)
    return jnp.where(at.turns_back, jnp.where(ends, Mode.STUCK, Mode.CLOSING), new)


def halt(at: Passage, new: Int[Array, ""]) -> Int[Array, ""]:
    """The mode after the part has come to rest: friction holds it."""
    return jnp.where(at.is_of(Event.HALT), Mode.STUCK, new)


def halt_on_bristles(
    at: Passage,
    new: Int[Array, ""],
    course: Course,
    dy: Float[Array, ""],
    a: Float[Array, ""],
) -> tuple[Int[Array, ""], Course]:
    """(mode, course) after a halt on bristles, which hold nothing: they push the part on or back,
    as its acceleration a [m/s^2] says."""
    halts = at.is_of(Event.HALT)
    # Before a standing tip the part turns where it halts.
    both = (at.is_of(Event.TURN) | halts) & (dy <= 0)
    ahead = a > 0
    course = course._replace(
        way=jnp.where(halts | both, jnp.where(ahead, 1.0, -1.0), course.way),
        slipped=course.slipped & ~(halts | both),
    )
    turned = jnp.where(ahead, Mode.REBOUNDING, Mode.CLOSING)
    return jnp.where(both & course.touching, turned, new), course


def release(at: Passage, new: Int[Array, ""]) -> Int[Array, ""]:
    """The mode after contact was lost."""
    return jnp.where(at.releases, Mode.FREE, new)


def catch(at: Passage, new: Int[Array, ""], s: PhasePoint, dy: Float[Array, ""]) -> Int[Array, ""]:
    """The mode of a sliding part that has come into contact, by who is faster."""
    return jnp.where(at.catches, jnp.where(dy - s.u >= 0, Mode.CLOSING, Mode.REBOUNDING), new)


def stop(at: Passage, new: Int[Array, ""], s: PhasePoint, dy: Float[Array, ""]) -> Int[Array, ""]:
    """The mode after the pusher's command has stopped: what closed in on the part recedes where the
    tip stands at once."""
    slower = at.is_of(Event.STOP) & (at.mode == Mode.CLOSING) & (dy <= s.u)
    return jnp.where(slower, Mode.REBOUNDING, new)


def break_away(at: Passage, new: Int[Array, ""]) -> Int[Array, ""]:
    """The mode after static friction was overcome."""
    return jnp.where(at.is_of(Event.BREAKAWAY), Mode.CLOSING, new)


class Rules(NamedTuple):
    """A push's motion and its scales: what decides on an event's consequences."""

    motion: Motion
    z_0: Float[Array, ""]
    """about the compression under the part's own weight [m]"""

    @property
    def u_0(self) -> Float[Array, ""]:
        """A speed [m/s] of the push's own."""
        return jnp.sqrt(self.z_0 * GRAVITY)

    @property
    def time(self) -> Float[Array, ""]:
        """A time [s] of the push's own."""
        return jnp.sqrt(self.z_0 / GRAVITY)

    def is_breaking(self, course: Course, s: PhasePoint) -> Bool[Array, ""]:
        """Whether a part at rest in contact starts to slide at once."""
        if self.motion.bristles is not None:
            return course.touching
        held = course._replace(mode=jnp.asarray(Mode.STUCK))
        force = self.motion.force(held, s)
        return course.touching & (force >= self.motion.breakaway(held, s))

    def is_at_rest(self, m: LoopState) -> Bool[Array, ""]:
        """Whether the part is at rest for good: what travel the tip has left does not move it."""
        c, s = m.course, m.s
        V, dy = self.motion.tip(c, s)
        left = jnp.where(c.stopped, self.motion.rig.pusher.lag() * V, jnp.inf)
        z = s.z + left
        force = self.motion.approach(jnp.where(jnp.isfinite(z), z, s.z), dy)
        weak = force < self.motion.breakaway(c, s)
        return (c.mode == Mode.STUCK) & c.stopped & ((z < 0) | weak)

    def is_settled(
        self, m: LoopState, halts: Bool[Array, ""], a: Float[Array, ""]
    ) -> Bool[Array, ""]:
        """Whether bristles hold the part for good, but for a motion too small to matter, where its
        acceleration is a [m/s^2]; `halts`: whether it has just come to rest."""
        c, s, rig = m.course, m.s, self.motion.rig
        V, _ = self.motion.tip(c, s)
        slip = rig.friction.law.sliding(jnp.zeros_like(s.u), self.motion.load(c, s))
        calm = jnp.abs(a) * rig.mass < _SETTLED * slip
        slow = jnp.abs(s.u) < STEADY * self.u_0
        spent = m.halts >= MAX_HALTS
        away = jnp.where(c.touching, True, s.z + rig.pusher.lag() * V + jnp.abs(s.q) < 0)
        still = V <= STEADY * self.motion.v
        return c.stopped & still & away & ((calm & (halts | slow)) | (spent & halts))

    def pass_event(
        self, m: LoopState, event: Int[Array, ""], s: PhasePoint, a: Float[Array, ""]
    ) -> LoopState:
        """What an event changes at the state s, where the part's acceleration is a [m/s^2];
        nothing for no event."""
        at = Passage(event, m.course.mode)
        V, dy = self.motion.tip(m.course, s)
        s = self._place(at, s, dy)
        if self.motion.bristles is not None:
            s = s._replace(q=self.motion.deflection(m.course, s))
        c = self._note_event(at, m.course, s, V)
        _, dy = self.motion.tip(c, s)
        new, c = self._change_mode(at, c, s, dy, a)
        # A rebound that would pull is over before it begins; one that a catch begins stands on that
        # edge, and rounding alone would end it.
        pulls = s.z < self.motion.rig.contact.edge(dy - s.u)
        gone = (new == Mode.REBOUNDING) & pulls & ~at.catches
        new = jnp.where(gone, Mode.FREE, new)
        c = c._replace(mode=new, touching=c.touching & ~gone)
        held = (new == Mode.STUCK) & self.is_breaking(c, s)
        breaks = at.is_of(Event.BREAKAWAY)
        c = c._replace(mode=jnp.where(held, Mode.CLOSING, new), moved=c.moved | breaks | held)
        m = self._count(at, m._replace(s=s), m.course, c, dy, gone)
        return self._end(at, m, dy, a)

    def _place(self, at: Passage, s: PhasePoint, dy: Array) -> PhasePoint:
        """The state exactly on its event."""
        resting = at.is_of(Event.HALT) | (at.mode == Mode.STUCK)
        s = s._replace(u=jnp.where(at.is_of(Event.TURN), dy, jnp.where(resting, 0.0, s.u)))
        pulls = self.motion.rig.contact.damped & (dy < s.u)
        return s._replace(z=jnp.where(at.is_of(Event.CONTACT) & ~pulls, 0.0, s.z))

    def _note_event(self, at: Passage, c: Course, s: PhasePoint, V: Array) -> Course:
        """The course with what the event changes beside the mode; V: the tip's speed before it."""
        stands = at.releases & self.motion.rig.pusher.stops_at_release() & ~c.stopped
        stops = at.is_of(Event.STOP) | stands
        c = c._replace(
            stopped=c.stopped | stops,
            t_stop=jnp.where(stops, s.t, c.t_stop),
            V_stop=jnp.where(stops, V, c.V_stop),
            touching=(c.touching & ~at.releases) | at.catches | at.touches,
            beyond=c.beyond | at.is_of(Event.LOAD_JUMP),
            corners=c.corners + at.is_of(Event.CORNER),
        )
        if self.motion.rig.friction.uneven:
            # An edge where another event leaves the part is passed with it: a step of no length
            # would not tell whether contact, just lost, is there again.
            left = self.motion.rig.friction.edge - self.motion.position(s)
            passes = (at.event != Event.NONE) & (s.u > 0) & (left <= _REACHED * self.z_0)
            c = c._replace(beyond=c.beyond | passes)
        return c

    def _change_mode(
        self, at: Passage, c: Course, s: PhasePoint, dy: Array, a: Array
    ) -> tuple[Array, Course]:
        """(mode, course) after the event."""
        new = turn(at, at.mode, c, dy)
        if self.motion.bristles is None:
            new = halt(at, new)
        else:
            new, c = halt_on_bristles(at, new, c, dy, a)
        new = release(at, new)
        new = catch(at, new, s, dy)
        new = stop(at, new, s, dy)
        return break_away(at, new), c

    def _count(
        self, at: Passage, m: LoopState, before: Course, c: Course, dy: Array, gone: Array
    ) -> LoopState:
        """The loop's state on the new course c, with the event counted; `gone`: whether a rebound
        was over before it began."""
        pusher, halts = self.motion.rig.pusher, at.is_of(Event.HALT)
        lost = at.releases | gone
        # Whether the pusher moves is asked before the event for a release, and after it else.
        lost_moving = jnp.where(at.releases, ~before.stopped, m.lost_moving)
        changed = c.mode != before.mode
        # Energy only falls where nothing feeds it: what the first rebound did not part, no later
        # one will.
        rebounds = m.rebounds + at.turns_back
        fed = not pusher.constant or self.motion.rig.friction.uneven
        patience = MAX_REBOUNDS if fed else 1
        never = at.turns_back & pusher.stops_at_release() & ~m.lost & (rebounds >= patience)
        contacts = m.contacts + at.catches + at.touches
        return m._replace(
            course=c,
            target=jnp.asarray(Event.NONE),
            contacts=contacts,
            sticks=m.sticks + (halts & (dy > 0)),
            halts=m.halts + halts,
            lost=m.lost | lost,
            lost_moving=jnp.where(gone, ~c.stopped, lost_moving),
            t_lost=jnp.where(lost, m.s.t, m.t_lost),
            x_lost=jnp.where(lost, self.motion.position(m.s), m.x_lost),
            summited=(m.summited & ~changed) | at.is_of(Event.FORCE_PEAK),
            slowed=(m.slowed & ~changed) | at.is_of(Event.SLOWEST),
            rebounds=rebounds,
            endless=m.endless | never,
            over=m.over | never | (contacts > MAX_CONTACTS),
        )

    def _end(self, at: Passage, m: LoopState, dy: Array, a: Array) -> LoopState:
        """The loop's state, over where the part is at rest for good."""
        if self.motion.bristles is not None:
            return m._replace(over=m.over | self.is_settled(m, at.is_of(Event.HALT), a))
        # Behind a standing tip an overdamped rebound comes to rest only asymptotically.
        creeps = (
            (m.course.mode == Mode.REBOUNDING)
            & (dy == 0)
            & (m.s.u < STEADY * self.u_0)
            & (jnp.abs(a) * self.time < STEADY * self.u_0)
        )
        still = m.course._replace(mode=jnp.where(creeps, Mode.STUCK, m.course.mode))
        m = m._replace(course=still)
        return m._replace(over=m.over | self.is_at_rest(m))
