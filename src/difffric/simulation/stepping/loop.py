"""The integrator for any laws: a push followed step by step, in one loop for all its modes.

Each turn of the loop is one Runge-Kutta step in the mode that holds. Where a guard falls through
zero within the step, the step is cut there, and taken again until it ends on the event; a Taylor
step then closes what is left of it, which also carries the event time's derivatives, exactly to
second order. Two events within one step come in the order of their times, and a step that ends
on one looks for the others too.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.lax import stop_gradient

from difffric.compute import hermite
from difffric.compute.pytrees import select
from difffric.compute.xla_options import in_one_piece
from difffric.simulation.dynamics import (
    BOTTOM,
    BREAK,
    CLOSING,
    CORNER,
    FREE,
    GRIP,
    HALT,
    REBOUNDING,
    STUCK,
    SUMMIT,
    TURN,
    Course,
    Motion,
    Point,
)
from difffric.simulation.stepping.dense_output import Stride
from difffric.simulation.stepping.dop853 import looped_step, rk_step
from difffric.simulation.stepping.sensor_readout import nothing, sense
from difffric.simulation.stepping.state import March
from difffric.simulation.stepping.transitions import NO_EVENT, STEADY, Rules

MAX_STEPS = 20_000
_FINEST = 1e-5  # of the push's own time
_CLOSE = 1e-4  # of a free step: an event this near to the end is reached by the Taylor step
_SHARES = (0.25, 0.5, 0.75)  # of a step: where its inside is looked at for a dip


class Marcher(NamedTuple):
    """A push to be followed: the motion and its scales."""

    motion: Motion
    z_0: Array
    """about the compression under the part's own weight [m]"""
    tol: float = 1e-10
    looped: bool = False
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
    def u_0(self):
        return self.rules.u_0

    @property
    def time(self):
        return self.rules.time

    def start(self) -> March:
        """At rest, the pusher starting."""
        rig, v = self.motion
        zero, no = jnp.zeros(()), jnp.asarray(False)
        gap = jnp.asarray(rig.contact.gap, float)
        bristles = self.motion.bristles
        risen = jnp.asarray(rig.pusher.ramp_time(v) <= 0)
        course = Course(
            mode=jnp.asarray(STUCK), touching=gap <= 0, moved=no, stopped=no, t_stop=zero,
            V_stop=zero, beyond=no, risen=risen, way=jnp.ones(()),
        )  # fmt: skip
        # At rest on its bristles, which hold it against the slope.
        q = None if bristles is None else -rig.slope / bristles.stiffness + zero
        s = Point(zero, -gap, zero, zero, q)
        at_once = self.rules.breaks(course, s)
        course = course._replace(mode=jnp.where(at_once, CLOSING, STUCK), moved=at_once)
        none, nowhere = jnp.asarray(0), jnp.asarray(NO_EVENT)
        m = March(
            s=s, course=course, h=0.3 * stop_gradient(self.time) + zero, target=nowhere,
            h_target=zero, contacts=jnp.where(gap <= 0, 1, 0), sticks=(~at_once).astype(int),
            lost=no, lost_moving=no, x_lost=zero, peak=zero, peak_contact=jnp.asarray(1),
            summited=no, slowed=no, rebounds=none, halts=none, endless=no, over=no, steps=none,
            strides=none, lost_track=no, stuck_first=~at_once,
            sensed=nothing(self.motion) if self.senses else None,
        )  # fmt: skip
        return m._replace(over=self.rules.rests(m))

    def step(self, m: March, record: bool = False) -> tuple[March, Stride | None]:
        """One turn of the loop; also the step as a stride where one is asked for or needed."""
        motion, c, s = self.motion, m.course, m.s
        pusher = motion.rig.pusher
        stuck = c.mode == STUCK

        def field(p):
            return motion.rates(c, p)

        def along(p, r):
            """Guards and N at p, and their rates where p's own are r."""
            return jax.jvp(lambda q: motion.guards(c, q), (p,), (r,))

        rate = field(s)
        (g_0, N_0), (d_0, n_0) = along(s, rate)

        # How far: to the event aimed at; at rest straight to the breakaway, as the force grows now.
        aims = m.target >= 0
        ahead = jnp.where(d_0[BREAK] < 0, g_0[BREAK] / -d_0[BREAK], jnp.inf)
        wait = jnp.where(c.touching & (ahead < 1e3 * self.time), ahead, 1e3 * self.time)
        at_once = stuck if pusher.constant else jnp.asarray(False)
        wait = jnp.where(at_once, wait, jnp.where(stuck, jnp.minimum(wait, m.h), m.h))
        # Where a law is not smooth at first touch, its derivatives are less so than its values:
        # steps there shrink with the compression.
        w = rate.z
        touched = (c.mode == CLOSING) | (c.mode == REBOUNDING)
        graded = jnp.where(w > 0, 1.5, 0.6) * s.z / jnp.maximum(jnp.abs(w), 1e-12 * self.u_0)
        graded = jnp.where(
            touched & motion.rig.contact.rough, jnp.maximum(graded, _FINEST * self.time), jnp.inf
        )
        h = jnp.where(aims, m.h_target, jnp.minimum(wait, graded))
        aim = jnp.where(aims, m.target, jnp.where(stuck & c.touching, BREAK, NO_EVENT))
        if not pusher.constant:
            corner = pusher.ramp_time(motion.v) - s.t
            meets = ~c.risen & (corner <= h)
            h = jnp.where(meets, corner, h)
            aim = jnp.where(meets, CORNER, aim)
        h = stop_gradient(h)

        y, errors = (looped_step if self.looped else rk_step)(field, s, rate, h)
        # What goes wrong in contact is amplified by what follows, in a free slide it is not.
        tol = self.tol * jnp.where(c.mode == FREE, 30.0, 1.0)
        err = zero = jnp.zeros_like(h)
        for error, scale in zip(errors, (self.z_0, self.u_0, self.z_0, self.z_0), strict=False):
            err = jnp.maximum(err, error / (scale * tol))
        err = stop_gradient(jnp.where(jnp.isfinite(err), err, 1e9))
        good = err <= 1

        f_1 = field(y)
        df_1 = jax.jvp(field, (y,), (f_1,))[1]
        ((g_1, N_1), (d_1, n_1)), ((_, _), (c_1, nn_1)) = jax.jvp(along, (y, f_1), (f_1, df_1))
        if not pusher.constant:
            waits = ~c.risen
            g_0[CORNER] = jnp.where(waits, corner, 1.0)
            g_1[CORNER] = jnp.where(waits, corner - (y.t - s.t), 1.0)
            d_0[CORNER] = d_1[CORNER] = jnp.where(waits, -1.0, 0.0)
            c_1[CORNER] = zero
        # The force is highest where its rate falls through zero, the part slowest where x'' rises.
        closing = c.mode == CLOSING
        rises = closing & ~m.summited & (n_0 > 0)
        slow = closing & ~m.slowed & (rate.u < 0) & (jnp.minimum(s.u, y.u) < 0.05 * motion.v)
        slopes = {
            SUMMIT: (rises, (N_0, n_0, N_1, n_1, nn_1)),
            BOTTOM: (slow, (-s.u, -rate.u, -y.u, -f_1.u, -df_1.u)),
        }
        for event, (on, (_, p_0, _, p_1, q_1)) in slopes.items():
            g_0[event], g_1[event] = jnp.where(on, p_0, 1.0), jnp.where(on, p_1, 1.0)
            d_1[event], c_1[event] = jnp.where(on, q_1, 0.0), 0.0

        # Steady sliding before the tip has no events but the stop.
        quiet = jnp.abs(g_0[TURN]) + jnp.abs(d_0[TURN]) * self.time < STEADY * self.u_0
        steady = ((c.mode == CLOSING) | (c.mode == REBOUNDING)) & quiet & ~c.stopped
        deaf = {TURN, HALT, GRIP, SUMMIT, BOTTOM}

        # The first guard that falls through zero within the step; `near` (a share of it) is so
        # near an end that the Taylor step does the rest.
        near = _CLOSE * jnp.maximum(m.h, h) / h
        first, event = jnp.full_like(h, 2.0), jnp.full_like(m.target, NO_EVENT)
        miss_aim = jnp.full_like(h, jnp.inf)
        jet = zero, zero + 1.0, zero
        curve = (zero + 1.0, zero, zero, zero, zero)
        for code in g_1:
            jet_1 = g_1[code], d_1[code], c_1[code]
            e, f = stop_gradient((g_1[code], d_1[code] * h))
            if code in slopes:  # of a quantity that is known better than its rate
                on, (v_0, p_0, v_1, p_1, q_1) = slopes[code]
                q = hermite.hermite(*stop_gradient((v_0, p_0 * h, v_1, p_1 * h, q_1 * h * h)))
                rate_of = (q[1], 2 * q[2], 3 * q[3], 4 * q[4], zero)
                p = tuple(
                    jnp.where(on, r, i) for r, i in zip(rate_of, (1.0, 0, 0, 0, 0), strict=True)
                )
            else:
                begin = g_0[code], d_0[code] * h, g_1[code], d_1[code] * h, c_1[code] * h * h
                p = hermite.hermite(*stop_gradient(begin))
            where = jnp.where(e <= 0, 1.0, 2.0)
            for share in _SHARES[::-1]:
                where = jnp.where(hermite.value(p, share) <= 0, share, where)
            where = jnp.where(where > 0.3, where - 0.25 * hermite.before(p, where), where)
            if code in deaf:
                where = jnp.where(steady, 2.0, where)
            # An aim is reached from either side.
            aimed = (aim == code) & (f < 0)
            miss = jnp.where(aimed, jnp.abs(e / jnp.where(f == 0, 1.0, f)), jnp.inf)
            miss_aim = jnp.minimum(miss_aim, miss)
            where = jnp.where(miss < near, jnp.minimum(where, 1.0), where)
            earlier = where < first
            first = jnp.where(earlier, where, first)
            event = jnp.where(earlier, code, event)
            jet = select(earlier, jet_1, jet)
            curve = select(earlier, p, curve)
        passed = first <= 1.0
        x = jnp.where((aim == event) & (miss_aim < near), 1.0, hermite.root(curve, first))
        arrived = good & passed & (x >= 1 - near)
        # Beyond the event the law may not be smooth: a poor step is cut there too.
        cut = passed & (x < 1 - near)
        accept = good & ~cut

        # The Taylor step from the end of the step to the event.
        g, d, e = jet
        d = jnp.where(d == 0, 1.0, d)
        dt = -g / d
        dt = dt - (g + d * dt + 0.5 * e * dt * dt) / (d + e * dt)
        # A guard that grazes zero has no such step.
        dt = jnp.where(arrived & (jnp.abs(dt) <= 3 * near * h), dt, 0.0)
        at = jax.tree.map(lambda a, b, e: a + dt * b + 0.5 * dt * dt * e, y, f_1, df_1)
        N_1 = N_1 + dt * (n_1 + 0.5 * dt * nn_1)
        force = jnp.where(N_1 > N_0, N_1, N_0)
        higher = accept & ~(force <= m.peak)

        grow = jnp.clip(0.9 * jnp.maximum(err, 1e-9) ** (-1.0 / 8.0), 0.2, 4.0)
        kept = jnp.maximum(m.h, jnp.where(at_once, 0.0, h))
        done = self.rules.passed(m, jnp.where(arrived, event, NO_EVENT), at, f_1.u)
        done = done._replace(
            h=jnp.where(arrived | at_once | aims, kept, h * grow),
            peak=jnp.where(higher, force, m.peak),
            peak_contact=jnp.where(higher, m.contacts, m.peak_contact),
        )
        stride = None
        if self.senses or record:
            stride = self._stride(m, rate, y, f_1, df_1, h, dt)
        if self.senses and stride is not None:
            release = c.touching & ~done.course.touching
            done = done._replace(sensed=sense(motion, m.sensed, stride, release))
        again = m._replace(
            target=jnp.where(cut, event, NO_EVENT),
            h_target=x * h,
            h=jnp.where(good, m.h, h * jnp.clip(0.9 * err**-0.25, 0.1, 0.7)),
        )
        new = select(accept, done, again)
        lost = new.h < 1e-13 * self.time
        for_ever = steady & pusher.stops_at_release()
        new = new._replace(
            steps=m.steps + 1,
            strides=m.strides + accept,
            over=new.over | lost | for_ever,
            endless=new.endless | for_ever,
            lost_track=m.lost_track | lost,
        )
        return new, stride

    def _stride(self, m: March, rate, y: Point, f_1, df_1, h, dt) -> Stride:
        """The step of h [s] from m.s to y, and the Taylor step dt [s] beyond it."""
        motion, c = self.motion, m.course
        df_0 = jax.jvp(lambda p: motion.rates(c, p), (m.s,), (rate,))[1]
        h = jnp.maximum(h, 1e-12 * stop_gradient(self.time))
        return Stride.of(motion, c, (m.s, rate, df_0), (y, f_1, df_1), h, 1 + dt / h)

    def last(self) -> March:
        """Follow the push to its end."""

        def turn(m):
            return self.step(m)[0]

        # Run loop by loop, starting the loops would cost more than what is in them.
        own = self.motion.rig.only_own_laws
        return jax.lax.while_loop(self.goes_on, in_one_piece(turn) if own else turn, self.start())

    def goes_on(self, m: March):
        return ~m.over & (m.steps < self.most)
