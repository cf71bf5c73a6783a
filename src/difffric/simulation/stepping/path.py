"""A push as its strides, to be evaluated at any time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from difffric.compute.pytrees import select
from difffric.compute.xla_options import hold, in_one_piece
from difffric.rig.rig import Rig
from difffric.simulation.dynamics import Motion
from difffric.simulation.stepping.dense_output import Stride
from difffric.simulation.stepping.loop import StepLoop
from difffric.simulation.stepping.sensor_readout import Filters, PassedForce, filter_strides
from difffric.simulation.stepping.state import LoopState

_FINE = 9
"""Times at which a peak is looked at closely."""
_FEW = 16
"""Strides that filters are taken through at once, where the table holds a multiple of so many: more
would be wasted on a short push."""


class PushPath(NamedTuple):
    """A push as its strides, to be evaluated at any time."""

    motion: Motion
    strides: Stride
    """stacked, padded with t = inf"""
    end: LoopState
    filtered_strides: PassedForce | None = None
    """what the force sensor's filters let through, stacked likewise; None: it has none"""

    def _find(self, time: Array) -> tuple[Stride, Array, Array, Array]:
        """(stride, its index, share of it, whether it is past the last one) at a time [s]."""
        i = jnp.searchsorted(self.strides.t, time, side="right") - 1
        i = hold(jnp.clip(i, 0, self.strides.t.shape[0] - 1))
        stride = jax.tree.map(lambda column: column[i], self.strides)
        share = (time - stride.t) / stride.h
        over = time >= self.end.s.t
        course = select(over, self.end.course, stride.course)
        return stride._replace(course=course), i, jnp.clip(share, 0.0, 1.0), over

    def evaluate(self, time: Float[Array, ""]) -> tuple[Array, Array, Array]:
        """(contact force [N], position [m], speed [m/s]) at a time [s]; no force before 0."""
        stride, _, share, over = self._find(time)
        s = stride.point(self.motion, share)
        end = self.end.s
        s = select(over, end, s._replace(q=end.q))
        force = jnp.where(time >= 0, self.motion.force(stride.course, s), 0.0)
        return force, self.motion.position(s), jnp.where(over, 0.0, s.u)

    def locate(self, time: Float[Array, ""]) -> Float[Array, ""]:
        """The part's position [m] at a time [s]: what `evaluate` says of it, in half the time."""
        stride, _, share, over = self._find(time)
        return jnp.where(over, self.motion.position(self.end.s), stride.position(share))

    def read(
        self, t_force: Float[Array, "*force"], t_position: Float[Array, "*position"]
    ) -> tuple[Array, Array]:
        """What the sensors read: force [N] and position [m], each at its own times [s]."""
        sensor, probe = self.motion.rig.force_sensor, self.motion.rig.probe
        force = jnp.vectorize(self.filter_force)(t_force)
        position = jnp.vectorize(self.locate)(t_position - probe.delay)
        return sensor.read(force), probe.read(position)

    def measure_late_distance(self) -> Float[Array, ""]:
        """How much longer than it is d is read [m], as the position that is read at the loss of
        contact is that of a `probe.delay` before."""
        probe = self.motion.rig.probe
        before = self.locate(self.end.t_lost - probe.delay)
        return probe.read(self.end.x_lost) - probe.read(before)

    def find_read_peak(
        self, t: Float[Array, " e"], f: Float[Array, " e"], peak: Float[Array, ""]
    ) -> Float[Array, ""]:
        """The highest force [N] that the sensor reads, where it reads f [N] at the ascending times
        t [s], between three of which it is smooth; `peak` [N] is what it would read without its
        filters, and does where they let all through."""
        if self.filtered_strides is None:
            return peak
        sensor = self.motion.rig.force_sensor
        k = jnp.clip(jnp.argmax(f), 1, t.shape[0] - 2)
        passed = jnp.abs(sensor.read(self.evaluate(t[k])[0]) - f[k]) <= 1e-9 * jnp.abs(f[k])
        g = sensor.read(jax.vmap(self.filter_force)(jnp.linspace(t[k - 1], t[k + 1], _FINE)))
        j = jnp.clip(jnp.argmax(g), 1, _FINE - 2)
        bend = 2 * g[j] - g[j - 1] - g[j + 1]  # a parabola through the highest three
        top = g[j] + (g[j + 1] - g[j - 1]) ** 2 / (8 * jnp.where(bend > 0, bend, jnp.inf))
        return jnp.where(passed, peak, jnp.maximum(jnp.max(g), jnp.minimum(top, g[j] + bend)))

    def filter_force(self, time: Float[Array, ""]) -> Float[Array, ""]:
        """The force [N] that the sensor's filters let through at a time [s]."""
        if self.filtered_strides is None:
            return self.evaluate(time)[0]
        _, i, share, _ = self._find(time)
        passed = jax.tree.map(lambda column: column[i], self.filtered_strides)
        return jnp.where(time >= 0, passed.value(share), 0.0)


