"""What is read of a push besides its plain peak and release, stride by stride: filtered forces,
peaks among samples, a release seen at a threshold or through a lagging channel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.lax import stop_gradient
from jaxtyping import ArrayLike, Bool, Float

from difffric.compute.xla_options import in_one_piece
from difffric.rig.sensors import ForceSensor
from difffric.simulation.dynamics import Motion
from difffric.simulation.stepping.dense_output import OnePole, Stride, sum_powers

_LOOKS = np.linspace(0.0, 1.0, 9)
"""Shares of a stride between which its highest filtered force is looked for."""
_KEPT = 32
"""Strides back in which a lagging channel is looked up; beyond them the oldest is read."""


class SensorReadout(NamedTuple):
    """What the sensors have seen so far."""

    low: Float[Array, ""]
    """the low-pass's state [N]"""
    high: Float[Array, ""]
    """the high-pass's state [N]"""
    peak: Float[Array, ""]
    """the largest filtered force at the instants that count [N]"""
    before: Float[Array, ""]
    """contact force at the last stride's end [N]"""
    t_lost: Float[Array, ""]
    """when the force last fell through the threshold [s]"""
    x_lost: Float[Array, ""]
    """what the probe then read [m]"""
    crossed: Bool[Array, ""]
    """whether it ever has"""
    strides: Any
    """the last few, the newest last: (t, h, powers of x); None where none is looked up"""


def start_readout(motion: Motion) -> SensorReadout:
    """What the sensors have seen before the push: nothing."""
    zero = jnp.zeros(())
    kept = None
    if motion.rig.probe.late:
        far, none = jnp.full(_KEPT, -jnp.inf), jnp.zeros(_KEPT)
        kept = far, none + 1.0, *([none] * 8)
    return SensorReadout(zero, zero, zero - jnp.inf, zero, zero, zero, jnp.asarray(False), kept)


def sense(
    motion: Motion, seen: SensorReadout, stride: Stride, release: Bool[Array, ""]
) -> SensorReadout:
    """What the sensors have seen after one more stride, at whose end contact is lost where
    `release` says so."""
    sensor, probe = motion.rig.force_sensor, motion.rig.probe
    N = stride.force_powers(motion)
    if sensor.filtered or sensor.sampled:
        seen = _filter_stride(sensor, seen, stride, N)
    if probe.late:
        kept = tuple(
            jnp.concatenate([old[1:], new[None]])
            for old, new in zip(seen.strides, (stride.t, stride.h, *stride.x), strict=True)
        )
        seen = _detect_loss(motion, seen._replace(strides=kept), stride, N, release)
    return seen._replace(before=jnp.where(release, 0.0, stride.force(motion, stride.end)))


class Filtered(NamedTuple):
    """A stride's force behind low-pass and high-pass, as two parallel one-pole filters:
    1 / (1 + tau s) - 1 / ((1 + tau s)(1 + T s)) = T / (T - tau) (low - high)."""

    low: OnePole
    high: OnePole
    share: Float[Array, ""]
    """T / (T - tau)"""

    @classmethod
    def of(
        cls,
        sensor: ForceSensor | Any,
        N: Sequence[Array] | Array,
        state: tuple[Array, Array],
        h: Float[Array, ""],
    ) -> Filtered:
        """From the force's eight coefficients N [N], the filters' states (low, high) at the
        stride's start [N], and its length h [s]."""
        tau, leak = sensor.low, sensor.slowness
        slow = jnp.where(leak > 0, 1.0 / jnp.where(leak > 0, leak, 1.0), 1e30)
        low, high = OnePole.of(N, state[0], h, tau), OnePole.of(N, state[1], h, slow)
        return cls(low, high, 1.0 / (1.0 - tau * leak) + 0.0 * N[0])

    def value(self, share: Float[ArrayLike, ""]) -> Float[Array, ""]:
        """The filtered force [N] at a share of the stride."""
        return self.share * (self.low.value(share) - self.high.value(share))

    def summarise(self) -> PassedForce:
        """The same in few numbers."""
        return PassedForce(
            self.share * (self.low.powers - self.high.powers),
            self.share * jnp.stack([self.low.rest, -self.high.rest]),
            jnp.stack([self.low.ratio, self.high.ratio]),
        )


