"""The integrator for any laws: a push followed step by step, in one loop for all its modes.

Each turn of the loop is one Runge-Kutta step in the mode that holds. Where a guard falls through
zero within the step, the step is cut there, and taken again until it ends on the event; a Taylor
step then closes what is left of it, which also carries the event time's derivatives, exactly to
second order. Two events within one step come in the order of their times, and a step that ends
on one looks for the others too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from difffric.compute import hermite
from difffric.compute.pytrees import select
from difffric.compute.xla_options import hold, in_one_piece
from difffric.simulation.dynamics import Course, Motion, PhasePoint
from difffric.simulation.events import Event, Mode
from difffric.simulation.stepping.dense_output import Stride
from difffric.simulation.stepping.dop853 import take_step, take_step_in_loop
from difffric.simulation.stepping.event_location import Guard, GuardCrossing, find_crossing
from difffric.simulation.stepping.sensor_readout import sense, start_readout
from difffric.simulation.stepping.state import LoopState
from difffric.simulation.stepping.step_plan import StepPlan, StepStart, plan_step
from difffric.simulation.stepping.transitions import STEADY, Rules
from difffric.units import GRAVITY

MAX_STEPS = 20_000
"""Steps after which a push is given up, so that laws that make no sense come to an end too."""
_LOST = 1e-13  # of the push's own time: a step as short as this no longer moves it
_BRIEF = 1e-6
"""The same: how far a shorter step leads is lost to rounding, and its speeds with it."""
_ROUNDING = 1e-12  # of g: a part that has just broken away slows by less, which is rounding
_CLOSE = 1e-4
"""Of a free step: an event this near to the end is reached by the Taylor step."""
_LOOSELY_CLOSE, _NOT_FAR = 10.0, 0.1
"""The same in units of the tolerance's root, as the Taylor step's remainder is of third order; up
to this share of the step itself."""
_CAUGHT, _LET_GO = 0.55, 0.1
"""Of the push's own time: the first step of a part that is caught, at most, or let go, at least."""
_SLIPPING = 10.0
"""What is left for bristles to bend, as a share and in units of the tolerance, where they slip."""
_MOST_GROWTH = 4.0
"""By how much a step may be longer than the one before: with 6 a part that is let go within the
spring's reach was caught again unseen."""
_LOOKS, _HIGH = np.arange(1, 8) / 8, 0.95
"""Shares of a step at which the force is looked at, and how high it must be there, as a share of
the highest so far, to be followed to its summit."""


class _StepEnd(NamedTuple):
    """What is known where a step ends: the state, its rate and the rate's rate, and each guard and
    the force to second order."""

    s: PhasePoint
    rate: PhasePoint
    bend: PhasePoint
    guards: dict[Event, Array]
    slopes: dict[Event, Array]
    bends: dict[Event, Array]
    N: Array
    dN: Array
    ddN: Array


class _Outcome(NamedTuple):
    """What has become of a step."""

    err: Array
    """its error, at most 1 where it is good"""
    crossing: GuardCrossing
    arrived: Array
    """whether it ends on an event"""
    cut: Array
    """whether it goes beyond one"""
    accept: Array
    """whether it counts"""
    dt: Array
    """from its end to the event that it ends on [s], else 0"""


