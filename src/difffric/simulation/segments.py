"""One push: modes, events and segments, through whichever integrator serves the rig.

A push is a sequence of segments, in each of which one mode holds. `cycle` follows the part
once through its modes in their natural order; a push of one contact is one cycle.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from difffric.compute import arrays as xp
from difffric.compute.lanes import change_where, repeat_while
from difffric.compute.pytrees import select
from difffric.rig.number import Number, Truth
from difffric.rig.rig import Rig
from difffric.simulation.closed_form import ClosedForm
from difffric.simulation.events import MAX_CONTACTS, MAX_CYCLES, Event, Mode
from difffric.simulation.force_latch import ForceFall, ForceLatch
from difffric.simulation.leg import Leg

if TYPE_CHECKING:
    from jaxtyping import Array, ArrayLike, Bool, Float, Int


class Segment(NamedTuple):
    """The start of a segment; with it the segment can be evaluated at any time."""

    mode: Int[Array, ""]
    t: Float[Array, ""]
    """time [s]"""
    y: Float[Array, ""]
    """the tip's travel [m]"""
    v_p: Float[Array, ""]
    """the tip's speed [m/s]"""
    z: Float[Array, ""]
    """compression [m]"""
    u: Float[Array, ""]
    """the part's speed [m/s]"""


class State(NamedTuple):
    """Where a push stands: the current segment and what has been counted and measured."""

    segment: Segment
    stuck_first: Bool[Array, ""]
    """whether static friction held the part at the start"""
    contacts: Int[Array, ""]
    """contacts so far, that at the start included"""
    sticks: Int[Array, ""]
    """times that the part was held at rest"""
    moved: Bool[Array, ""]
    """whether the part has ever slid"""
    lost_moving: Bool[Array, ""]
    """whether contact was lost while the pusher moved, the last time"""
    lost: Bool[Array, ""]
    """whether contact has ever been lost"""
    in_contact: Bool[Array, ""]
    peak: Float[Array, ""]
    """the largest contact force [N]"""
    peak_contact: Int[Array, ""]
    """the contact in which it fell"""
    slid: Float[Array, ""]
    """distance since the last loss of contact [m]"""
    endless: Bool[Array, ""]
    """whether the push goes on for ever"""
    cycles: Int[Array, ""]
    """turns through the modes"""
    latch: Any = None
    """a `ForceLatch` where the probe has one"""

    @property
    def over(self) -> Bool[Array, ""]:
        """Whether nothing more will happen (or more than is followed)."""
        at_rest = (self.segment.mode == Mode.STUCK) & (self.segment.v_p == 0)
        too_long = (self.contacts > MAX_CONTACTS) | (self.cycles >= MAX_CYCLES)
        return at_rest | self.endless | too_long


class Integrator(Protocol):
    """What solves the legs of a push: `ClosedForm`, or `Diffrax` as a reference. `RungeKutta`
    follows a push by itself.

    A leg starts at the compression z [m] and the part's speed u [m/s]; the tip moves at v_p [m/s],
    for `left` [s] more (infinite without a stroke).
    """

    def check(self, rig: Rig) -> None:
        """Raise `InputError` where it does not serve the rig."""
        ...

    def find_breakaway(self, rig: Rig, v_p: Number) -> Float[Array, ""]:
        """The compression [m] at which a part at rest starts to slide; 0: at once."""
        ...

    def follow_closing(
        self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number, may_halt: bool
    ) -> Leg:
        """The tip closes in on the part, until it turns, halts or the pusher stops."""
        ...

    def follow_rebounding(self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number) -> Leg:
        """The part recedes from the tip, until release, turn or the pusher's stop."""
        ...

    def follow_free(
        self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number, may_catch: bool
    ) -> Leg:
        """The part slides without contact, until rest, the pusher's stop or the next contact."""
        ...

    def evaluate_pushed(
        self, rig: Rig, closing: Truth, z: Number, u: Number, v_p: Number, t: Number
    ) -> tuple[Array, Array]:
        """(z [m], u [m/s]) at the time t [s] into a leg of closing, or else of rebounding."""
        ...

    def evaluate_free(self, rig: Rig, u: Number, t: Number) -> tuple[Array, Array]:
        """(distance [m], u [m/s]) at the time t [s] into a free leg."""
        ...

    def find_force_fall(
        self, rig: Rig, closing: bool, z: Number, u: Number, v_p: Number, dt: Number
    ) -> ForceFall:
        """How the force goes along a pushed leg of dt [s], beside the threshold of the probe's
        latch. Only asked where the probe has one."""
        ...


def default_integrator(rig: Rig) -> Any:
    """The integrator that serves the rig: the closed form where every law is affine."""
    if rig.affine:
        return ClosedForm()
    from difffric.simulation.stepping.integrator import RungeKutta  # it imports JAX

    return RungeKutta()


