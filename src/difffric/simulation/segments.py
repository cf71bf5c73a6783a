"""One push: modes, events and segments, through whichever integrator serves the rig.

A push is a sequence of segments, in each of which one mode holds. `cycle` follows the part
once through its modes in their natural order; a push of one contact is one cycle.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jax import Array

from difffric.compute.precision import require_float64
from difffric.compute.pytrees import select
from difffric.rig.rig import Rig
from difffric.simulation.closed_form import ClosedForm
from difffric.simulation.dynamics import CLOSING, FREE, REBOUNDING, STUCK
from difffric.simulation.leg import CATCH, HALT, NONE, RELEASE, STOP, TURN, Leg
from difffric.simulation.stepping.integrator import RungeKutta
from difffric.simulation.stepping.transitions import MAX_CONTACTS

MAX_CYCLES = 1000

OK, RESTS_IN_CONTACT, NEVER_RELEASED, NEVER_RESTS, TOO_MANY_CONTACTS, TOO_MANY_CYCLES = range(6)
NOT_FOLLOWED = 6
REASONS = (
    None,
    "rests in contact",
    "never released: without a stroke the pusher goes on for ever",
    "never comes to rest",
    f"more than {MAX_CONTACTS} contacts",
    f"more than {MAX_CYCLES} cycles in contact",
    "could not be integrated: more steps were needed than allowed, or a law gave no number",
)

NO_MOTION, PUSHED_TO_REST, RELEASED_BY_REBOUND, RELEASED_AT_STOP = range(4)
REGIMES = ("no_motion", "pushed_to_rest", "released_by_rebound", "released_at_stop")


class Segment(NamedTuple):
    """The start of a segment: mode, time [s], tip [m] and its speed [m/s], compression [m],
    the part's speed [m/s]. With these it can be evaluated at any time."""

    mode: Array
    t: Array
    y: Array
    v_p: Array
    z: Array
    u: Array


class State(NamedTuple):
    """Where a push stands: the current segment and what has been counted and measured."""

    segment: Segment
    stuck_first: Array
    contacts: Array
    sticks: Array
    """times that the part was held at rest"""
    moved: Array
    lost_moving: Array
    """loss of contact while the pusher moved (the last one)"""
    lost: Array
    in_contact: Array
    peak: Array
    peak_contact: Array
    """in which contact the peak fell"""
    slid: Array
    """distance since the last loss of contact [m]"""
    endless: Array
    cycles: Array

    @property
    def over(self):
        """Whether nothing more will happen (or more than is followed)."""
        at_rest = (self.segment.mode == STUCK) & (self.segment.v_p == 0)
        too_long = (self.contacts > MAX_CONTACTS) | (self.cycles >= MAX_CYCLES)
        return at_rest | self.endless | too_long


class Integrator(Protocol):
    """What solves the legs of a push: `ClosedForm`, or `Diffrax` as a reference. `RungeKutta`
    follows a push by itself."""

    def check(self, rig: Rig) -> None: ...
    def breakaway(self, rig: Rig, v_p) -> Array: ...
    def closing(self, rig: Rig, z, u, v_p, left, may_halt: bool) -> Leg: ...
    def rebounding(self, rig: Rig, z, u, v_p, left) -> Leg: ...
    def free(self, rig: Rig, z, u, v_p, left, may_catch: bool) -> Leg: ...
    def pushed_state(self, rig: Rig, closing, z, u, v_p, t) -> tuple[Array, Array]: ...
    def free_state(self, rig: Rig, u, t) -> tuple[Array, Array]: ...


def default_integrator(rig: Rig) -> Any:
    """The integrator that serves the rig: the closed form where every law is affine."""
    return ClosedForm() if rig.affine else RungeKutta()