class StepLoop(NamedTuple):
    """A push to be followed step by step: its motion, its scales, and how."""

    motion: Motion
    z_0: Float[Array, ""]
    """about the compression under the part's own weight [m]"""
    tol: float = 1e-10
    looped: bool = False
    """whether a step's stages are looped over, which compiles sooner and runs slower"""
    blind: bool = False
    """whether only the motion is asked for, not what the sensors make of its peak and release"""
    most: int = MAX_STEPS
    """steps after which it is given up"""

    @property
    def senses(self) -> bool:
        """Whether the sensors see more than the plain peak and release."""
        sensor, probe = self.motion.rig.force_sensor, self.motion.rig.probe
        return not self.blind and (sensor.filtered or sensor.sampled or probe.late)

    @property
    def rules(self) -> Rules:
        """What the push's events change."""
        return Rules(self.motion, self.z_0)

    @property
    def u_0(self) -> Float[Array, ""]:
        """A speed [m/s] of the push's own."""
        return self.rules.u_0

    @property
    def time(self) -> Float[Array, ""]:
        """A time [s] of the push's own."""
        return self.rules.time

    def run(self) -> LoopState:
        """Follow the push to its end."""

        def turn(m):
            return self.step(m)[0]

        # Run loop by loop, starting the loops would cost more than what is in them.
        own = self.motion.rig.only_own_laws
        step = in_one_piece(turn) if own else turn
        return jax.lax.while_loop(self.is_unfinished, step, self.start())

    def is_unfinished(self, m: LoopState) -> Bool[Array, ""]:
        """Whether there is a next step."""
        return ~m.over & (m.steps < self.most)

    def start(self) -> LoopState:
        """At rest, the pusher starting."""
        rig, v = self.motion
        zero, no = jnp.zeros(()), jnp.asarray(False)
        gap = jnp.asarray(rig.contact.gap, float)
        bristles = self.motion.bristles
        course = Course(
            mode=jnp.asarray(Mode.STUCK),
            touching=gap <= 0,
            moved=no,
            stopped=no,
            t_stop=zero,
            V_stop=zero,
            beyond=no,
            corners=jnp.asarray(rig.pusher.corner(v, 0) <= 0, int),
            way=jnp.ones(()),
            slipped=None if bristles is None else no,
        )
        # At rest on its bristles, which hold it against the slope.
        q = None if bristles is None else -rig.slope / bristles.stiffness + zero
        s = PhasePoint(zero, -gap, zero, zero, q)
        at_once = self.rules.is_breaking(course, s)
        first = jnp.where(at_once, Mode.CLOSING, Mode.STUCK)
        none = jnp.asarray(0)
        m = LoopState(
            s=s,
            course=course._replace(mode=first, moved=at_once),
            h=0.3 * stop_gradient(self.time) + zero,
            target=jnp.asarray(Event.NONE),
            h_target=zero,
            contacts=jnp.where(gap <= 0, 1, 0),
            sticks=(~at_once).astype(int),
            lost=no,
            lost_moving=no,
            t_lost=zero,
            x_lost=zero,
            peak=zero,
            peak_contact=jnp.asarray(1),
            summited=no,
            slowed=no,
            rebounds=none,
            halts=none,
            endless=no,
            over=no,
            steps=none,
            strides=none,
            lost_track=no,
            stuck_first=~at_once,
            sensed=start_readout(self.motion) if self.senses else None,
        )
        return m._replace(over=self.rules.is_at_rest(m))

    def step(self, m: LoopState, record: bool = False) -> tuple[LoopState, Stride | None]:
        """One turn of the loop; also the step as a stride where one is asked for or needed."""
        c = m.course

        def field(p):
            return self.motion.rates(c, p)

        begin = hold(self._look_at_start(m, field(m.s)))
        plan = hold(plan_step(self.rules, m, begin, self.tol))
        take = take_step_in_loop if self.looped else take_step
        y, errors = hold(take(field, m.s, begin.rate, plan.h))
        end = hold(self._look_at_end(c, y, field))
        steady = self._is_steady(c, begin)
        outcome = hold(self._judge_step(m, plan, begin, end, errors, steady))
        done = hold(self._accept(m, plan, begin, end, outcome))
        stride = None
        if self.senses or record:
            stride = self._record(m, begin, end, plan.h, outcome.dt)
        if self.senses and stride is not None:
            release = c.touching & ~done.course.touching
            done = done._replace(sensed=sense(self.motion, m.sensed, stride, release))
        new = select(outcome.accept, done, self._try_again(m, plan, outcome))
        return self._count_step(m, new, outcome.accept, steady), stride

    def _look(
        self, c: Course, p: PhasePoint, r: PhasePoint
    ) -> tuple[tuple[dict[Event, Array], Array], tuple[dict[Event, Array], Array]]:
        """Guards and N at p, and their rates where p's own are r."""
        return jax.jvp(lambda q: self.motion.guards(c, q), (p,), (r,))

    def _look_at_start(self, m: LoopState, rate: PhasePoint) -> StepStart:
        (guards, N), (slopes, dN) = self._look(m.course, m.s, rate)
        return StepStart(rate, guards, slopes, N, dN)

    def _look_at_end(
        self, c: Course, y: PhasePoint, field: Callable[[PhasePoint], PhasePoint]
    ) -> _StepEnd:
        rate = field(y)
        bend = jax.jvp(field, (y,), (rate,))[1]

        def look(p, r):
            return self._look(c, p, r)

        values, rates = jax.jvp(look, (y, rate), (rate, bend))
        ((guards, N), (slopes, dN)), (_, (bends, ddN)) = values, rates
        return _StepEnd(y, rate, bend, guards, slopes, bends, N, dN, ddN)

    def _scale_error(self, errors: list[Array], mode: Array, h: Array) -> Array:
        """The error of a step of h [s], in units of what it may be: at most 1 where the step is
        good."""
        # What goes wrong in contact is amplified by what follows, in a free slide it is not.
        tol = self.tol * jnp.where(mode == Mode.FREE, 30.0, 1.0)
        err = jnp.zeros_like(h)
        for error, scale in zip(errors, (self.z_0, self.u_0, self.z_0, self.z_0), strict=False):
            err = jnp.maximum(err, error / (scale * tol))
        return stop_gradient(jnp.where(jnp.isfinite(err), err, 1e9))

    def _guards(
        self, m: LoopState, plan: StepPlan, begin: StepStart, end: _StepEnd
    ) -> dict[Event, Guard]:
        """Every guard of the mode over the step, in the order in which they are asked."""
        c, s, y, h = m.course, m.s, end.s, plan.h
        found = {
            event: Guard.of(
                h,
                (begin.guards[event], begin.slopes[event]),
                (end.guards[event], end.slopes[event], end.bends[event]),
            )
            for event in end.guards
        }
        if plan.corner is not None:
            waits = jnp.isfinite(plan.corner)
            slope = jnp.where(waits, -1.0, 0.0)
            left = jnp.where(waits, plan.corner - (y.t - s.t), 1.0)
            start = jnp.where(waits, plan.corner, 1.0), slope
            found[Event.CORNER] = Guard.of(h, start, (left, slope, jnp.zeros_like(h)))
        # The force is highest where its rate falls through zero, the part slowest where x'' rises.
        closing = c.mode == Mode.CLOSING
        # A summit that is lower than one before is none: two steps are saved.
        rises = closing & ~m.summited & (begin.dN > 0) & self._is_high(m, begin, end, h)
        slows = begin.rate.u < -_ROUNDING * GRAVITY
        slow = closing & ~m.slowed & slows & (jnp.minimum(s.u, y.u) < 0.05 * self.motion.v)
        found[Event.FORCE_PEAK] = Guard.of_maximum(
            h, rises, (begin.N, begin.dN), (end.N, end.dN, end.ddN)
        )
        found[Event.SLOWEST] = Guard.of_maximum(
            h, slow, (-s.u, -begin.rate.u), (-y.u, -end.rate.u, -end.bend.u)
        )
        return found

    def _is_high(self, m: LoopState, begin: StepStart, end: _StepEnd, h: Array) -> Array:
        """Whether the force may come to more in a step of h [s] than ever before."""
        numbers = begin.N, begin.dN * h, end.N, end.dN * h, end.ddN * h * h
        curve = hermite.fit_quartic(*stop_gradient(numbers))
        high = jnp.maximum(begin.N, end.N)
        for share in _LOOKS:
            high = jnp.maximum(high, hermite.evaluate(curve, share))
        return high > _HIGH * m.peak

    def _is_steady(self, c: Course, begin: StepStart) -> Array:
        """Whether the part slides steadily before the tip, which has no events but the stop."""
        turn, slope = begin.guards[Event.TURN], begin.slopes[Event.TURN]
        quiet = jnp.abs(turn) + jnp.abs(slope) * self.time < STEADY * self.u_0
        return ((c.mode == Mode.CLOSING) | (c.mode == Mode.REBOUNDING)) & quiet & ~c.stopped

    def _judge_step(
        self,
        m: LoopState,
        plan: StepPlan,
        begin: StepStart,
        end: _StepEnd,
        errors: list[Array],
        steady: Array,
    ) -> _Outcome:
        """Whether the step is good, and which event it ends on or goes beyond."""
        h = plan.h
        err = self._scale_error(errors, m.course.mode, h)
        good = err <= 1
        free = jnp.maximum(m.h, h) / h
        loosely = jnp.minimum(_LOOSELY_CLOSE * self.tol**0.5 * free, _NOT_FAR)
        near = jnp.maximum(_CLOSE * free, loosely)
        guards = self._guards(m, plan, begin, end)
        crossing = find_crossing(guards, h, plan.aim, near, steady)
        arrived = good & crossing.passed & (crossing.share >= 1 - near)
        # Beyond the event the law may not be smooth: a poor step is cut there too.
        cut = crossing.passed & (crossing.share < 1 - near)
        dt = crossing.find_time_beyond(arrived, 3 * near * h)
        return _Outcome(err, crossing, arrived, cut, good & ~cut, dt)

    def _accept(
        self, m: LoopState, plan: StepPlan, begin: StepStart, end: _StepEnd, outcome: _Outcome
    ) -> LoopState:
        """The state after the step, on the event that it has arrived at."""
        arrived, dt = outcome.arrived, outcome.dt

        def beyond(a, b, e):
            return a + dt * b + 0.5 * dt * dt * e

        at = jax.tree.map(beyond, end.s, end.rate, end.bend)
        N = end.N + dt * (end.dN + 0.5 * dt * end.ddN)
        force = jnp.where(N > begin.N, N, begin.N)
        higher = outcome.accept & ~(force <= m.peak)  # so that a force that is no number shows
        grow = jnp.clip(0.9 * jnp.maximum(outcome.err, 1e-9) ** (-1.0 / 8.0), 0.2, _MOST_GROWTH)
        kept = jnp.maximum(m.h, jnp.where(plan.at_once, 0.0, plan.h))
        event = jnp.where(arrived, outcome.crossing.event, Event.NONE)
        done = self.rules.pass_event(m, event, at, end.rate.u)
        if self.motion.bristles is not None:
            done = done._replace(course=self._note_slip(done.course, done.s))
        # How long a part waits at rest says nothing of how it then moves.
        waits = (m.course.mode == Mode.STUCK) & (plan.h < m.h)
        h = jnp.where(arrived | plan.at_once | plan.aims | waits, kept, plan.h * grow)
        return done._replace(
            h=self._begin_anew(event, m.course.mode, done.course.mode, h),
            peak=jnp.where(higher, force, m.peak),
            peak_contact=jnp.where(higher, m.contacts, m.peak_contact),
        )

    def _note_slip(self, c: Course, s: PhasePoint) -> Course:
        """The course with whether bristles slip: once they are bent nearly as far as they go."""
        slips = self.motion.bristles.find_yield(c.way, self.motion.load(c, s))
        left = stop_gradient(1.0 - s.q / slips)
        return c._replace(slipped=c.slipped | (left < _SLIPPING * self.tol))

    def _begin_anew(self, event: Array, before: Array, after: Array, h: Array) -> Array:
        """The next step [s], of a size that fits what an event begins: h is the one before it."""
        time = stop_gradient(self.time)
        caught = (before == Mode.FREE) & (after != Mode.FREE)
        h = jnp.where(caught, jnp.minimum(h, _CAUGHT * time), h)
        let_go = (before != Mode.FREE) & (after == Mode.FREE)
        h = jnp.where(let_go, jnp.maximum(h, _LET_GO * time), h)
        lag = stop_gradient(jnp.asarray(self.motion.rig.pusher.lag(), float))
        stops = (event == Event.STOP) & (lag > 0)
        h = jnp.where(stops, jnp.minimum(h, lag), h)
        if self.motion.bristles is None:
            return h
        swing = stop_gradient(jnp.sqrt(self.motion.rig.mass / self.motion.bristles.stiffness))
        return jnp.where(event == Event.HALT, jnp.minimum(h, swing), h)

    def _try_again(self, m: LoopState, plan: StepPlan, outcome: _Outcome) -> LoopState:
        """The state before the same step, which is to end on the event that it went beyond, or to
        be shorter by its error."""
        err, crossing = outcome.err, outcome.crossing
        shorter = plan.h * jnp.clip(0.9 * err**-0.25, 0.1, 0.7)
        return m._replace(
            target=jnp.where(outcome.cut, crossing.event, Event.NONE),
            h_target=crossing.share * plan.h,
            h=jnp.where(err <= 1, m.h, shorter),
        )

    def _count_step(self, m: LoopState, new: LoopState, accept: Array, steady: Array) -> LoopState:
        """The new state, with the step counted; over where it leads nowhere."""
        lost = new.h < _LOST * self.time
        for_ever = steady & self.motion.rig.pusher.stops_at_release()
        return new._replace(
            steps=m.steps + 1,
            strides=m.strides + accept,
            over=new.over | lost | for_ever,
            endless=new.endless | for_ever,
            lost_track=m.lost_track | lost,
        )

    def _record(self, m: LoopState, begin: StepStart, end: _StepEnd, h: Array, dt: Array) -> Stride:
        """The step of h [s], and the Taylor step dt [s] beyond it, as functions of time."""
        c = m.course
        bend = jax.jvp(lambda p: self.motion.rates(c, p), (m.s,), (begin.rate,))[1]
        time = stop_gradient(self.time)
        brief, h = h < _BRIEF * time, jnp.maximum(h, 1e-12 * time)
        ends = (m.s, begin.rate, bend), (end.s, end.rate, end.bend)
        return Stride.of(self.motion, c, *ends, h, 1 + dt / h, brief)