class PassedForce(NamedTuple):
    """What filters let through of one stride: a polynomial of its share, and two decays."""

    powers: Float[Array, " terms"]
    """of the polynomial [N]"""
    rests: Float[Array, "2"]
    """what decays [N]"""
    ratios: Float[Array, "2"]
    """step / time constant; infinite: what decays is gone"""

    def value(self, share: Float[ArrayLike, ""]) -> Float[Array, ""]:
        """The filtered force [N] at a share of the stride."""
        total = self.powers[-1]
        for n in range(self.powers.shape[0] - 2, -1, -1):
            total = total * share + self.powers[n]
        sharp = jnp.isinf(self.ratios)
        fades = jnp.exp(-jnp.where(sharp, 1.0, self.ratios) * share)
        low, high = jnp.where(sharp, 0.0, self.rests * fades)
        return total + low + high


class Filters(NamedTuple):
    """A force sensor's filters."""

    low: Array
    """time constant of the low-pass [s]"""
    slowness: Array
    """one over that of the high-pass [1/s]"""


@in_one_piece
def filter_strides(
    filters: Filters,
    N: Float[Array, "8 strides"],
    h: Float[Array, " strides"],
    end: Float[Array, " strides"],
    there: Bool[Array, " strides"],
    state: tuple[Array, Array],
) -> tuple[tuple[Array, Array], PassedForce]:
    """What both filters remember after some strides [N], and what they let through of each, with
    the axis of strides in front.

    N [N] are the coefficients of their forces, h [s] their lengths, of which each counts up to the
    share `end`; those that are not `there` are passed over. `state` is what is remembered before.

    An answer is what it is from nothing and what decays of what is remembered: it is computed for
    all strides at once, and then passed on as a product and a sum.
    """
    none = jnp.zeros_like(h)
    driven = Filtered.of(filters, N, (none, none), h)

    def pass_on(own: OnePole, f: Array) -> tuple[Array, OnePole]:
        kept = jnp.where(there, own.fade(end), 1.0)
        added = jnp.where(there, own.value(end), 0.0)
        f, before = jax.lax.scan(lambda f, ab: (ab[0] * f + ab[1], f), f, (kept, added))
        return f, own._replace(rest=own.rest + before)

    f_low, low = pass_on(driven.low, state[0])
    f_high, high = pass_on(driven.high, state[1])
    passed = driven._replace(low=low, high=high).summarise()
    return (f_low, f_high), jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), passed)


def _find_fall(
    f: Callable[[Array], Array],
    bracket: tuple[Array, Array, Array],
    rounds: int,
    ends_at_zero: bool,
) -> Array:
    """The share of the stride at which f falls through zero between `lo` and `hi` of the bracket
    (lo, hi, guess): so many rounds of Newton's method, and halving where a step leaves the bracket
    or f does not fall. `ends_at_zero`: whether a place where f is exactly zero is kept."""

    def improve(_, bracket):
        lo, hi, x = bracket
        g, d = jax.jvp(f, (x,), (jnp.ones_like(x),))
        lo, hi = jnp.where(g > 0, x, lo), jnp.where(g > 0, hi, x)
        new = x - g / jnp.where(d < 0, d, -1.0)
        middle = 0.5 * (lo + hi)
        if ends_at_zero:
            middle = jnp.where(g == 0, x, middle)
        return lo, hi, jnp.where((d < 0) & (new >= lo) & (new <= hi), new, middle)

    return jax.lax.fori_loop(0, rounds, improve, bracket)[2]


def _slope(f: Callable[[Array], Array]) -> Callable[[Array], Array]:
    return lambda share: jax.jvp(f, (share,), (jnp.ones_like(share),))[1]


def _find_highest(through: Filtered, end: Array) -> Array:
    """The share of a stride, from 0 to `end`, at which the filtered force is highest within it."""
    looks = jnp.asarray(_LOOKS) * stop_gradient(end)
    values = stop_gradient(jax.vmap(through.value)(looks))
    i = jnp.argmax(values)
    lo, hi = looks[jnp.maximum(i - 1, 0)], looks[jnp.minimum(i + 1, len(_LOOKS) - 1)]
    still = stop_gradient(through).value
    # One more step, which is small, carries the derivatives.
    bracket = stop_gradient((lo, hi, looks[i]))
    x = stop_gradient(_find_fall(_slope(still), bracket, 8, ends_at_zero=True))
    g, c = jax.jvp(_slope(through.value), (x,), (jnp.ones_like(x),))
    inner = (c < 0) & (jnp.abs(stop_gradient(g / jnp.where(c < 0, c, -1.0))) < 1e-3)
    top = x - jnp.where(inner, g / jnp.where(inner, c, 1.0), 0.0)
    top = jnp.where(stop_gradient(top) >= stop_gradient(end), end, top)
    return jnp.maximum(top, 0.0)


