"""Sensors: what the force sensor and the probe can resolve, and how they err.

The effects below are sensors around a sensor, as in the other modules.
"""

from __future__ import annotations

import abc
from math import inf
from typing import ClassVar

from difffric.compute import arrays as xp
from difffric.compute.number_tree import NumberTree
from difffric.rig.number import Number


class AbstractForceSensor(NumberTree, abc.ABC):
    """A force sensor: its limits, and what it reads of a force.

    One that reads the force itself has only the four numbers; the other methods say how a reading
    differs, and each may stay as it is.
    """

    filtered: ClassVar[bool] = False
    """whether a reading depends on what was before it"""
    sampled: ClassVar[bool] = False
    """whether a peak is read off samples"""

    @property
    @abc.abstractmethod
    def sensitivity(self) -> float:
        """[V/N]."""

    @property
    @abc.abstractmethod
    def range(self) -> float:
        """[N], either sign."""

    @property
    @abc.abstractmethod
    def rate(self) -> float:
        """[Hz]."""

    @property
    @abc.abstractmethod
    def noise(self) -> float | None:
        """Standard deviation of one sample [N]; None: not known."""

    def read(self, f: Number) -> Number:
        """The reading [N] of a force [N] that has passed the filters."""
        return f

    @property
    def low(self) -> Number:
        """Time constant [s] of the low-pass."""
        return 0.0

    @property
    def slowness(self) -> Number:
        """Inverse time constant [1/s] of the high-pass."""
        return 0.0

    @property
    def interval(self) -> Number:
        """Time between the samples that a peak is read off [s]; 0: all of the time."""
        return 0.0


class ForceSensor(AbstractForceSensor):
    """The piezoelectric sensor in the push tip; defaults are the paper's."""

    sensitivity: float = 11.2e-3
    range: float = 446.0
    rate: float = 200e3
    noise: float | None = None


class AbstractForceEffect(AbstractForceSensor):
    """A sensor around another one, `law`; what an effect does not override is that one's own."""

    law: AbstractForceSensor

    @property
    def sensitivity(self) -> float:
        return self.law.sensitivity

    @property
    def range(self) -> float:
        return self.law.range

    @property
    def rate(self) -> float:
        return self.law.rate

    @property
    def noise(self) -> float | None:
        return self.law.noise

    @property
    def filtered(self) -> bool:
        return self.law.filtered

    @property
    def sampled(self) -> bool:
        return self.law.sampled

    def read(self, f: Number) -> Number:
        return self.law.read(f)

    @property
    def low(self) -> Number:
        return self.law.low

    @property
    def slowness(self) -> Number:
        return self.law.slowness

    @property
    def interval(self) -> Number:
        return self.law.interval


class Lowpass(AbstractForceEffect):
    """An amplifier's bandwidth: `tau f' = N - f`, f = 0 before the push.

    tau >= 0 [s]; null: 0.
    """

    law: AbstractForceSensor
    tau: Number = 0.0
    filtered: ClassVar[bool] = True

    @property
    def low(self) -> Number:
        return self.tau


class Highpass(AbstractForceEffect):
    """A piezo's charge leaks: `f - l` is read, `tau l' = f - l`, l = 0 before the push.

    slowness = 1 / tau >= 0 [1/s]; null: 0. Not equal to a low-pass's tau.
    """

    law: AbstractForceSensor
    leak: Number = 0.0
    filtered: ClassVar[bool] = True

    @property
    def slowness(self) -> Number:
        return self.leak


class Gain(AbstractForceEffect):
    """The reading is factor times the force. factor > 0; null: 1."""

    law: AbstractForceSensor
    factor: Number = 1.0

    def read(self, f: Number) -> Number:
        return self.factor * self.law.read(f)


class Offset(AbstractForceEffect):
    """The reading's zero is off by an offset [N]; null: 0."""

    law: AbstractForceSensor
    offset: Number = 0.0

    def read(self, f: Number) -> Number:
        return self.law.read(f) + self.offset


class Saturation(AbstractForceEffect):
    """Readings are clipped at a level [N], either sign; null: infinite."""

    law: AbstractForceSensor
    level: Number = inf

    def read(self, f: Number) -> Number:
        return xp.clip(self.law.read(f), -self.level, self.level)


