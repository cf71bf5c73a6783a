"""What is read of a push besides its plain peak and release, stride by stride: filtered forces,
peaks among samples, a release seen at a threshold or through a lagging channel."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.lax import stop_gradient

from difffric.simulation.dynamics import Motion
from difffric.simulation.stepping.dense_output import OnePole, Stride

_LOOKS = np.linspace(0.0, 1.0, 9)
_KEPT = 32
"""strides that a lagging channel is looked up in"""


class Sensed(NamedTuple):
    """What the sensors have seen so far."""

    low: Array
    """the low-pass's state [N]"""
    high: Array
    """the high-pass's [N]"""
    peak: Array
    """the largest filtered force at the instants that count [N]"""
    before: Array
    """contact force at the last stride's end [N]"""
    t_lost: Array
    x_lost: Array
    crossed: Array
    """whether the force has fallen through the threshold"""
    strides: Any
    """the last few, the newest last: (t, h, powers of x); None where none is looked up"""


def nothing(motion: Motion) -> Sensed:
    """Before the push."""
    zero = jnp.zeros(())
    kept = None
    if motion.rig.probe.late:
        far, none = jnp.full(_KEPT, -jnp.inf), jnp.zeros(_KEPT)
        kept = far, none + 1.0, *([none] * 8)
    return Sensed(zero, zero, zero - jnp.inf, zero, zero, zero, jnp.asarray(False), kept)


def sense(motion: Motion, seen: Sensed, stride: Stride, release) -> Sensed:
    """After one more stride, at whose end contact is lost where `release` says so."""
    sensor, probe = motion.rig.force_sensor, motion.rig.probe
    N = stride.force_powers(motion)
    if sensor.filtered or sensor.sampled:
        seen = _heard(sensor, seen, stride, N)
    if probe.late:
        kept = tuple(
            jnp.concatenate([old[1:], new[None]])
            for old, new in zip(seen.strides, (stride.t, stride.h, *stride.x), strict=True)
        )
        seen = _lost(motion, seen._replace(strides=kept), stride, N, release)
    return seen._replace(before=jnp.where(release, 0.0, stride.force(motion, stride.end)))


class Filtered(NamedTuple):
    """A stride's force behind low-pass and high-pass, as two parallel one-pole filters:
    1 / (1 + tau s) - 1 / ((1 + tau s)(1 + T s)) = T / (T - tau) (low - high)."""

    low: OnePole
    high: OnePole
    share: Array

    @classmethod
    def of(cls, sensor, N, state, h) -> Filtered:
        """N: (8,) the force's powers; state: (low, high) at the stride's start [N]."""
        tau, leak = sensor.low, sensor.slowness
        slow = jnp.where(leak > 0, 1.0 / jnp.where(leak > 0, leak, 1.0), 1e30)
        low, high = OnePole.of(N, state[0], h, tau), OnePole.of(N, state[1], h, slow)
        return cls(low, high, 1.0 / (1.0 - tau * leak) + 0.0 * N[0])

    def value(self, share):
        """What passes [N] at a share of the stride."""
        return self.share * (self.low.value(share) - self.high.value(share))

    def passed(self) -> Passed:
        """The same in few numbers."""
        powers = [a - b for a, b in zip(self.low.powers, self.high.powers, strict=True)]
        return Passed(
            self.share * jnp.stack(powers),
            self.share * jnp.stack([self.low.rest, -self.high.rest]),
            jnp.stack([self.low.ratio, self.high.ratio]),
        )


class Passed(NamedTuple):
    """What filters let through of one stride: a polynomial of its share, and two decays."""

    powers: Array
    rests: Array
    """(2,) [N]"""
    ratios: Array
    """(2,) step / time constant; infinite: what decays is gone"""

    def value(self, share):
        """[N] at a share of the stride."""
        total = self.powers[-1]
        for n in range(self.powers.shape[0] - 2, -1, -1):
            total = total * share + self.powers[n]
        sharp = jnp.isinf(self.ratios)
        fades = jnp.exp(-jnp.where(sharp, 1.0, self.ratios) * share)
        return total + jnp.sum(jnp.where(sharp, 0.0, self.rests * fades))


