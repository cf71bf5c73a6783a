"""The integrator for any smooth laws: legs of a push in diffrax's Runge-Kutta steps.

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
from jax import Array
from jax.lax import stop_gradient

from difffric.contact import AbstractContact
from difffric.errors import InputError
from difffric.friction import AbstractFriction
from difffric.legs import CATCH, HALT, RELEASE, STOP, TURN, Leg, first_event
from difffric.rig import Rig
from difffric.roots import falling_root
from difffric.units import GRAVITY

_TINY = 1e-30  # [m], [m/s]: keeps a power law's second derivative finite at zero
_SMALLEST, _LARGEST = 1e-9, 1e3  # [m]: the compressions between which a force is looked for


def _odd(law, x):
    """`law(x)`, continued to x < 0 by reflection through its value at zero.

    A step may look beyond the domain before its event is found there. Continued so, an affine
    law stays affine, any law stays smooth once, and a power law gives no NaN.
    """
    force = law(jnp.where(x < 0, -x, x) + _TINY)
    return jnp.where(x < 0, 2 * law(_TINY) - force, force)


class _Contact(AbstractContact):
    """A contact law, continued to z < 0."""

    law: AbstractContact

    def approach(self, z, w):
        return _odd(lambda z: self.law.approach(z, w), z)

    def rebound(self, z, w):
        return _odd(lambda z: self.law.rebound(z, w), z)


class _Friction(AbstractFriction):
    """A friction law, continued to u < 0."""

    law: AbstractFriction

    def sliding(self, u, F_N):
        return _odd(lambda u: self.law.sliding(u, F_N), u)

    def breakaway(self, F_N):
        return self.law.breakaway(F_N)


class _Motion(eqx.Module):
    """The right-hand side of one mode, in scaled states y = (z / z_0, u / u_0).

    z_0 [m] is about the compression under the part's own weight, u_0 = sqrt(z_0 g) [m/s].
    """

    rig: Rig
    v_p: Array
    scale: Array
    mode: str = eqx.field(static=True)

    @classmethod
    def of(cls, rig, mode, v_p=0.0):
        """The motion of a rig in a mode: "approach", "rebound" or "free"."""
        laws = _Friction(rig.friction), _Contact(rig.contact)
        rig = eqx.tree_at(lambda r: (r.friction, r.contact), rig, laws)
        z_0 = stop_gradient(_reach(rig.contact, 0.0, rig.F_N))
        return cls(rig, v_p, jnp.stack([z_0, jnp.sqrt(z_0 * GRAVITY)]), mode)

    @property
    def time(self):
        """z_0 / u_0 [s]: about the time of one radian of the part on the tip."""
        return self.scale[0] / self.scale[1]

    def scaled(self, z, u):
        return jnp.stack(jnp.broadcast_arrays(z, u)) / self.scale

    def state(self, y):
        """(z [m], u [m/s])."""
        z, u = y * self.scale
        return z, u

    def __call__(self, y):
        z, u = self.state(y)
        w = self.v_p - u
        if self.mode == "free":
            acceleration = self.rig.free(u)
        elif self.mode == "approach":
            acceleration = self.rig.approaching(z, w, u)
        else:
            acceleration = self.rig.rebounding(z, w, u)
        return self.scaled(w, acceleration)

    def force(self, y):
        """Contact force of an approach [N], and its rate [N/s]."""

        def N(y):
            z, u = self.state(y)
            return self.rig.contact.approach(z, self.v_p - u)

        return jax.jvp(N, (y,), (self(y),))

    def steady(self, y, tolerance):
        """Whether the part keeps the tip's speed, but for what is below the tolerance."""
        w, acceleration = self(y) * self.scale
        change = acceleration * self.time
        still = jnp.hypot(w, change) < tolerance * self.scale[1]
        return still & (self.v_p > 0) & (self.mode != "free")


# What falls to zero where an event is, in scaled units.
def _until_turn(motion, y):
    return motion.v_p / motion.scale[1] - y[1]


def _until_turn_back(motion, y):
    return y[1] - motion.v_p / motion.scale[1]


def _until_halt(motion, y):
    return y[1]


def _until_release(motion, y):
    return y[0]


def _until_catch(motion, y):
    return -y[0]


def _until_summit(motion, y):
    return motion.force(y)[1] * motion.time / motion.rig.F_N


class _Step(NamedTuple):
    """A step: the time [s] and the state it starts from, its length [s]."""

    t: Array
    y: Array
    h: Array