class SampledPeak(AbstractForceEffect):
    """A table's peak is the largest of slow samples at t = 0, 1 / rate, 2 / rate, ...

    spacing = 1 / rate >= 0 [s]; null: 0, every instant.
    """

    law: AbstractForceSensor
    spacing: Number = 0.0
    sampled: ClassVar[bool] = True

    @property
    def interval(self) -> Number:
        return self.spacing


class AbstractProbe(NumberTree, abc.ABC):
    """A probe: its resolution, and what it reads of a position.

    One that reads the position itself has only the two numbers; the other methods say how a
    reading differs, and each may stay as it is.
    """

    late: ClassVar[bool] = False
    """whether a distance starts anywhere but at the loss of contact"""
    latches: ClassVar[bool] = False
    """whether it may start where a latch closed"""
    looked_up: ClassVar[bool] = False
    """whether where it starts has no closed form, and is looked up on the way"""

    @property
    @abc.abstractmethod
    def resolution(self) -> float:
        """[m]."""

    @property
    @abc.abstractmethod
    def noise(self) -> float | None:
        """Standard deviation of one reading [m]; None: not known."""

    def read(self, x: Number) -> Number:
        """The reading [m] of a position x [m] since the start of the push."""
        return x

    @property
    def threshold(self) -> Number:
        """The contact force [N] at whose fall a distance starts."""
        return 0.0

    @property
    def latch(self) -> Number:
        """The contact force [N] at whose first fall a distance starts, whatever follows; infinite:
        there is no latch."""
        return inf

    @property
    def delay(self) -> Number:
        """How far readings of position lag those of force [s]."""
        return 0.0


class Probe(AbstractProbe):
    """The digital linear probe on the part; defaults are the paper's."""

    resolution: float = 20e-9
    noise: float | None = None


class AbstractProbeEffect(AbstractProbe):
    """A probe around another one, `law`; what an effect does not override is that one's own."""

    law: AbstractProbe

    @property
    def resolution(self) -> float:
        return self.law.resolution

    @property
    def noise(self) -> float | None:
        return self.law.noise

    @property
    def late(self) -> bool:
        return self.law.late

    @property
    def latches(self) -> bool:
        return self.law.latches

    @property
    def looked_up(self) -> bool:
        return self.law.looked_up

    def read(self, x: Number) -> Number:
        return self.law.read(x)

    @property
    def threshold(self) -> Number:
        return self.law.threshold

    @property
    def latch(self) -> Number:
        return self.law.latch

    @property
    def delay(self) -> Number:
        return self.law.delay


class ProbeScale(AbstractProbeEffect):
    """Lengths are read as factor times themselves. factor > 0; null: 1."""

    law: AbstractProbe
    factor: Number = 1.0

    def read(self, x: Number) -> Number:
        return self.factor * self.law.read(x)


class ReleaseThreshold(AbstractProbeEffect):
    """A table's loss of contact is taken where the contact force last falls through a threshold.

    threshold >= 0 [N]; null: 0.
    """

    law: AbstractProbe
    level: Number = 0.0
    late: ClassVar[bool] = True
    looked_up: ClassVar[bool] = True

    @property
    def threshold(self) -> Number:
        return self.level


class ReleaseLatch(AbstractProbeEffect):
    """A table's distance is counted from the first time that the contact force falls through a
    threshold, as a card's latch takes it, whatever follows; where it never does, from where it
    would be without.

    sensitivity = 1 / threshold >= 0 [1/N]; null: 0, no latch.
    """

    law: AbstractProbe
    sensitivity: Number = 0.0
    late: ClassVar[bool] = True
    latches: ClassVar[bool] = True

    @property
    def latch(self) -> Number:
        some = xp.asarray(self.sensitivity) > 0
        return xp.where(some, 1.0 / xp.where(some, self.sensitivity, 1.0), inf)


class ChannelSkew(AbstractProbeEffect):
    """Readings of position lag those of force by a delay >= 0 [s]; null: 0."""

    law: AbstractProbe
    skew: Number = 0.0
    late: ClassVar[bool] = True
    looked_up: ClassVar[bool] = True

    @property
    def delay(self) -> Number:
        return self.skew
