"""Pushers: how the push tip travels.

y is the tip's travel [m], V its speed [m/s] before any ripple, v the commanded speed.
The effects below are pushers around a pusher.
"""

from __future__ import annotations

import abc
from math import inf, pi
from typing import Any, ClassVar

from difffric.compute import arrays as xp
from difffric.compute.elementary_functions import sin_cos
from difffric.compute.number_tree import NumberTree
from difffric.rig.number import Number, Truth


class AbstractPusher(NumberTree, abc.ABC):
    """A pusher: the travel of its tip over the time.

    A pusher that keeps one speed has only a `stroke`; the other methods say how the speed
    differs from the commanded one, and each may stay as it is.
    """

    constant: ClassVar[bool] = True
    """whether the tip keeps one speed until it stands"""

    @property
    @abc.abstractmethod
    def stroke(self) -> Number | None:
        """The travel [m] at which the tip stops, where it says so; None: at the first loss of
        contact."""

    def travel(self, v: Number) -> Number:
        """The travel [m] at which the tip stops at the speed v [m/s]; infinite where nothing but a
        loss of contact stops it."""
        return inf if self.stroke is None else self.stroke

    def stop_time(self, v: Number) -> Number:
        """Time [s] at which the tip stops at the constant speed v [m/s]; infinite likewise."""
        return self.travel(v) / v

    def find_travel_left(self, t: Number, y: Number, ahead: Number, v: Number) -> Number:
        """How far the tip may go yet [m] before its command stops, at the time t [s] and the travel
        y [m]; `ahead`: what it will go on for after that."""
        return self.travel(v) - y - ahead

    def stops_at_release(self) -> Truth:
        """Whether the tip stands at the first loss of contact."""
        return True if self.stroke is None else xp.isinf(self.stroke)

    def speed(self, velocity: Number) -> Number:
        """v, the speed [m/s] that a commanded one comes to."""
        return velocity

    def ramp_time(self, v: Number) -> Number:
        """How long the command takes to rise to v [s]."""
        return 0.0

    def lag(self) -> Number:
        """Time constant [s] at which V follows its command."""
        return 0.0

    def corner(self, v: Number, passed: Any) -> Number:
        """When the next corner of V comes [s], after so many `passed` ones (a whole number);
        infinite: there is none."""
        return xp.where(passed < 1, self.ramp_time(v), inf)

    def rise(self, t: Number, v: Number, passed: Any) -> Number:
        """V [m/s] at the time t [s] before the stop; `passed`: how many corners of V lie behind (a
        whole number)."""
        return v

    def fall(self, t: Number, V: Number) -> Number:
        """V [m/s] at the time t [s] after a stop at V."""
        return 0.0

    def ripple(self, y: Number) -> Number:
        """y' / V at the travel y [m]."""
        return 1.0


class ConstantSpeed(AbstractPusher):
    """y = v t up to the stroke [m], then the tip stands at once.

    `stroke=None` is the paper's silent case: the tip stands at the first loss of contact.
    An infinite stroke says the same in a batch that mixes both.
    """

    stroke: Number | None = None


class RecordedMotion(AbstractPusher):
    """The motion that was recorded of the tip, smoothed: V is a polynomial of second degree between
    corners, V = c_0 + c_1 s + c_2 s^2 at s = t - corner, and the tip stands once it is over.

    A trajectory of its own: no effect of a pusher stands around it.
    """

    corners: Any
    """(pieces,) when each piece begins [s]: the first at 0, and infinite beyond the last, which is
    so at the end at least"""
    rates: Any
    """(pieces, 3) c_0 [m/s], c_1 [m/s^2], c_2 [m/s^3]"""
    end: Number
    """when the tip stands [s]"""
    constant: ClassVar[bool] = False

    @property
    def stroke(self) -> Number | None:
        """Infinite: the motion's end decides."""
        return inf

    def find_travel_left(self, t: Number, y: Number, ahead: Number, v: Number) -> Number:
        return (self.end - t) * v

    def stops_at_release(self) -> Truth:
        return False

    def corner(self, v: Number, passed: Any) -> Number:
        return self.corners[passed + 1]

    def rise(self, t: Number, v: Number, passed: Any) -> Number:
        s = t - self.corners[passed]
        c = self.rates[passed]
        return c[0] + s * (c[1] + s * c[2])


def make_pusher(stroke: Any) -> AbstractPusher:
    """The pusher that keeps its speed up to `stroke` [m]; of a recorded motion, that one itself."""
    return stroke if isinstance(stroke, RecordedMotion) else ConstantSpeed(stroke)