class _March(NamedTuple):
    """How far a leg has been followed: its latest step, what came out, what comes next."""

    last: _Step
    t: Array
    y: Array
    h: Array
    controller: Any
    summit: _Step
    """the step across the highest interior maximum of the force"""
    height: Array
    """that maximum, roughly [N]"""
    steady: Array
    over: Array
    count: Array

    @property
    def failed(self):
        """Too many steps, or a state that is not a number."""
        return ~self.over | ~jnp.isfinite(self.h)


class Diffrax(eqx.Module):
    """Equation (2) with any smooth laws, integrated.

    Forward-mode derivatives of every order pass through the steps, whose lengths are held, and
    through the event times; they are as good as the tolerances. `solver` is any explicit
    Runge-Kutta method of diffrax. `rtol` and `atol` are its tolerances, `atol` in units of
    the compression under the part's weight and of the speed that belongs to it. A leg without
    a stop that has seen no event for `horizon` [s] never will. A leg of more than `max_steps`
    is given up: NaN.
    """

    rtol: float = eqx.field(default=1e-10, static=True)
    atol: float = eqx.field(default=1e-13, static=True)
    solver: diffrax.AbstractERK = eqx.field(default=diffrax.Tsit5(), static=True)
    max_steps: int = eqx.field(default=20_000, static=True)
    horizon: float = eqx.field(default=5.0, static=True)

    def check(self, rig: Rig):
        """Raise `InputError` where this cannot integrate; there is no rig that it cannot."""
        if not isinstance(self.solver, diffrax.AbstractERK):
            name = type(self.solver).__name__
            raise InputError(f"Diffrax(solver=...) wants an explicit Runge-Kutta method, not {name}")

    def breakaway(self, rig, v_p):
        """Compression [m] at which a part at rest starts to slide; 0: at once."""
        law, F_S = _Contact(rig.contact), rig.friction.breakaway(rig.F_N)
        dynamic, static = eqx.partition((law, v_p, F_S), _is_number)

        def lack(z, dynamic):
            law, v_p, F_S = eqx.combine(dynamic, static)
            N, slope = jax.jvp(lambda z: law.approach(z, v_p), (z,), (jnp.ones_like(z),))
            return F_S - N, -slope

        sticks = law.approach(0.0, v_p) < F_S
        far = jnp.where(sticks, _reach(law, v_p, F_S), 0.0)
        z = falling_root(lack, dynamic, 0.0, stop_gradient(far), 0.5 * stop_gradient(far))
        return jnp.where(sticks, jnp.where(far < _LARGEST, z, jnp.inf), 0.0)

    def closing(self, rig, z, u, v_p, left, may_halt):
        """The tip closes in on the part, until w = 0, the part halts or the pusher stops."""
        motion = _Motion.of(rig, "approach", v_p)
        guards = (_until_turn, _until_halt) if may_halt else (_until_turn,)
        y = motion.scaled(z, u)
        march = self._march(motion, y, left, guards)
        turn = self._passed(motion, _until_turn, march)
        halt = self._passed(motion, _until_halt, march) if may_halt else jnp.inf
        dt, event = first_event((left, STOP), (turn, TURN), (halt, HALT))
        y_1 = self._end(motion, march, dt)
        z_1, u_1 = motion.state(y_1)
        u_1 = jnp.where(event == TURN, v_p, jnp.where(event == HALT, 0.0, u_1))
        peak, N_1 = motion.force(y)[0], motion.force(y_1)[0]
        peak = jnp.where(N_1 > peak, N_1, peak)
        seen = jnp.isfinite(march.height)
        h = self._root(motion, _until_summit, march.summit, seen, march.summit.h)
        N = motion.force(self._flow(motion, march.summit.y, jnp.where(seen, h, 0.0)))[0]
        inside = seen & (march.summit.t + h <= dt)
        peak = jnp.where(inside & (N > peak), N, peak)
        return _checked(march, Leg(dt, event, z_1, u_1, 0.0, peak))

    def rebounding(self, rig, z, u, v_p, left):
        """The part recedes from the tip, until release, w = 0 or the pusher's stop."""
        motion = _Motion.of(rig, "rebound", v_p)
        guards = (_until_release, _until_turn_back)
        march = self._march(motion, motion.scaled(z, u), left, guards)
        turn = self._passed(motion, _until_turn_back, march)
        turns = jnp.isfinite(turn)
        # z is least where the part turns back: whether it is released is decided there.
        least = jnp.where(turns, self._end(motion, march, turn), march.y)
        leaves = (_until_release(motion, least) <= 0) & ~march.steady
        upto = jnp.where(turns, stop_gradient(turn) - march.last.t, march.last.h)
        h = self._root(motion, _until_release, march.last, leaves, upto)
        dt, event = first_event(
            (left, STOP), (march.last.t + h, RELEASE), (jnp.where(leaves, jnp.inf, turn), TURN)
        )
        z_1, u_1 = motion.state(self._end(motion, march, dt))
        z_1 = jnp.where(event == RELEASE, 0.0, z_1)
        u_1 = jnp.where(event == TURN, v_p, u_1)
        return _checked(march, Leg(dt, event, z_1, u_1, 0.0, 0.0))

    def free(self, rig, z, u, v_p, left, may_catch):
        """The part slides without contact, until rest, the pusher's stop or the next contact.

        Where it never rests within the horizon, the distance is NaN.
        """
        v_p, left = (v_p, left) if may_catch else (jnp.zeros_like(v_p), jnp.full_like(left, jnp.inf))
        motion = _Motion.of(rig, "free", v_p)
        guards = (_until_halt, _until_catch) if may_catch else (_until_halt,)
        march = self._march(motion, motion.scaled(z, u), left, guards)
        rest = self._passed(motion, _until_halt, march)
        catch = self._passed(motion, _until_catch, march) if may_catch else jnp.inf
        dt, event = first_event((left, STOP), (catch, CATCH), (rest, HALT))
        z_1, u_1 = motion.state(self._end(motion, march, dt))
        slid = jnp.where(jnp.isfinite(dt), v_p * dt + z - z_1, jnp.nan)
        z_1 = jnp.where(event == CATCH, 0.0, z_1)
        return _checked(march, Leg(dt, event, z_1, jnp.where(event == HALT, 0.0, u_1), slid, 0.0))

    def pushed_state(self, rig, closing: bool, z, u, v_p, t):
        """(z, u) at the time t into a pushed leg."""
        motion = _Motion.of(rig, "approach" if closing else "rebound", v_p)
        march = self._march(motion, motion.scaled(z, u), t, ())
        return motion.state(self._end(motion, march, t))

    def free_state(self, rig, u, t):
        """(distance, u) at the time t into a free leg."""
        motion = _Motion.of(rig, "free")
        march = self._march(motion, motion.scaled(0.0, u), t, ())
        z_1, u_1 = motion.state(self._end(motion, march, t))
        return -z_1, u_1

    def _march(self, motion, y, left, guards) -> _March:
        """Step until a guard has passed, for the time `left` [s] or, if endless, the horizon."""
        controller = diffrax.PIDController(self.rtol, self.atol)
        order = self.solver.error_order(None)
        until = stop_gradient(jnp.where(jnp.isfinite(left), left, self.horizon))
        h_0 = 0.02 * motion.time
        unsteady = 10 * self.rtol

        def step(m: _March):
            h = jnp.minimum(m.h, until - m.t)
            y, error = self._step(motion, m.y, h)
            before, after, error = stop_gradient((m.y, y, error))
            keep, start, end, _, control, _ = controller.adapt_step_size(
                0.0, h, before, after, None, error, order, m.controller
            )
            after_h = end - start
            if _until_halt in guards and motion.mode == "approach":
                dip = _dip(motion, before, after, h)
                after_h = jnp.where(keep & (dip < h), dip, after_h)
                keep = keep & ~(dip < h)
            m = m._replace(h=after_h, controller=control, count=m.count + 1)
            m = m._replace(over=~jnp.isfinite(after_h))
            t = jnp.where(h >= until - m.t, until, m.t + h)
            new = m._replace(last=_Step(m.t, m.y, h), t=t, y=y)
            if guards and motion.mode == "approach":
                (N_0, dN_0), (N_1, dN_1) = motion.force(before), motion.force(after)
                higher = (dN_0 > 0) & (dN_1 <= 0) & (jnp.maximum(N_0, N_1) > m.height)
                new = _select(
                    higher, new._replace(summit=new.last, height=jnp.maximum(N_0, N_1)), new
                )
            passed = [guard(motion, after) <= 0 for guard in guards]
            new = new._replace(steady=bool(guards) & motion.steady(after, unsteady))
            new = new._replace(over=m.over | new.steady | (t >= until) | _any(passed))
            return _select(keep, new, m)

        steady = bool(guards) & motion.steady(y, unsteady)
        wrong = [guard(motion, y) < -1e-12 for guard in guards]
        zero = jnp.zeros(())
        here = _Step(zero, y, zero)
        _, control = controller.init(None, 0.0, until, y, h_0, None, None, order)
        start = _March(
            last=here,
            t=zero,
            y=y,
            h=h_0,
            controller=control,
            summit=here,
            height=-jnp.inf,
            steady=steady,
            over=steady | (until <= 0) | _any(wrong),
            count=jnp.asarray(0),
        )
        start = jax.tree.map(jnp.asarray, start)
        return jax.lax.while_loop(lambda m: ~m.over & (m.count < self.max_steps), step, start)

    def _step(self, motion, y, h):
        """One step of the length h [s]: the state after it, and its error. Written out: fast."""
        tableau = self.solver.tableau

        def weighted(weights):
            return h * sum(float(a) * rate for a, rate in zip(weights, rates, strict=False) if a)

        rates = [motion(y)]
        for row in tableau.a_lower:
            rates.append(motion(y + weighted(row)))
        return y + weighted(tableau.b_sol), weighted(tableau.b_error)

    def _flow(self, motion, y, h):
        """The state after the same step, by diffrax's loop over the stages: compiles sooner."""
        terms = diffrax.ODETerm(lambda t, y, args: motion(y))
        solver = dataclasses.replace(self.solver, scan_kind="lax")
        state = solver.init(terms, 0.0, h, y, None)
        return solver.step(terms, 0.0, h, y, None, state, False)[0]

    def _root(self, motion, guard, step, passed, upto):
        """How far into a step [s] a guard falls to zero; infinite unless it has passed."""
        dynamic, static = eqx.partition((motion, step.y), _is_number)

        def value_and_slope(h, dynamic):
            motion, y = eqx.combine(dynamic, static)
            value, slope = jax.jvp(
                lambda h: guard(motion, self._flow(motion, y, h)), (h,), (jnp.ones_like(h),)
            )
            # Below rounding it is zero, or a shallow root would be searched for ever.
            noise = jnp.where(jnp.abs(value) < 1e-15, stop_gradient(value), 0.0)
            return value - noise, slope

        upto = stop_gradient(jnp.where(passed, upto, 0.0))
        # A guard that starts at zero must not be found there: begin at the far side.
        h = falling_root(value_and_slope, dynamic, 0.0, upto, 0.7 * upto)
        return jnp.where(passed, h, jnp.inf)

    def _passed(self, motion, guard, march):
        """When a leg's guard falls to zero in its last step [s]; infinite if it does not."""
        passed = (guard(motion, march.y) <= 0) & ~march.steady
        return march.last.t + self._root(motion, guard, march.last, passed, march.last.h)

    def _end(self, motion, march, dt):
        """The state at the time dt [s], within the last step; the last known one beyond."""
        beyond = march.steady | ~jnp.isfinite(dt)
        h = jnp.where(beyond, 0.0, dt - march.last.t)
        return jnp.where(beyond, march.y, self._flow(motion, march.last.y, h))