class Push(NamedTuple):
    """A rig, the speed [m/s] that its pusher comes to and an integrator: what one push is of."""

    rig: Rig
    velocity: Array
    integrator: Any

    @classmethod
    def of(cls, rig: Rig, velocity, integrator: Integrator | None = None) -> Push:
        """A push at `velocity` [m/s], by the integrator that serves the rig unless given."""
        require_float64()
        chosen: Any = default_integrator(rig) if integrator is None else integrator
        chosen.check(rig)
        return cls(rig, rig.pusher.speed(velocity), chosen)

    @property
    def once(self) -> bool:
        """Whether one cycle is all: the pusher stops at the first loss of contact."""
        return self.rig.pusher.stroke is None

    def start(self) -> State:
        """At rest in contact without preload, the pusher starting."""
        zero = jnp.zeros(())
        no, one = jnp.asarray(False), jnp.asarray(1)
        velocity = jnp.asarray(self.velocity, float)
        return State(
            segment=Segment(jnp.asarray(STUCK), zero, zero, velocity, zero, zero),
            stuck_first=self.integrator.breakaway(self.rig, velocity) > 0,
            contacts=one,
            sticks=jnp.asarray(0),
            moved=no,
            lost_moving=no,
            lost=no,
            in_contact=~no,
            peak=zero,
            peak_contact=one,
            slid=zero,
            endless=no,
            cycles=jnp.asarray(0),
        )

    def cycle(self, state: State) -> tuple[State, list[Segment]]:
        """Once through the modes; also the five segments' starts, padded by repetition."""
        starts = [state.segment]
        steps = (self._stuck, self._closing, self._rebounding, self._free)
        for mode, step in enumerate(steps):
            state = select((state.segment.mode == mode) & ~state.over, step(state), state)
            starts.append(state.segment)
        # Energy only falls: what the first rebound did not part, no later one will.
        never = self.rig.pusher.stops_at_release() & ~state.lost
        return state._replace(cycles=state.cycles + 1, endless=state.endless | never), starts

    def _left(self, segment):
        stop = self.rig.pusher.stop_time(self.velocity)
        return jnp.where(segment.v_p > 0, jnp.maximum(stop - segment.t, 0.0), jnp.inf)

    def _advance(self, segment, dt, event, mode, z, u):
        """The next segment: the pusher has moved on, or has just stopped."""
        stops = event == STOP
        stroke = 0.0 if self.rig.pusher.stroke is None else self.rig.pusher.stroke
        v_p, left = segment.v_p, self._left(segment)
        t_stop = segment.t + jnp.where(jnp.isfinite(left), left, 0.0)
        t = jnp.where(stops, t_stop, segment.t + dt)
        y = jnp.where(stops, stroke, segment.y + v_p * jnp.where(v_p > 0, dt, 0.0))
        return Segment(jnp.asarray(mode), t, y, jnp.where(stops, 0.0, v_p), z, u)

    def _stuck(self, state: State) -> State:
        s, rig = state.segment, self.rig
        z_b = self.integrator.breakaway(rig, s.v_p)
        left = self._left(s)
        wait = (z_b - s.z) / s.v_p
        breaks = wait <= left
        dt = jnp.where(breaks, wait, left)
        z = jnp.where(breaks, z_b, s.z + s.v_p * dt)
        touches = (s.z < 0) & (z >= 0)
        contacts = state.contacts + touches
        force = jnp.where(z >= 0, rig.contact.approach(z, s.v_p), 0.0)
        higher = ~breaks & (force > state.peak)
        event = jnp.where(breaks, NONE, STOP)
        mode = jnp.where(breaks, CLOSING, STUCK)
        return state._replace(
            segment=self._advance(s, dt, event, mode, z, jnp.zeros_like(s.u)),
            contacts=contacts,
            sticks=state.sticks + (wait > 0),
            moved=state.moved | breaks,
            in_contact=z >= 0,
            peak=jnp.where(higher, force, state.peak),
            peak_contact=jnp.where(higher, contacts, state.peak_contact),
        )

    def _closing(self, state: State) -> State:
        s = state.segment
        leg = self.integrator.closing(self.rig, s.z, s.u, s.v_p, self._left(s), not self.once)
        higher = ~(leg.peak <= state.peak)  # so that a peak that is no number shows
        mode = jnp.where(leg.event == HALT, STUCK, REBOUNDING)
        never = leg.event == NONE
        after = self._advance(s, leg.dt, leg.event, mode, leg.z, leg.u)
        return state._replace(
            segment=select(never, s, after),
            peak=jnp.where(higher, leg.peak, state.peak),
            peak_contact=jnp.where(higher, state.contacts, state.peak_contact),
            endless=state.endless | never,
        )

    def _rebounding(self, state: State) -> State:
        s = state.segment
        leg = self.integrator.rebounding(self.rig, s.z, s.u, s.v_p, self._left(s))
        turned = jnp.where(s.v_p > 0, CLOSING, STUCK)
        mode = jnp.where(
            leg.event == RELEASE, FREE, jnp.where(leg.event == TURN, turned, REBOUNDING)
        )
        after = self._advance(s, leg.dt, leg.event, mode, leg.z, leg.u)
        never, released = leg.event == NONE, leg.event == RELEASE
        stands = released & self.rig.pusher.stops_at_release()
        after = after._replace(v_p=jnp.where(stands, 0.0, after.v_p))
        return state._replace(
            segment=select(never, s, after),
            lost=state.lost | released,
            lost_moving=jnp.where(released, s.v_p > 0, state.lost_moving),
            in_contact=state.in_contact & ~released,
            slid=jnp.where(released, 0.0, state.slid),
            endless=state.endless | never,
        )

    def _free(self, state: State) -> State:
        s = state.segment
        leg = self.integrator.free(self.rig, s.z, s.u, s.v_p, self._left(s), not self.once)
        caught = leg.event == CATCH
        mode = jnp.where(caught, CLOSING, jnp.where(leg.event == HALT, STUCK, FREE))
        return state._replace(
            segment=self._advance(s, leg.dt, leg.event, mode, leg.z, leg.u),
            contacts=state.contacts + caught,
            in_contact=caught,
            slid=state.slid + leg.slid,
            endless=state.endless | (leg.event == NONE),
        )

    def last_state(self) -> State:
        """Follow the push to its end."""
        if self.once:
            return self.cycle(self.start())[0]
        return jax.lax.while_loop(lambda s: ~s.over, lambda s: self.cycle(s)[0], self.start())

    def segments(self, cycles: int = MAX_CYCLES) -> tuple[State, Segment]:
        """Follow the push to its end, or for so many cycles at most; also all segments, stacked
        and padded with t = inf."""
        if self.once:
            state, starts = self.cycle(self.start())
            return state, jax.tree.map(lambda *rows: jnp.stack(rows), *starts)
        start = self.start()
        rows = 4 * cycles + 1
        table = jax.tree.map(lambda a: jnp.zeros(rows, a.dtype).at[0].set(a), start.segment)
        table = table._replace(t=table.t.at[1:].set(jnp.inf))

        def follow(carry):
            state, table = carry
            after, starts = self.cycle(state)
            new = jax.tree.map(lambda *rows: jnp.stack(rows), *starts[1:])

            def write(whole, part):
                return jax.lax.dynamic_update_slice(whole, part, (4 * state.cycles + 1,))

            return after, jax.tree.map(write, table, new)

        def goes_on(carry):
            return ~carry[0].over & (carry[0].cycles < cycles)

        return jax.lax.while_loop(goes_on, follow, (start, table))
