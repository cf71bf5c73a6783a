"""The slow reference for any smooth laws: legs of a push in diffrax's Runge-Kutta steps.

Tests hold the fast integrators against it. diffrax has the methods and their step control; loop and
events stand here, as `diffrax.Event` knows neither a bracket around an event's root nor the order
of two events within one step.

A leg is followed step by step in one smooth right-hand side. A step at whose end an event has
passed is the last. The event's time is the bracketed root over that step's own length, the
method stepping anew from the step's start: no interpolant comes in, and two events within one
step are put in order by their times.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float

from difffric.compute.event_root import find_falling_root
from difffric.compute.pytrees import select
from difffric.compute.smooth_extension import extend_odd
from difffric.errors import InputError
from difffric.rig.number import Number, Truth
from difffric.rig.rig import Rig
from difffric.simulation.dynamics import LARGEST_COMPRESSION, find_compression
from difffric.simulation.events import Event
from difffric.simulation.leg import Leg, first_event
from difffric.units import GRAVITY


class _ScaledMotion(eqx.Module):
    """The right-hand side of one mode, in scaled states y = (z / z_0, u / u_0).

    z_0 [m] is about the compression under the part's own weight, u_0 = sqrt(z_0 g) [m/s].
    """

    rig: Rig
    v_p: Float[Array, ""] | float
    scale: Array
    mode: str = eqx.field(static=True)

    @classmethod
    def of(cls, rig: Rig, mode: str, v_p: Float[Array, ""] | float) -> _ScaledMotion:
        """The motion of a rig in a mode: "approach", "rebound" or "free", the tip's speed v_p
        [m/s]."""
        z_0 = stop_gradient(find_compression(lambda z: rig.contact.approach(z, 0.0), rig.F_N))
        return cls(rig, v_p, jnp.stack([z_0, jnp.sqrt(z_0 * GRAVITY)]), mode)

    def scale_state(self, z, u):
        return jnp.stack(jnp.broadcast_arrays(z, u)) / self.scale

    def unscale_state(self, y):
        """(z [m], u [m/s])."""
        z, u = y * self.scale
        return z, u

    def __call__(self, y):
        """y' [1/s]: equation (2), each law continued beyond its domain."""
        z, u = self.unscale_state(y)
        w = self.v_p - u
        free, approach, rebound = self.rig.free, self.rig.approaching, self.rig.rebounding
        if self.mode == "free":
            return self.scale_state(w, extend_odd(free, u))
        pushed = approach if self.mode == "approach" else rebound
        return self.scale_state(
            w, extend_odd(lambda u: extend_odd(lambda z: pushed(z, w, u), z), u)
        )

    def force(self, y):
        """Contact force of an approach [N], and its rate [N/s]."""

        def N(y):
            z, u = self.unscale_state(y)
            return extend_odd(lambda z: self.rig.contact.approach(z, self.v_p - u), z)

        return jax.jvp(N, (y,), (self(y),))

    def before(self, event, y):
        """What falls to zero where an event is; scaled."""
        z, u = y
        if event == Event.TURN:
            w = self.v_p / self.scale[1] - u
            return w if self.mode == "approach" else -w
        if event == Event.FORCE_PEAK:
            return self.force(y)[1] * self.time / self.rig.F_N
        return {Event.HALT: u, Event.RELEASE: z, Event.CATCH: -z}[event]

    @property
    def time(self):
        """z_0 / u_0 [s]: about the time of one radian of the part on the tip."""
        return self.scale[0] / self.scale[1]

    def steady(self, y, tolerance):
        """Whether the part keeps the tip's speed, but for what is below the tolerance."""
        w, acceleration = self(y) * self.scale
        still = jnp.hypot(w, acceleration * self.time) < tolerance * self.scale[1]
        return still & (self.v_p > 0) & (self.mode != "free")

    def dip(self, y_0, y_1, h):
        """Where u may dip below zero between two positive ends of a step [s]; else h."""
        (_, u_0), (_, u_1) = y_0, y_1
        a_0, a_1 = self(y_0)[1], self(y_1)[1]
        turns = (a_0 < 0) & (a_1 > 0)
        bottom = jnp.where(turns, -a_0 / jnp.where(turns, a_1 - a_0, 1.0), 1.0) * h
        may = u_0 + 0.6 * a_0 * bottom <= 0  # 0.5 by the parabola: rather look once too often
        dips = turns & may & (u_1 > 0) & (bottom < 0.99 * h)
        return jnp.where(dips, bottom, h)


class _LegStep(NamedTuple):
    """A step: the time [s] and the state it starts from, its length [s]."""

    t: Array
    y: Array
    h: Array