def _dip(motion, y_0, y_1, h):
    """Where in a step u may dip below zero between two positive ends [s]; else h."""
    u_0, u_1 = motion.state(y_0)[1], motion.state(y_1)[1]
    a_0, a_1 = motion(y_0)[1] * motion.scale[1], motion(y_1)[1] * motion.scale[1]
    turns = (a_0 < 0) & (a_1 > 0)
    bottom = jnp.where(turns, -a_0 / jnp.where(turns, a_1 - a_0, 1.0), 1.0) * h
    dips = turns & (u_0 + 0.5 * a_0 * bottom <= 0) & (u_1 > 0) & (bottom < 0.9 * h)
    return jnp.where(dips, bottom, h)


def _reach(contact, v_p, force):
    """A compression [m] that carries a force [N], and at most four times the least that does."""

    def short(z):
        return (contact.approach(z, v_p) < force) & (z < _LARGEST)

    return jax.lax.while_loop(short, lambda z: 4 * z, jnp.asarray(_SMALLEST))


def _is_number(leaf):
    return eqx.is_inexact_array(leaf) or isinstance(leaf, float)


def _any(flags):
    return jnp.any(jnp.asarray(flags)) if flags else jnp.asarray(False)


def _select(condition, new, old):
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)


def _checked(march, leg):
    """The leg, or NaN and no event where it could not be followed."""
    lost = leg._replace(
        **{name: jnp.nan for name in ("dt", "z", "u", "slid", "peak")}, event=jnp.asarray(0)
    )
    return _select(march.failed, lost, leg)