def _find_highest_sample(
    through: Filtered, interval: Array, stride: Stride, top: Array, found: Array
) -> Array:
    """The largest filtered force at the samples next to the stride's highest instant, and next to
    its ends, or `found` where that is larger [N]."""
    for at in (top, 0.0, 1.0):
        n = stop_gradient(jnp.floor((stride.t + at * stride.h) / interval))
        for k in (0, 1):
            t = (n + k) * interval
            share = (t - stride.t) / stride.h
            inside = stop_gradient((share >= 0) & (share < stride.end))
            f = through.value(jnp.where(inside, share, 0.0))
            found = jnp.where(inside & (f > found), f, found)
    return found


def _filter_stride(
    sensor: ForceSensor | Any, seen: SensorReadout, stride: Stride, N: Sequence[Array]
) -> SensorReadout:
    """The filters' states at the stride's end, and the largest force they have let through."""
    through = Filtered.of(sensor, N, (seen.low, seen.high), stride.h)
    top = _find_highest(through, stride.end)
    ends = jnp.maximum(through.value(0.0), through.value(stride.end))
    best = jnp.maximum(through.value(top), ends)
    if sensor.sampled:
        samples = sensor.interval > 0
        interval = jnp.where(samples, sensor.interval, 1.0)
        sample = _find_highest_sample(through, interval, stride, top, seen.peak)
        best = jnp.where(samples, sample, best)
    return seen._replace(
        low=through.low.value(stride.end),
        high=through.high.value(stride.end),
        peak=jnp.maximum(seen.peak, best),
    )


def _detect_loss(
    motion: Motion,
    seen: SensorReadout,
    stride: Stride,
    N: Sequence[Array],
    release: Bool[Array, ""],
) -> SensorReadout:
    """When and where contact is taken to be lost in the stride, if it is: where the force falls
    through the probe's threshold, or for the first time through that of its latch."""
    probe = motion.rig.probe
    latches = jnp.isfinite(probe.latch)
    level = jnp.where(latches, probe.latch, probe.threshold)
    first, last = N[0], jnp.where(release, 0.0, sum(N))
    jumps = (seen.before >= level) & (first < level) & (level > 0)
    falls = jnp.where(level > 0, (first >= level) & (last < level), release)
    lo, hi = jnp.zeros(()), jnp.ones(())
    still = stop_gradient(N)
    bracket = lo, hi, 0.5 * hi
    x = _find_fall(lambda share: sum_powers(still, share) - level, bracket, 12, ends_at_zero=False)
    x = stop_gradient(x)
    g, d = jax.jvp(lambda share: sum_powers(N, share) - level, (x,), (jnp.ones_like(x),))
    x = x - g / jnp.where(d == 0, 1.0, d)  # carries the derivatives
    # A tip that stops may let go at once: the force then falls at the stride's end, by a jump.
    x = jnp.where(stop_gradient(sum(N)) < level, x, stride.end)
    share = jnp.where(level > 0, jnp.where(falls, x, 0.0), stride.end)
    t = stride.t + share * stride.h
    crossed = (falls | jumps) & ~(latches & seen.crossed)
    return seen._replace(
        t_lost=jnp.where(crossed, t, seen.t_lost),
        x_lost=jnp.where(crossed, _look_up(seen.strides, t - probe.delay), seen.x_lost),
        crossed=seen.crossed | crossed,
    )


def _look_up(strides: Any, t: Array) -> Array:
    """The part's position [m] at a time [s] within the last few strides; 0 before them."""
    at, h, *position = strides
    i = jnp.clip(jnp.sum(stop_gradient(at <= t)) - 1, 0, _KEPT - 1)
    share = (t - at[i]) / h[i]
    x = sum_powers([powers[i] for powers in position], share)
    return jnp.where(jnp.isfinite(at[i]) & (t > 0), x, 0.0)