class _LegProgress(NamedTuple):
    """How far a leg has been followed: its last step, where that led, how it goes on."""

    last: _LegStep
    t: Array
    y: Array
    h: Array
    controller: Any
    summit: _LegStep
    """the step across the highest interior maximum of the force"""
    height: Array
    """that maximum, roughly [N]"""
    steady: Array
    over: Array
    count: Array


class Diffrax(eqx.Module):
    """Equation (2) with any smooth laws, integrated.

    Forward-mode derivatives of every order pass through the steps, whose lengths are held, and
    through the event times; they are as good as the tolerances. `solver` is any explicit
    Runge-Kutta method of diffrax. `rtol` and `atol` are its tolerances, `atol` in units of
    the compression under the part's weight and of the speed that belongs to it. A leg without
    a stop that has seen no event for `horizon` [s] never will. A leg of more than `max_steps`
    is given up: F_p is infinite, or d is NaN where the force had been seen.
    """

    rtol: float = eqx.field(default=1e-10, static=True)
    atol: float = eqx.field(default=1e-13, static=True)
    solver: diffrax.AbstractERK = eqx.field(default=diffrax.Tsit5(), static=True)
    max_steps: int = eqx.field(default=20_000, static=True)
    horizon: float = eqx.field(default=5.0, static=True)

    def check(self, rig: Rig) -> None:
        """Raise `InputError` where this cannot integrate; there is no rig that it cannot."""
        if not isinstance(self.solver, diffrax.AbstractERK):
            raise InputError(
                "Diffrax(solver=...) needs an explicit Runge-Kutta method such as "
                f"diffrax.Tsit5(), not {type(self.solver).__name__}"
            )

    def find_breakaway(self, rig: Rig, v_p: Number) -> Float[Array, ""]:
        """Compression [m] at which a part at rest starts to slide; 0: at once."""
        F_S = rig.friction.breakaway(rig.F_N)
        dynamic, static = eqx.partition((rig.contact, v_p, F_S), _is_number)

        def lack(z, dynamic):
            contact, v_p, F_S = eqx.combine(dynamic, static)
            N, slope = jax.jvp(lambda z: contact.approach(z, v_p), (z,), (jnp.ones_like(z),))
            return F_S - N, -slope

        sticks = rig.contact.approach(0.0, v_p) < F_S
        enough = find_compression(lambda z: rig.contact.approach(z, v_p), F_S)
        far = stop_gradient(jnp.where(sticks, enough, 0.0))
        z = find_falling_root(lack, dynamic, 0.0, far, 0.5 * far)
        return jnp.where(sticks, jnp.where(far < LARGEST_COMPRESSION, z, jnp.inf), 0.0)

    def follow_closing(
        self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number, may_halt: bool
    ) -> Leg:
        """The tip closes in on the part, until w = 0, the part halts or the pusher stops."""
        motion = _ScaledMotion.of(rig, "approach", v_p)
        y = motion.scale_state(z, u)
        progress = self._follow_leg(
            motion, y, left, (Event.TURN, Event.HALT) if may_halt else (Event.TURN,)
        )
        turn = self._find_time(motion, Event.TURN, progress)
        halt = self._find_time(motion, Event.HALT, progress) if may_halt else jnp.inf
        dt, event = first_event((left, Event.STOP), (turn, Event.TURN), (halt, Event.HALT))
        y_1 = self._state(motion, progress, dt)
        z_1, u_1 = motion.unscale_state(y_1)
        u_1 = jnp.where(event == Event.TURN, v_p, jnp.where(event == Event.HALT, 0.0, u_1))
        top, rises = progress.summit, jnp.isfinite(progress.height)
        h = self._root(motion, Event.FORCE_PEAK, top, rises, top.h)
        y_top = self._flow(motion, top.y, jnp.where(rises, h, 0.0))
        N_0, N_1, N_top = (motion.force(y)[0] for y in (y, y_1, y_top))
        peak = jnp.where(N_1 > N_0, N_1, N_0)
        peak = jnp.where((top.t + h <= dt) & (N_top > peak), N_top, peak)
        return self._check_leg(progress, Leg(dt, event, z_1, u_1, 0.0, peak))

    def follow_rebounding(self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number) -> Leg:
        """The part recedes from the tip, until release, w = 0 or the pusher's stop."""
        motion = _ScaledMotion.of(rig, "rebound", v_p)
        progress = self._follow_leg(
            motion, motion.scale_state(z, u), left, (Event.RELEASE, Event.TURN)
        )
        turn = self._find_time(motion, Event.TURN, progress)
        turns = jnp.isfinite(turn)
        # z is least where the part turns: whether it leaves the tip is decided there.
        least = jnp.where(turns, self._state(motion, progress, turn), progress.y)
        leaves = (motion.before(Event.RELEASE, least) <= 0) & ~progress.steady
        upto = jnp.where(turns, turn - progress.last.t, progress.last.h)
        release = progress.last.t + self._root(motion, Event.RELEASE, progress.last, leaves, upto)
        turn = jnp.where(leaves, jnp.inf, turn)
        dt, event = first_event((left, Event.STOP), (release, Event.RELEASE), (turn, Event.TURN))
        z_1, u_1 = motion.unscale_state(self._state(motion, progress, dt))
        z_1 = jnp.where(event == Event.RELEASE, 0.0, z_1)
        u_1 = jnp.where(event == Event.TURN, v_p, u_1)
        return self._check_leg(progress, Leg(dt, event, z_1, u_1, 0.0, 0.0))

    def follow_free(
        self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number, may_catch: bool
    ) -> Leg:
        """The part slides without contact, until rest, the pusher's stop or the next contact.

        Where none of these comes within the horizon, the distance is NaN.
        """
        if not may_catch:
            v_p, left = 0.0 * v_p, jnp.asarray(jnp.inf)
        motion = _ScaledMotion.of(rig, "free", v_p)
        guards = (Event.HALT, Event.CATCH) if may_catch else (Event.HALT,)
        progress = self._follow_leg(motion, motion.scale_state(z, u), left, guards)
        rest = self._find_time(motion, Event.HALT, progress)
        catch = self._find_time(motion, Event.CATCH, progress) if may_catch else jnp.inf
        dt, event = first_event((left, Event.STOP), (catch, Event.CATCH), (rest, Event.HALT))
        z_1, u_1 = motion.unscale_state(self._state(motion, progress, dt))
        slid = jnp.where(event == Event.NONE, jnp.nan, v_p * dt + z - z_1)
        z_1 = jnp.where(event == Event.CATCH, 0.0, z_1)
        u_1 = jnp.where(event == Event.HALT, 0.0, u_1)
        return self._check_leg(progress, Leg(dt, event, z_1, u_1, slid, 0.0))

    def evaluate_pushed(
        self, rig: Rig, closing: Truth, z: Number, u: Number, v_p: Number, t: Number
    ) -> tuple[Array, Array]:
        """(z, u) at the time t into a pushed leg."""
        closing = jnp.asarray(closing)

        def at(mode, t):
            motion = _ScaledMotion.of(rig, mode, v_p)
            progress = self._follow_leg(motion, motion.scale_state(z, u), t, ())
            return motion.unscale_state(self._state(motion, progress, t))

        here, there = (
            at("approach", jnp.where(closing, t, 0.0)),
            at("rebound", jnp.where(closing, 0.0, t)),
        )
        return jax.tree.map(lambda a, b: jnp.where(closing, a, b), here, there)

    def evaluate_free(self, rig: Rig, u: Number, t: Number) -> tuple[Array, Array]:
        """(distance, u) at the time t into a free leg."""
        motion = _ScaledMotion.of(rig, "free", 0.0)
        progress = self._follow_leg(motion, motion.scale_state(0.0, u), t, ())
        z_1, u_1 = motion.unscale_state(self._state(motion, progress, t))
        return -z_1, u_1

    def _follow_leg(self, motion, y, left, guards) -> _LegProgress:
        """Step until a guard has passed, for the time `left` [s] or, if endless, the horizon."""
        until = stop_gradient(jnp.where(jnp.isfinite(left), left, self.horizon))
        controller = diffrax.PIDController(self.rtol, self.atol)
        order = self.solver.error_order(_terms(motion))
        assert order is not None
        may_dip = motion.mode == "approach" and Event.HALT in guards
        may_peak = motion.mode == "approach" and bool(guards)

        def is_steady(y):
            return bool(guards) & motion.steady(y, 10 * self.rtol)

        def step(m: _LegProgress):
            h = jnp.minimum(m.h, until - m.t)
            y, error = self._step(motion, m.y, h)
            y_0, y_1, error = stop_gradient((m.y, y, error))
            keep, start, end, _, state, _ = controller.adapt_step_size(
                0.0, h, y_0, y_1, None, error, order, m.controller
            )
            next_h = end - start
            if may_dip:  # then again, up to the bottom
                bottom = motion.dip(y_0, y_1, h)
                next_h = jnp.where(keep & (bottom < h), bottom, next_h)
                keep = keep & (bottom == h)
            lost = ~jnp.isfinite(next_h)
            m = m._replace(h=next_h, controller=state, over=lost, count=m.count + 1)
            t = jnp.where(h >= until - m.t, until, m.t + h)
            new = m._replace(last=_LegStep(m.t, m.y, h), t=t, y=y, steady=is_steady(y_1))
            if may_peak:
                (N_0, dN_0), (N_1, dN_1) = motion.force(y_0), motion.force(y_1)
                height = jnp.maximum(N_0, N_1)
                higher = (dN_0 > 0) & (dN_1 <= 0) & (height > m.height)
                new = select(higher, new._replace(summit=new.last, height=height), new)
            passed = [motion.before(event, y_1) <= 0 for event in guards]
            over = lost | new.steady | (t >= until) | jnp.any(jnp.array(passed, bool))
            return select(keep, new._replace(over=over), m)

        # A leg that starts beyond a guard ends at once; on it, as after an event, it does not.
        wrong = jnp.any(jnp.array([motion.before(event, y) < -1e-12 for event in guards], bool))
        steady = is_steady(y)
        over = steady | wrong | (until <= 0)
        h, zero = 0.02 * motion.time, jnp.zeros(())
        state = controller.init(_terms(motion), 0.0, h, y, h, None, self.solver.func, order)[1]
        state = jax.tree.map(jnp.asarray, state)
        here = _LegStep(zero, y, zero)
        start = _LegProgress(
            here, zero, y, h, state, here, zero - jnp.inf, steady, over, jnp.asarray(0)
        )
        return jax.lax.while_loop(lambda m: ~m.over & (m.count < self.max_steps), step, start)

    def _step(self, motion, y, h):
        """One step of the length h [s]: the state after it, and its error. Written out: fast."""
        tableau = self.solver.tableau
        assert isinstance(tableau, diffrax.ButcherTableau)

        def weigh(weights):
            return h * sum(float(a) * rate for a, rate in zip(weights, rates, strict=False) if a)

        rates = [motion(y)]
        for row in tableau.a_lower:
            rates.append(motion(y + weigh(row)))
        return y + weigh(tableau.b_sol), weigh(tableau.b_error)

    def _flow(self, motion, y, h):
        """The state after the same step, by diffrax's loop over the stages: compiles sooner."""
        terms = _terms(motion)
        solver = dataclasses.replace(self.solver, scan_kind="lax")
        state = solver.init(terms, 0.0, h, y, None)
        return solver.step(terms, 0.0, h, y, None, state, False)[0]

    def _root(self, motion, event, step, passed, upto):
        """How far into a step [s] an event is; infinite where it has not passed."""
        dynamic, static = eqx.partition((motion, step.y), _is_number)

        def value_and_slope(h, dynamic):
            motion, y = eqx.combine(dynamic, static)
            value, slope = jax.jvp(
                lambda h: motion.before(event, self._flow(motion, y, h)), (h,), (jnp.ones_like(h),)
            )
            # Below rounding it is zero, or a shallow root would be searched for ever.
            noise = jnp.where(jnp.abs(value) < 1e-15, stop_gradient(value), 0.0)
            return value - noise, slope

        upto = stop_gradient(jnp.where(passed, upto, 0.0))
        # What is zero at the step's start must not be found there: begin at the far side.
        h = find_falling_root(value_and_slope, dynamic, 0.0, upto, 0.7 * upto)
        return jnp.where(passed, h, jnp.inf)

    def _find_time(self, motion, event, progress):
        """When an event came in a leg's last step [s]; infinite if it did not."""
        passed = (motion.before(event, progress.y) <= 0) & ~progress.steady
        return progress.last.t + self._root(motion, event, progress.last, passed, progress.last.h)

    def _state(self, motion, progress, t):
        """The state at the time t [s] within the last step; the last one known beyond."""
        beyond = progress.steady | ~jnp.isfinite(t)
        h = jnp.where(beyond, 0.0, t - progress.last.t)
        return jnp.where(beyond, progress.y, self._flow(motion, progress.last.y, h))

    def _check_leg(self, progress, leg):
        """The leg; where it could not be followed to its end, NaN and an infinite peak."""
        lost = Leg(jnp.nan, Event.NONE, jnp.nan, jnp.nan, slid=jnp.nan, peak=jnp.inf)
        return select(~progress.over | ~jnp.isfinite(progress.h), lost, leg)


def _terms(motion):
    return diffrax.ODETerm(lambda t, y, args: motion(y))


def _is_number(leaf):
    return eqx.is_inexact_array(leaf) or isinstance(leaf, float)
