"""A push as its strides, to be evaluated at any time."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from difffric.march import Marcher
from difffric.march_state import March
from difffric.motion import Motion
from difffric.sensing import Filtered
from difffric.stride import Stride


def _select(condition, new, old):
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)


class Path(NamedTuple):
    """A push as its strides, to be evaluated at any time."""

    motion: Motion
    strides: Stride
    """stacked, padded with t = inf"""
    filters: Array
    """(strides, 2) states of the low-pass and the high-pass at each stride's start [N]"""
    end: March

    def _at(self, time):
        """(stride, its index, share of it) at a time; the end's state beyond the last one."""
        i = jnp.searchsorted(self.strides.t, time, side="right") - 1
        i = jnp.clip(i, 0, self.strides.t.shape[0] - 1)
        stride = jax.tree.map(lambda column: column[i], self.strides)
        share = (time - stride.t) / stride.h
        over = time >= self.end.s.t
        course = _select(over, self.end.course, stride.course)
        return stride._replace(course=course), i, jnp.clip(share, 0.0, 1.0), over

    def evaluate(self, time):
        """(contact force [N], position [m], speed [m/s]) at a time [s]; no force before 0."""
        stride, _, share, over = self._at(time)
        s = stride.point(self.motion, share)
        end = self.end.s
        s = _select(over, end, s._replace(q=end.q))
        force = jnp.where(time >= 0, self.motion.force(stride.course, s), 0.0)
        return force, self.motion.position(s), jnp.where(over, 0.0, s.u)

    def filtered(self, time):
        """The force that the sensor's filters let through [N]."""
        sensor = self.motion.rig.force_sensor
        if not sensor.filtered:
            return self.evaluate(time)[0]
        stride, i, share, _ = self._at(time)
        through = Filtered.of(sensor, stride.force_powers(self.motion), self.filters[i], stride.h)
        return jnp.where(time >= 0, through.value(share), 0.0)


def follow(marcher: Marcher, rows: int) -> tuple[March, Path]:
    """Follow the push to its end, and keep so many strides at most."""
    start = marcher.start()
    blank = jax.eval_shape(lambda m: marcher.step(m, record=True)[1], start)
    table = jax.tree.map(lambda a: jnp.zeros((rows, *a.shape), a.dtype), blank)
    table = table._replace(t=jnp.full(rows, jnp.inf))
    filters = jnp.zeros((rows, 2))

    def turn(carry):
        m, table, filters = carry
        new, stride = marcher.step(m, record=True)
        accepted = new.strides > m.strides
        i = jnp.minimum(m.strides, rows - 1)
        table = jax.tree.map(
            lambda whole, row: whole.at[i].set(jnp.where(accepted, row, whole[i])),
            table,
            stride,
        )
        if m.sensed is not None:
            state = jnp.stack([m.sensed.low, m.sensed.high])
            filters = filters.at[i].set(jnp.where(accepted, state, filters[i]))
        return new, table, filters

    m, table, filters = jax.lax.while_loop(
        lambda carry: marcher.goes_on(carry[0]), turn, (start, table, filters)
    )
    m = m._replace(lost_track=m.lost_track | (m.strides >= rows))
    return m, Path(marcher.motion, table, filters, m)
