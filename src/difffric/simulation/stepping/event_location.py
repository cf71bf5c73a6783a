"""Where in a step an event lies: the first guard that falls through zero, and how far on it is.

A guard is known at both ends of a step, with its slope there and its curvature at the end; between
them it is a quartic of the share of the step. The step is cut at the first guard's root, and taken
again until it ends there but for a hair, which a Taylor step closes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from difffric.compute import hermite
from difffric.compute.pytrees import select
from difffric.compute.xla_options import hold
from difffric.simulation.events import Event

_LOOKS = (0.25, 0.5, 0.75)  # of a step: where its inside is looked at for a dip between its ends
_DEAF = {Event.TURN, Event.HALT, Event.CONTACT, Event.FORCE_PEAK, Event.SLOWEST}
"""Events that steady sliding before the tip does not have: their guards are rounding."""


class Guard(NamedTuple):
    """One guard over a step."""

    end: tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""] | float]
    """value, slope [1/s] and curvature [1/s^2] at the step's end"""
    curve: tuple[Array, ...]
    """five coefficients of the share of the step; no derivatives pass through them"""

    @classmethod
    def of(
        cls,
        h: Float[Array, ""],
        start: tuple[Float[Array, ""], Float[Array, ""]],
        end: tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]],
    ) -> Guard:
        """From (value, slope) at the start of a step of h [s], and (value, slope, curvature) at
        its end."""
        (g_0, d_0), (g_1, d_1, c_1) = start, end
        numbers = g_0, d_0 * h, g_1, d_1 * h, c_1 * h * h
        return cls(end, hermite.fit_quartic(*stop_gradient(numbers)))

    @classmethod
    def of_maximum(
        cls,
        h: Float[Array, ""],
        sought: Bool[Array, ""],
        start: tuple[Float[Array, ""], Float[Array, ""]],
        end: tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]],
    ) -> Guard:
        """The rate of a quantity, which falls through zero where the quantity is largest, where
        that is sought; the quantity is known better than its rate, so that its quartic is taken."""
        (v_0, p_0), (v_1, p_1, q_1) = start, end
        v = hermite.fit_quartic(*stop_gradient((v_0, p_0 * h, v_1, p_1 * h, q_1 * h * h)))
        rate = (v[1], 2 * v[2], 3 * v[3], 4 * v[4], jnp.zeros_like(h))
        curve = tuple(jnp.where(sought, r, i) for r, i in zip(rate, (1.0, 0, 0, 0, 0), strict=True))
        return cls((jnp.where(sought, p_1, 1.0), jnp.where(sought, q_1, 0.0), 0.0), curve)

    def find_fall(self) -> Float[Array, ""]:
        """About the share of the step at which the guard first falls through zero, to a quarter; 2
        where it does not."""
        where = jnp.where(stop_gradient(self.end[0]) <= 0, 1.0, 2.0)
        for share in _LOOKS[::-1]:
            where = jnp.where(hermite.evaluate(self.curve, share) <= 0, share, where)
        return jnp.where(where > 0.3, where - 0.25 * hermite.look_back(self.curve, where), where)


class GuardCrossing(NamedTuple):
    """The first guard that falls through zero within a step."""

    event: Int[Array, ""]
    """whose guard it is; `Event.NONE`: there is none"""
    share: Float[Array, ""]
    """of the step, where it does"""
    passed: Bool[Array, ""]
    """whether there is one"""
    end: tuple[Array, Array, Array | float]
    """the guard's value, slope and curvature at the step's end"""

    def find_time_beyond(
        self, arrived: Bool[Array, ""], most: Float[Array, ""]
    ) -> Float[Array, ""]:
        """From the step's end to the event [s], to second order: this carries the event time's
        derivatives. 0 where the step has not arrived there, or where that would be more than `most`
        [s]: a guard that grazes zero has no such step."""
        g, d, e = self.end
        d = jnp.where(d == 0, 1.0, d)
        dt = -g / d
        dt = dt - (g + d * dt + 0.5 * e * dt * dt) / (d + e * dt)
        return jnp.where(arrived & (jnp.abs(dt) <= most), dt, 0.0)


def find_crossing(
    guards: Mapping[Event, Guard],
    h: Float[Array, ""],
    aim: Int[Array, ""],
    near: Float[Array, ""],
    steady: Bool[Array, ""],
) -> GuardCrossing:
    """The first guard that falls through zero within a step of h [s], of two at once the first
    named.

    `aim` is the event that the step was to end on: it is reached from either side, so that one that
    lies less than a share `near` beyond the end counts too. `steady`: whether the part only keeps
    the tip's speed.
    """
    zero = jnp.zeros_like(h)
    first, event = jnp.full_like(h, 2.0), jnp.full_like(aim, Event.NONE)
    miss_aim = jnp.full_like(h, jnp.inf)
    end = zero, zero + 1.0, zero
    curve = (zero + 1.0, zero, zero, zero, zero)
    for code, each in guards.items():
        guard = hold(each)
        where = hold(guard.find_fall())
        if code in _DEAF:
            where = jnp.where(steady, 2.0, where)
        e, f = stop_gradient((guard.end[0], guard.end[1] * h))
        aimed = (aim == code) & (f < 0)
        miss = jnp.where(aimed, jnp.abs(e / jnp.where(f == 0, 1.0, f)), jnp.inf)
        miss_aim = jnp.minimum(miss_aim, miss)
        where = jnp.where(miss < near, jnp.minimum(where, 1.0), where)
        earlier = where < first
        first = jnp.where(earlier, where, first)
        event = jnp.where(earlier, code, event)
        end, curve = select(earlier, (guard.end, guard.curve), (end, curve))
    first, event, miss_aim, end, curve = hold((first, event, miss_aim, end, curve))
    at_end = (aim == event) & (miss_aim < near)
    share = jnp.where(at_end, 1.0, hermite.find_root(curve, first))
    return GuardCrossing(event, share, first <= 1.0, end)