class AbstractPusherEffect(AbstractPusher):
    """A pusher around another one, `law`; what an effect does not override is that one's own."""

    law: AbstractPusher

    @property
    def constant(self) -> bool:
        """An effect that makes the speed vary sets this to False."""
        return self.law.constant

    @property
    def stroke(self) -> Number | None:
        """[m]; None: the tip stops at the first loss of contact."""
        return self.law.stroke

    def travel(self, v: Number) -> Number:
        return self.law.travel(v)

    def find_travel_left(self, t: Number, y: Number, ahead: Number, v: Number) -> Number:
        return self.law.find_travel_left(t, y, ahead, v)

    def stops_at_release(self) -> Truth:
        return self.law.stops_at_release()

    def speed(self, velocity: Number) -> Number:
        return self.law.speed(velocity)

    def ramp_time(self, v: Number) -> Number:
        return self.law.ramp_time(v)

    def lag(self) -> Number:
        return self.law.lag()

    def corner(self, v: Number, passed: Any) -> Number:
        return self.law.corner(v, passed)

    def rise(self, t: Number, v: Number, passed: Any) -> Number:
        return self.law.rise(t, v, passed)

    def fall(self, t: Number, V: Number) -> Number:
        return self.law.fall(t, V)

    def ripple(self, y: Number) -> Number:
        return self.law.ripple(y)


class SpeedError(AbstractPusherEffect):
    """The true speed is factor times the commanded one. factor > 0; null: 1."""

    law: AbstractPusher
    factor: Number = 1.0

    def speed(self, velocity: Number) -> Number:
        return self.law.speed(self.factor * velocity)


class Duration(AbstractPusherEffect):
    """The tip stops when its time is over, be it in contact or not, if its stroke has not stopped
    it before.

    rate = 1 / duration >= 0 [1/s]; null: 0, for ever.
    """

    law: AbstractPusher
    rate: Number = 0.0

    @property
    def _ends(self) -> Truth:
        return xp.asarray(self.rate) > 0

    @property
    def duration(self) -> Number:
        """The time [s] that the tip moves for, where it ends."""
        return 1.0 / xp.where(self._ends, self.rate, 1.0)

    @property
    def stroke(self) -> Number | None:
        """[m]; infinite: the time decides, and without one the first loss of contact."""
        return inf if self.law.stroke is None else self.law.stroke

    def travel(self, v: Number) -> Number:
        own = self.law.travel(v)
        return xp.where(self._ends, xp.minimum(own, self.duration * v), own)

    def find_travel_left(self, t: Number, y: Number, ahead: Number, v: Number) -> Number:
        own = self.law.find_travel_left(t, y, ahead, v)
        return xp.where(self._ends, xp.minimum(own, (self.duration - t) * v), own)

    def stops_at_release(self) -> Truth:
        return xp.where(self._ends, False, self.law.stops_at_release())


class Ramp(AbstractPusherEffect):
    """Finite acceleration at the start: the command rises to v over v / acceleration; the stop
    stays sudden.

    slowness = 1 / acceleration >= 0 [s^2/m]; null: 0, which is sudden.
    """

    law: AbstractPusher
    slowness: Number = 0.0
    constant: ClassVar[bool] = False

    def ramp_time(self, v: Number) -> Number:
        return self.law.ramp_time(v) + v * self.slowness

    def corner(self, v: Number, passed: Any) -> Number:
        return xp.where(passed < 1, self.ramp_time(v), inf)

    def rise(self, t: Number, v: Number, passed: Any) -> Number:
        return _follow_ramp(t, v, self.ramp_time(v), self.lag(), passed > 0)


class Lag(AbstractPusherEffect):
    """The speed follows its command with a first-order lag, `tau V' = command - V`, at the stop
    too; the command stops so that the travel comes to the stroke.

    tau >= 0 [s]; null: 0.
    """

    law: AbstractPusher
    tau: Number = 0.0
    constant: ClassVar[bool] = False

    def lag(self) -> Number:
        return self.tau

    def rise(self, t: Number, v: Number, passed: Any) -> Number:
        return _follow_ramp(t, v, self.ramp_time(v), self.tau, passed > 0)

    def fall(self, t: Number, V: Number) -> Number:
        return V * _decay(t, self.tau)


class Ripple(AbstractPusherEffect):
    """A speed that ripples with the travel, as behind an imperfect spindle:
    `y' = v (1 + a sin(2 pi y / p + phi))`.

    |a| < 1, p > 0 [m], phi [rad]; null: a = 0.
    """

    law: AbstractPusher
    amplitude: Number = 0.0
    period: Number = 1e-3
    phase: Number = 0.0
    constant: ClassVar[bool] = False

    def ripple(self, y: Number) -> Number:
        wave, _ = sin_cos(2 * pi * y / self.period + self.phase)
        return self.law.ripple(y) * (1 + self.amplitude * wave)


def _decay(t: Number, tau: Number) -> Number:
    """exp(-t / tau), 0 for tau = 0."""
    lags = tau > 0
    return xp.where(lags, xp.exp(-t / xp.where(lags, tau, 1.0)), 0.0)


def _follow_ramp(t: Number, v: Number, t_r: Number, tau: Number, risen: Truth) -> Number:
    """First-order lag's answer to a ramp of duration t_r, then v: the answer to a step,
    v (1 - exp(-t / tau)), averaged over the last t_r."""
    ramps = t_r > 0
    safe = xp.where(ramps, t_r, 1.0)
    rising = v / safe * (t - tau * (1 - _decay(t, tau)))
    since = xp.where(risen, t - t_r, 0.0)
    left = xp.where(ramps, tau / safe * (1 - _decay(safe, tau)), 1.0)
    return xp.where(risen, v * (1 - _decay(since, tau) * left), rising)
