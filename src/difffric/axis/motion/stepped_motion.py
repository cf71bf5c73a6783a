"""The motion of an axis with effects: a Runge-Kutta step a sample, with its events.

Derivatives ride along as imaginary parts, one lane a parameter: every law is analytic as long as
the direction of motion is given, and so is the moment of rest, found by Newton's method in a
bracket and taken one complex step further. They are exact for the steps that were taken.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.axis.effects import EFFECTS, Point, list_effect_keys
from difffric.axis.motion.trajectory import SPEED, START, AxisTrajectory
from difffric.axis.setup import BREAKAWAY, COULOMB, MASS, OFFSET, VISCOUS, AxisSetup

Lanes = NDArray[np.complex128]

_TINY = 1e-30
"""Imaginary part that stands for a step along a parameter."""
_DELAY = "drive_delay.delay_s"


class SteppedLaws:
    """The force balance over lanes (parameters,), each with its own parameter moved."""

    def __init__(self, setup: AxisSetup):
        values = setup.values
        self.names = [*values, START, SPEED]
        self.values: dict[str, Lanes] = {}
        for name, value in values.items():
            lanes = np.full(len(self.names), value, complex)
            lanes[self.names.index(name)] += 1j * _TINY
            self.values[name] = lanes
        self.effects = [(EFFECTS[x].law, list_effect_keys(x)) for x in EFFECTS
                        if x in setup.effects and not EFFECTS[x].delays]  # fmt: skip

    def add_effects(self, x: Lanes, u: Lanes, sign: int, own: dict[str, Any]) -> Any:
        """What the effects add to the resistance."""
        point = Point(x, u, sign)
        return sum((law.resist(point, own, *(self.values[key] for key in keys))
                    for law, keys in self.effects), 0.0)  # fmt: skip

    def accelerate(self, x: Lanes, u: Lanes, pull: Lanes, sign: int) -> Lanes:
        """The acceleration [m/s²] while it moves in a direction."""
        v = self.values
        friction = sign * v[COULOMB] + v[VISCOUS] * u + self.add_effects(x, u, sign, v)
        return (pull - friction) / v[MASS]

    def find_direction(self, x: Lanes, pull: Lanes) -> int:
        """Which way an axis at rest starts; 0: it sticks."""
        v = self.values
        stuck = {**v, COULOMB: v[BREAKAWAY]}
        for sign in (1, -1):
            resisting = sign * v[BREAKAWAY] + self.add_effects(x, 0 * x, sign, stuck)
            if sign * (pull - resisting)[0].real > 0:
                return sign
        return 0

    def advance(self, x: Lanes, u: Lanes, pull: Lanes, sign: int, h: Any) -> tuple:
        """One Runge-Kutta step of a time h in one direction."""
        a1 = self.accelerate(x, u, pull, sign)
        u2 = u + h / 2 * a1
        a2 = self.accelerate(x + h / 2 * u, u2, pull, sign)
        u3 = u + h / 2 * a2
        a3 = self.accelerate(x + h / 2 * u2, u3, pull, sign)
        u4 = u + h * a3
        a4 = self.accelerate(x + h * u3, u4, pull, sign)
        return x + h / 6 * (u + 2 * u2 + 2 * u3 + u4), u + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def step_motion(
    setup: AxisSetup, force: NDArray, time: NDArray, position: float, speed: float
) -> AxisTrajectory:
    """Return the motion under forces (n,) held from their times (n,) on, with derivatives by all
    parameters of the set-up, and by the first position and speed."""
    laws, n = SteppedLaws(setup), len(time)
    lanes = len(laws.names)
    x, u = np.full(lanes, position, complex), np.full(lanes, speed, complex)
    x[-2] += 1j * _TINY
    u[-1] += 1j * _TINY
    delay = laws.values.get(_DELAY, np.zeros(lanes, complex))
    xs, us = np.empty((lanes, n), complex), np.empty((lanes, n), complex)
    events: list[tuple[str, float]] = []
    sign = 0 if speed == 0 else (1 if speed > 0 else -1)
    for k in range(n):
        xs[:, k], us[:, k] = x, u
        if k == n - 1:
            break
        for begin, pull, h in _split_hold(k, force, time, delay):
            x, u, sign, seen = _hold(laws, x, u, sign, pull + laws.values[OFFSET], h)
            events += [(kind, begin + when) for kind, when in seen]
    by = {name: np.imag(xs[i]) / _TINY for i, name in enumerate(laws.names)}
    by_speed = {name: np.imag(us[i]) / _TINY for i, name in enumerate(laws.names)}
    return AxisTrajectory(time, np.real(xs[0]), np.real(us[0]), by, by_speed, tuple(events))


def _split_hold(k: int, force: NDArray, time: NDArray, delay: Lanes) -> list[tuple]:
    """(time of its begin, force, lasting (lanes,)) of each force that acts from sample k on: more
    than one where the motion answers late."""
    begin, end = time[k], time[k + 1]
    if delay[0] == 0 and not np.imag(delay).any():
        return [(begin, force[k], end - begin + 0 * delay)]
    first = int(np.searchsorted(time, begin - delay[0].real, side="right")) - 1
    parts, at, j = [], begin + 0 * delay, max(first, -1)
    while at[0].real < end:
        until = end + 0 * delay
        if j + 1 < len(time) and time[j + 1] + delay[0].real < end:
            until = time[j + 1] + delay
        parts.append((at[0].real, force[max(j, 0)] if j >= 0 else force[0], until - at))
        at, j = until, j + 1
    return parts


def _hold(
    laws: SteppedLaws,
    x: Lanes,
    u: Lanes,
    sign: int,
    pull: Lanes,
    h: Lanes,
) -> tuple[Lanes, Lanes, int, list[tuple[str, float]]]:
    """The state after a force that is held for a time h (lanes,), and the events on the way."""
    left, seen = h, []
    for _ in range(8):  # a sample has hardly ever more than two events
        if sign == 0:
            sign = laws.find_direction(x, pull)
            if sign == 0:
                return x, 0 * u, 0, seen
            if not seen:
                seen.append(("break-away", float((h - left)[0].real)))
                u = 0 * u
        x1, u1 = laws.advance(x, u, pull, sign, left)
        if sign * u1[0].real > 0 or left[0].real <= 0:
            return x1, u1, sign, seen
        tau = _find_rest(laws, x, u, pull, sign, left)
        x, _ = laws.advance(x, u, pull, sign, tau)
        u, left = 0 * u, left - tau
        before, sign = sign, laws.find_direction(x, pull)
        when = float((h - left)[0].real)
        if sign == 0:
            seen.append(("stick", when))
            # Rest is rest: where the moment moved with a parameter the position stays.
            return x, u, 0, seen
        seen.append(("reversal" if sign != before else "stick", when))
        if sign == before:
            return x, u, 0, seen
    return x, u, sign, seen


def _find_rest(
    laws: SteppedLaws,
    x: Lanes,
    u: Lanes,
    pull: Lanes,
    sign: int,
    h: Lanes,
) -> Lanes:
    """The time (lanes,) after which the speed is zero, in a bracket; exact in its derivatives."""
    low, high = 0.0, float(h[0].real)
    first = laws.accelerate(x, u, pull, sign)[0].real
    tau = -u[0].real / first if sign * first < 0 else high / 2
    for _ in range(60):
        tau = tau if low < tau < high else (low + high) / 2
        at, speed = laws.advance(x, u, pull, sign, tau)
        value = sign * speed[0].real
        low, high = (tau, high) if value > 0 else (low, tau)
        slope = sign * laws.accelerate(at, speed, pull, sign)[0].real
        if abs(value) < 1e-17 or high - low < 1e-18 or slope == 0:
            break
        tau -= value / slope
    tau = min(max(tau, 0.0), float(h[0].real))
    at, speed = laws.advance(x, u, pull, sign, tau)
    slope = laws.accelerate(at, speed, pull, sign)
    slope = np.where(np.real(slope) == 0, 1.0, slope)
    return tau - 1j * np.imag(speed / slope)
