"""Sensors: what the force sensor and the probe can resolve, and how they err.

The effects below are sensors around a sensor, as in the other modules.
"""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

Number = Float[Array, ""] | float


class ForceSensor(eqx.Module):
    """The piezoelectric sensor in the push tip; defaults are the paper's."""

    sensitivity: float = 11.2e-3
    """[V/N]"""
    range: float = 446.0
    """[N], either sign"""
    rate: float = 200e3
    """[Hz]"""
    noise: float | None = None
    """Standard deviation of one sample [N]; None: not known"""
    filtered: ClassVar[bool] = False
    """whether a reading depends on what was before it"""
    sampled: ClassVar[bool] = False
    """whether a peak is read off samples"""

    def read(self, f):
        """The reading [N] of a force [N] that has passed the filters."""
        return f

    @property
    def low(self):
        """Time constant [s] of the low-pass."""
        return 0.0

    @property
    def slowness(self):
        """Inverse time constant [1/s] of the high-pass."""
        return 0.0

    @property
    def interval(self):
        """Time between the samples that a peak is read off [s]; 0: all of the time."""
        return 0.0


class ForceEffect(eqx.Module):
    """A sensor around another one, `law`; what an effect does not override is that one's own."""

    law: Any

    @property
    def sensitivity(self):
        return self.law.sensitivity

    @property
    def range(self):
        return self.law.range

    @property
    def rate(self):
        return self.law.rate

    @property
    def noise(self):
        return self.law.noise

    @property
    def filtered(self) -> bool:
        return self.law.filtered

    @property
    def sampled(self) -> bool:
        return self.law.sampled

    def read(self, f):
        return self.law.read(f)

    @property
    def low(self):
        return self.law.low

    @property
    def slowness(self):
        return self.law.slowness

    @property
    def interval(self):
        return self.law.interval


class Lowpass(ForceEffect):
    """An amplifier's bandwidth: `tau f' = N - f`, f = 0 before the push.

    tau >= 0 [s]; null: 0.
    """

    tau: Number = 0.0
    filtered: ClassVar[bool] = True  # type: ignore[assignment]

    @property
    def low(self):
        return self.tau


class Highpass(ForceEffect):
    """A piezo's charge leaks: `f - l` is read, `tau l' = f - l`, l = 0 before the push.

    slowness = 1 / tau >= 0 [1/s]; null: 0. Not equal to a low-pass's tau.
    """

    leak: Number = 0.0
    filtered: ClassVar[bool] = True  # type: ignore[assignment]

    @property
    def slowness(self):
        return self.leak


class Gain(ForceEffect):
    """The reading is factor times the force. factor > 0; null: 1."""

    factor: Number = 1.0

    def read(self, f):
        return self.factor * self.law.read(f)


class Offset(ForceEffect):
    """The reading's zero is off by an offset [N]; null: 0."""

    offset: Number = 0.0

    def read(self, f):
        return self.law.read(f) + self.offset


class Saturation(ForceEffect):
    """Readings are clipped at a level [N], either sign; null: infinite."""

    level: Number = jnp.inf

    def read(self, f):
        return jnp.clip(self.law.read(f), -self.level, self.level)


class SampledPeak(ForceEffect):
    """A table's peak is the largest of slow samples at t = 0, 1 / rate, 2 / rate, ...

    spacing = 1 / rate >= 0 [s]; null: 0, every instant.
    """

    spacing: Number = 0.0
    sampled: ClassVar[bool] = True  # type: ignore[assignment]

    @property
    def interval(self):
        return self.spacing


class Probe(eqx.Module):
    """The digital linear probe on the part; defaults are the paper's."""

    resolution: float = 20e-9
    """[m]"""
    noise: float | None = None
    """Standard deviation of one reading [m]; None: not known"""
    late: ClassVar[bool] = False
    """whether a distance starts anywhere but at the loss of contact"""

    def read(self, x):
        """The reading [m] of a position x [m] since the start of the push."""
        return x

    @property
    def threshold(self):
        """The contact force [N] at whose fall a distance starts."""
        return 0.0

    @property
    def delay(self):
        """How far readings of position lag those of force [s]."""
        return 0.0


class ProbeEffect(eqx.Module):
    """A probe around another one, `law`; what an effect does not override is that one's own."""

    law: Any

    @property
    def resolution(self):
        return self.law.resolution

    @property
    def noise(self):
        return self.law.noise

    @property
    def late(self) -> bool:
        return self.law.late

    def read(self, x):
        return self.law.read(x)

    @property
    def threshold(self):
        return self.law.threshold

    @property
    def delay(self):
        return self.law.delay


class ProbeScale(ProbeEffect):
    """Lengths are read as factor times themselves. factor > 0; null: 1."""

    factor: Number = 1.0

    def read(self, x):
        return self.factor * self.law.read(x)


class ReleaseThreshold(ProbeEffect):
    """A table's loss of contact is taken where the contact force last falls through a threshold.

    threshold >= 0 [N]; null: 0.
    """

    level: Number = 0.0
    late: ClassVar[bool] = True  # type: ignore[assignment]

    @property
    def threshold(self):
        return self.level


class ChannelSkew(ProbeEffect):
    """Readings of position lag those of force by a delay >= 0 [s]; null: 0."""

    skew: Number = 0.0
    late: ClassVar[bool] = True  # type: ignore[assignment]

    @property
    def delay(self):
        return self.skew