def follow(loop: StepLoop, rows: int) -> tuple[LoopState, PushPath]:
    """Follow the push to its end, and keep so many strides at most."""
    start = loop.start()
    blank = jax.eval_shape(lambda m: loop.step(m, record=True)[1], start)
    table = jax.tree.map(lambda a: jnp.zeros((rows, *a.shape), a.dtype), blank)
    table = table._replace(t=jnp.full(rows, jnp.inf))

    def turn(carry):
        m, table = carry
        new, stride = loop.step(m, record=True)
        accepted = new.strides > m.strides
        i = jnp.minimum(m.strides, rows - 1)
        table = jax.tree.map(
            lambda whole, row: whole.at[i].set(jnp.where(accepted, row, whole[i])),
            table,
            stride,
        )
        return new, table

    m, table = jax.lax.while_loop(lambda carry: loop.is_unfinished(carry[0]), turn, (start, table))
    m = m._replace(lost_track=m.lost_track | (m.strides >= rows))
    path = PushPath(loop.motion, table, m)
    has_filters = loop.motion.rig.force_sensor.filtered
    return m, _add_filters(path, m.strides) if has_filters else path


def follow_together(
    build_loop: Callable[[Rig, Array], StepLoop],
    rigs: Rig,
    v: Float[Array, " n"],
    rows: int,
    until: Float[ArrayLike, " n"] = np.inf,
) -> PushPath:
    """The paths of many pushes, followed in one loop that ends with the last of them, or beyond the
    times `until` [s], for so many steps at most; `end.lost_track` says where that was too few, or a
    law gave no number.

    `build_loop(rig, v)` is mapped over rigs and speeds [m/s] with a leading axis. `vmap` of
    `follow` would do the same, and copy the whole table of strides at each step.
    """

    until = jnp.broadcast_to(jnp.asarray(until, float), jnp.shape(v))

    def step(rig, v, until, m):
        here = build_loop(rig, v)
        on = here.is_unfinished(m) & (m.s.t < until)
        new, stride = here.step(m, record=True)
        assert stride is not None
        # A step that is taken again has the time of the next one, which is found in its place;
        # filters pass over it. It stands still, as it may have led to no number at all.
        taken = on & (new.strides > m.strides)

        def rest(powers):
            return powers[0], *(jnp.where(taken, a, 0.0) for a in powers[1:])

        return select(on, new, m), stride._replace(
            t=jnp.where(on, stride.t, jnp.inf),
            end=jnp.where(taken, stride.end, 0.0),
            x=rest(stride.x),
            y=rest(stride.y),
        )

    # Run loop by loop, starting the loops would cost more than what is in them.
    every = jax.vmap(step)
    every = in_one_piece(every) if rigs.only_own_laws else every
    start = jax.vmap(lambda rig, v: build_loop(rig, v).start())(rigs, v)
    blank = jax.eval_shape(lambda m: every(rigs, v, until, m)[1], start)
    table = jax.tree.map(lambda a: jnp.zeros((rows, *a.shape), a.dtype), blank)
    table = table._replace(t=jnp.full((rows, *blank.t.shape), jnp.inf))

    def turn(carry):
        k, m, table = carry
        m, stride = every(rigs, v, until, m)
        table = jax.tree.map(lambda whole, row: whole.at[k].set(row), table, stride)
        return k + 1, m, table

    def goes_on(carry):
        k, m, _ = carry
        return (k < rows) & ~jnp.all(m.over | (m.s.t >= until))

    steps, m, table = jax.lax.while_loop(goes_on, turn, (0, start, table))
    m = m._replace(lost_track=m.lost_track | ~(m.over | (m.s.t >= until)))

    def path(rig, v, m, table):
        found = PushPath(build_loop(rig, v).motion, table, m)
        return _add_filters(found, steps) if rig.force_sensor.filtered else found

    table = jax.tree.map(lambda whole: jnp.moveaxis(whole, 0, 1), table)
    return jax.vmap(path)(rigs, v, m, table)


def _add_filters(path: PushPath, steps: Int[ArrayLike, ""]) -> PushPath:
    """The path with what the force sensor's filters remember at each stride's start; `steps` of
    its rows are filled."""
    sensor, strides = path.motion.rig.force_sensor, path.strides
    filters = Filters(jnp.asarray(sensor.low, float), jnp.asarray(sensor.slowness, float))
    rows = strides.t.shape[0]
    size = math.gcd(rows, _FEW)

    def filter_few(first, state):
        few = jax.tree.map(
            lambda column: jax.lax.dynamic_slice_in_dim(column, first, size), strides
        )
        there = jnp.isfinite(few.t)
        h = jnp.where(there, few.h, 1.0)
        few = few._replace(h=h)
        N = jnp.stack(jax.vmap(lambda stride: stride.force_powers(path.motion))(few))
        return filter_strides(filters, N, h, few.end, there, state)

    zero = 0.0 * strides.x[0][0] * strides.h[0]
    blank = jax.eval_shape(lambda: filter_few(0, (zero, zero))[1])
    table = jax.tree.map(lambda a: jnp.zeros((rows, *a.shape[1:]), a.dtype), blank)

    def turn(carry):
        first, state, table = carry
        state, passed = filter_few(first, state)
        put = jax.lax.dynamic_update_slice_in_dim
        table = jax.tree.map(lambda old, new: put(old, new, first, 0), table, passed)
        return first + size, state, table

    _, _, table = jax.lax.while_loop(
        lambda carry: jnp.less(carry[0], steps), turn, (0, (zero, zero), table)
    )
    return path._replace(filtered_strides=table)