class Push(NamedTuple):
    """A rig, the speed [m/s] that its pusher comes to and an integrator: what one push is of."""

    rig: Rig
    velocity: Float[Array, ""]
    integrator: Any

    @classmethod
    def of(
        cls, rig: Rig, velocity: Float[ArrayLike, ""], integrator: Integrator | None = None
    ) -> Push:
        """A push at `velocity` [m/s] for JAX to follow, by the integrator that serves the rig
        unless given."""
        import jax.numpy as jnp

        from difffric.compute.precision import require_float64

        require_float64()
        chosen: Any = default_integrator(rig) if integrator is None else integrator
        chosen.check(rig)
        return cls(rig, jnp.asarray(rig.pusher.speed(velocity), float), chosen)

    @property
    def once(self) -> bool:
        """Whether one cycle is all: the pusher stops at the first loss of contact, and nothing
        holds the part again."""
        return self.rig.pusher.stroke is None and not self.rig.contact.parts_early

    def start(self) -> State:
        """At rest in contact without preload, the pusher starting."""
        velocity = xp.asarray(self.velocity, float)
        zero = xp.zeros_like(velocity)
        no, none = xp.zeros_like(velocity, bool), xp.zeros_like(velocity, int)
        one = xp.ones_like(velocity, int)
        return State(
            segment=Segment(
                xp.full_like(velocity, Mode.STUCK, int), zero, zero, velocity, zero, zero
            ),
            stuck_first=self.integrator.find_breakaway(self.rig, velocity) > 0,
            contacts=one,
            sticks=none,
            moved=no,
            lost_moving=no,
            lost=no,
            in_contact=~no,
            peak=zero,
            peak_contact=one,
            slid=zero,
            endless=no,
            cycles=none,
            latch=ForceLatch(no, no, zero) if self.rig.probe.latches else None,
        )

    def cycle(self, state: State) -> tuple[State, list[Segment]]:
        """Once through the modes; also the five segments' starts, padded by repetition."""
        starts = [state.segment]
        steps = (Push._wait_stuck, Push._close, Push._rebound, Push._slide)
        for mode, step in enumerate(steps):
            here = (state.segment.mode == mode) & ~state.over
            state = change_where(here, lambda s, push, step=step: step(push, s), state, self)
            starts.append(state.segment)
        # Energy only falls: what the first rebound did not part, no later one will.
        never = self.rig.pusher.stops_at_release() & ~state.lost
        return state._replace(cycles=state.cycles + 1, endless=state.endless | never), starts

    def _time_left(self, segment):
        stop = self.rig.pusher.stop_time(self.velocity)
        return xp.where(segment.v_p > 0, xp.maximum(stop - segment.t, 0.0), xp.inf)

    def _advance(self, segment, dt, event, mode, z, u):
        """The next segment: the pusher has moved on, or has just stopped."""
        stops = event == Event.STOP
        pusher = self.rig.pusher
        stroke = 0.0 if pusher.stroke is None else pusher.travel(self.velocity)
        v_p, left = segment.v_p, self._time_left(segment)
        t_stop = segment.t + xp.where(xp.isfinite(left), left, 0.0)
        t = xp.where(stops, t_stop, segment.t + dt)
        y = xp.where(stops, stroke, segment.y + v_p * xp.where(v_p > 0, dt, 0.0))
        return Segment(xp.asarray(mode), t, y, xp.where(stops, 0.0, v_p), z, u)

    def _watch(self, state: State, leg: Leg, closing: bool) -> ForceLatch | None:
        """The latch after a pushed leg; one that is closed looks no more."""
        if state.latch is None:
            return None

        def watch(latch: ForceLatch, s: Segment, dt: Number, push: Push) -> ForceLatch:
            rig, start = push.rig, (s.z, s.u, s.v_p)
            fall = push.integrator.find_force_fall(rig, closing, *start, dt)
            t = xp.where(xp.isfinite(fall.time), fall.time, 0.0)
            pushed = xp.full_like(s.z, closing, bool)
            z, _ = push.integrator.evaluate_pushed(rig, pushed, *start, t)
            return latch.follow(rig.probe.latch, fall, s.y - s.z, s.y + s.v_p * t - z)

        open_ = ~state.latch.closed
        return change_where(open_, watch, state.latch, state.segment, leg.dt, self)

    def _watch_still(self, state: State, first: Number, last: Number) -> ForceLatch | None:
        """The latch after a leg in which the force only rises, or is none."""
        if state.latch is None:
            return None
        x, fall = state.segment.y - state.segment.z, ForceFall(first, last, xp.inf)
        return state.latch.follow(self.rig.probe.latch, fall, x, x)

    def _wait_stuck(self, state: State) -> State:
        s, rig = state.segment, self.rig
        z_b = self.integrator.find_breakaway(rig, s.v_p)
        left = self._time_left(s)
        wait = (z_b - s.z) / s.v_p
        breaks = wait <= left
        dt = xp.where(breaks, wait, left)
        z = xp.where(breaks, z_b, s.z + s.v_p * dt)
        touches = (s.z < 0) & (z >= 0)
        contacts = state.contacts + touches
        force = xp.where(z >= 0, rig.contact.approach(z, s.v_p), 0.0)
        higher = ~breaks & (force > state.peak)
        event = xp.where(breaks, Event.NONE, Event.STOP)
        mode = xp.where(breaks, Mode.CLOSING, Mode.STUCK)
        return state._replace(
            segment=self._advance(s, dt, event, mode, z, xp.zeros_like(s.u)),
            contacts=contacts,
            sticks=state.sticks + (wait > 0),
            moved=state.moved | breaks,
            in_contact=z >= 0,
            peak=xp.where(higher, force, state.peak),
            peak_contact=xp.where(higher, contacts, state.peak_contact),
            latch=self._watch_still(
                state, xp.where(s.z >= 0, rig.contact.approach(s.z, s.v_p), 0.0), force
            ),
        )

    def _close(self, state: State) -> State:
        s = state.segment
        leg = self.integrator.follow_closing(
            self.rig, s.z, s.u, s.v_p, self._time_left(s), not self.once
        )
        higher = ~(leg.peak <= state.peak)  # so that a peak that is no number shows
        mode = xp.where(leg.event == Event.HALT, Mode.STUCK, Mode.REBOUNDING)
        never = leg.event == Event.NONE
        after = self._advance(s, leg.dt, leg.event, mode, leg.z, leg.u)
        return state._replace(
            segment=select(never, s, after),
            peak=xp.where(higher, leg.peak, state.peak),
            peak_contact=xp.where(higher, state.contacts, state.peak_contact),
            endless=state.endless | never,
            latch=self._watch(state, leg, True),
        )

    def _rebound(self, state: State) -> State:
        s = state.segment
        leg = self.integrator.follow_rebounding(self.rig, s.z, s.u, s.v_p, self._time_left(s))
        turned = xp.where(s.v_p > 0, Mode.CLOSING, Mode.STUCK)
        mode = xp.where(
            leg.event == Event.RELEASE,
            Mode.FREE,
            xp.where(leg.event == Event.TURN, turned, Mode.REBOUNDING),
        )
        after = self._advance(s, leg.dt, leg.event, mode, leg.z, leg.u)
        never, released = leg.event == Event.NONE, leg.event == Event.RELEASE
        stands = released & self.rig.pusher.stops_at_release()
        after = after._replace(v_p=xp.where(stands, 0.0, after.v_p))
        return state._replace(
            segment=select(never, s, after),
            lost=state.lost | released,
            lost_moving=xp.where(released, s.v_p > 0, state.lost_moving),
            in_contact=state.in_contact & ~released,
            slid=xp.where(released, 0.0, state.slid),
            endless=state.endless | never,
            latch=self._watch(state, leg, False),
        )

    def _slide(self, state: State) -> State:
        s = state.segment
        leg = self.integrator.follow_free(
            self.rig, s.z, s.u, s.v_p, self._time_left(s), not self.once
        )
        caught = leg.event == Event.CATCH
        pushed = Mode.CLOSING
        if self.rig.contact.parts_early:  # held again while it still recedes
            pushed = xp.where(leg.z > 0, Mode.REBOUNDING, Mode.CLOSING)
        mode = xp.where(caught, pushed, xp.where(leg.event == Event.HALT, Mode.STUCK, Mode.FREE))
        return state._replace(
            segment=self._advance(s, leg.dt, leg.event, mode, leg.z, leg.u),
            contacts=state.contacts + caught,
            in_contact=caught,
            slid=state.slid + leg.slid,
            endless=state.endless | (leg.event == Event.NONE),
            latch=self._watch_still(state, 0.0, xp.zeros_like(s.z)),
        )

    def last_state(self) -> State:
        """Follow the push to its end, past what only repeats itself."""
        if self.once:
            return self.cycle(self.start())[0]

        def turn(state: State, push: Push) -> State:
            return push.cycle(push._skip_repeats(state))[0]

        return repeat_while(lambda s: ~s.over, turn, self.start(), self)

    def _skip_repeats(self, state: State) -> State:
        """The state after all whole periods of stick-slip that are left; exact, and so are its
        derivatives.

        Each slip begins as the first did: at the breakaway's compression, at rest, the tip at its
        speed. So a part that is held again, x from its start, has come as far as the tip does in a
        period x / v, and all repeats itself until the stop. Not where contact was lost: it is then
        lost in each period, and contacts are counted.
        """
        s = state.segment
        again = (s.mode == Mode.STUCK) & state.moved & (s.v_p > 0) & ~state.lost
        return change_where(again, lambda state, push: push._skip_periods(state), state, self)

    def _skip_periods(self, state: State) -> State:
        s = state.segment
        left, x = self._time_left(s), s.y - s.z
        period = x / s.v_p
        some = xp.isfinite(left) & (period > 0)
        many = xp.where(some, xp.floor(left / xp.where(some, period, 1.0)), 0.0)
        ahead = s._replace(
            t=s.t + xp.where(some, many * period, 0.0), y=s.y + xp.where(some, many * x, 0.0)
        )
        return state._replace(segment=ahead, sticks=state.sticks + xp.asarray(many, int))

    def segments(self, cycles: int = MAX_CYCLES) -> tuple[State, Segment]:
        """Follow the push to its end, or for so many cycles at most; also all segments, stacked
        and padded with t = inf. By JAX."""
        import jax
        import jax.numpy as jnp

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