def _heard(sensor, seen: Sensed, stride: Stride, N) -> Sensed:
    """The filters' states at the stride's end, and the largest force they have let through."""
    through = Filtered.of(sensor, N, (seen.low, seen.high), stride.h)
    passed = through.value

    if sensor.sampled:
        every = sensor.interval
        samples = every > 0
        step = jnp.where(samples, every, 1.0)

    looks = jnp.asarray(_LOOKS) * stop_gradient(stride.end)
    values = stop_gradient(jax.vmap(passed)(looks))
    i = jnp.argmax(values)
    lo, hi = looks[jnp.maximum(i - 1, 0)], looks[jnp.minimum(i + 1, len(_LOOKS) - 1)]

    def slope(f, share):
        return jax.jvp(f, (share,), (jnp.ones_like(share),))[1]

    def improve(_, bracket):
        lo, hi, x = bracket
        g, c = jax.jvp(lambda share: slope(still, share), (x,), (jnp.ones_like(x),))
        lo, hi = jnp.where(g > 0, x, lo), jnp.where(g > 0, hi, x)
        new = x - g / jnp.where(c < 0, c, -1.0)
        middle = jnp.where(g == 0, x, 0.5 * (lo + hi))
        return lo, hi, jnp.where((c < 0) & (new >= lo) & (new <= hi), new, middle)

    still = stop_gradient(through).value
    x = jax.lax.fori_loop(0, 8, improve, stop_gradient((lo, hi, looks[i])))[2]
    # One more step, which is small, carries the derivatives.
    x = stop_gradient(x)
    g, c = jax.jvp(lambda share: slope(passed, share), (x,), (jnp.ones_like(x),))
    inner = (c < 0) & (jnp.abs(stop_gradient(g / jnp.where(c < 0, c, -1.0))) < 1e-3)
    top = x - jnp.where(inner, g / jnp.where(inner, c, 1.0), 0.0)
    top = jnp.where(stop_gradient(top) >= stop_gradient(stride.end), stride.end, top)
    top = jnp.maximum(top, 0.0)
    best = jnp.maximum(passed(top), jnp.maximum(passed(0.0), passed(stride.end)))
    if sensor.sampled:
        # The samples next to the stride's highest instant, and those next to its ends.
        found = seen.peak
        for at in (top, 0.0, 1.0):
            n = stop_gradient(jnp.floor((stride.t + at * stride.h) / step))
            for k in (0, 1):
                t = (n + k) * step
                share = (t - stride.t) / stride.h
                inside = stop_gradient((share >= 0) & (share < stride.end))
                f = passed(jnp.where(inside, share, 0.0))
                found = jnp.where(inside & (f > found), f, found)
        best = jnp.where(samples, found, best)
    return seen._replace(
        low=through.low.value(stride.end),
        high=through.high.value(stride.end),
        peak=jnp.maximum(seen.peak, best),
    )


def _lost(motion: Motion, seen: Sensed, stride: Stride, N, release) -> Sensed:
    """When and where contact is taken to be lost in the stride, if it is."""
    level = motion.rig.probe.threshold
    first, last = N[0], jnp.where(release, 0.0, sum(N))
    jumps = (seen.before >= level) & (first < level) & (level > 0)
    falls = jnp.where(level > 0, (first >= level) & (last < level), release)
    lo, hi = jnp.zeros(()), jnp.ones(())
    still = stop_gradient(N)

    def value(powers, share):
        total = powers[-1]
        for c in powers[-2::-1]:
            total = total * share + c
        return total - level

    def improve(_, carry):
        lo, hi, x = carry
        g, d = jax.jvp(lambda share: value(still, share), (x,), (jnp.ones_like(x),))
        lo, hi = jnp.where(g > 0, x, lo), jnp.where(g > 0, hi, x)
        new = x - g / jnp.where(d < 0, d, -1.0)
        return lo, hi, jnp.where((d < 0) & (new >= lo) & (new <= hi), new, 0.5 * (lo + hi))

    x = stop_gradient(jax.lax.fori_loop(0, 12, improve, (lo, hi, 0.5 * hi))[2])
    g, d = jax.jvp(lambda share: value(N, share), (x,), (jnp.ones_like(x),))
    x = x - g / jnp.where(d == 0, 1.0, d)  # carries the derivatives
    share = jnp.where(level > 0, jnp.where(falls, x, 0.0), stride.end)
    t = stride.t + share * stride.h
    crossed = falls | jumps
    t_read = t - motion.rig.probe.delay
    at, h, *position = seen.strides
    i = jnp.clip(jnp.sum(stop_gradient(at <= t_read)) - 1, 0, _KEPT - 1)
    share = (t_read - at[i]) / h[i]
    total = position[-1][i]
    for powers in position[-2::-1]:
        total = total * share + powers[i]
    x_read = jnp.where(jnp.isfinite(at[i]) & (t_read > 0), total, 0.0)
    return seen._replace(
        t_lost=jnp.where(crossed, t, seen.t_lost),
        x_lost=jnp.where(crossed, x_read, seen.x_lost),
        crossed=seen.crossed | crossed,
    )
