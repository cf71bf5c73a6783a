"""The motion of a plain axis, run by run: linear recursions between exact events.

Between two events the equation is affine, so that a run of one sign is a linear recursion over its
samples, for the derivatives likewise; its end, where the speed is zero, has a closed form.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from difffric.axis.motion.trajectory import SPEED, START, AxisTrajectory
from difffric.axis.setup import BREAKAWAY, COULOMB, MASS, OFFSET, VISCOUS

DIRECTIONS = (MASS, COULOMB, VISCOUS, OFFSET, START, SPEED)
"""What a plain axis' motion is differentiated by; by the break-away force it is zero or a jump."""


@dataclass(frozen=True)
class Hold:
    """How speed and position answer to a force that is held for a time h, and the derivatives of
    these answers by the rate k_v / m."""

    keep: Any
    """share of the speed that is kept"""
    gain: Any
    """speed by acceleration, and path by speed [s]"""
    path: Any
    """path by acceleration [s²]"""


def make_hold(rate: Any, h: Any) -> Hold:
    """Return the answers over a time h [s] of an axis that forgets its speed at `rate` [1/s].

    Either may be complex.
    """
    z = rate * h
    if abs(z) < 1e-2:  # series: the closed form cancels there
        first = 1 - z / 2 * (1 - z / 3 * (1 - z / 4 * (1 - z / 5 * (1 - z / 6 * (1 - z / 7)))))
        second = 1 - z / 3 * (1 - z / 4 * (1 - z / 5 * (1 - z / 6 * (1 - z / 7 * (1 - z / 8)))))
        return Hold(1 - z * first, h * first, h * h / 2 * second)
    keep = np.exp(-z)
    gain = (1 - keep) / rate
    return Hold(keep, gain, (h - gain) / rate)


_TINY = 1e-30
"""Imaginary part by which an analytic function tells its derivative, to the last digit."""


class _RunState:
    """Position and speed with their derivatives along `DIRECTIONS`."""

    def __init__(self, position: float, speed: float):
        self.x, self.u = position, speed
        self.dx, self.du = np.zeros(len(DIRECTIONS)), np.zeros(len(DIRECTIONS))
        self.dx[DIRECTIONS.index(START)] = 1.0
        self.du[DIRECTIONS.index(SPEED)] = 1.0


def follow_runs(
    values: Mapping[str, float], F: NDArray, t: NDArray, h: float, x: float, u: float
) -> AxisTrajectory:
    """Return the motion under forces (n,) at times (n,) that lie h apart, from a position x [m] and
    a speed u [m/s]."""
    n = len(t)
    pull, stick = F + values[OFFSET], values[BREAKAWAY]
    xs, us = np.empty(n), np.empty(n)
    dxs, dus = np.zeros((len(DIRECTIONS), n)), np.zeros((len(DIRECTIONS), n))
    state, events = _RunState(x, u), []
    laws = _Laws(values, h)
    k, sign = 0, 0 if u == 0 else int(math.copysign(1, u))
    starts = np.flatnonzero(np.abs(pull) > stick)
    while k < n:
        if sign == 0:
            later = int(np.searchsorted(starts, k))
            end = int(starts[later]) if later < len(starts) else n
            xs[k:end], us[k:end] = state.x, 0.0
            dxs[:, k:end] = state.dx[:, None]
            if end == n:
                break
            k, sign = end, int(math.copysign(1, pull[end]))
            events.append(("break-away", float(t[end])))
            state.u = 0.0
            state.du[:] = 0.0
        end = _fill_run(laws, pull, k, sign, state, xs, us, dxs, dus)
        if end >= n - 1:
            break
        k, sign, kind, when = _end_run(laws, pull[end], end, sign, state, stick)
        events.append((kind, float(t[end] + when)))
    names = DIRECTIONS
    zero = np.zeros(n)
    by = {name: dxs[i] for i, name in enumerate(names)} | {BREAKAWAY: zero}
    by_speed = {name: dus[i] for i, name in enumerate(names)} | {BREAKAWAY: zero}
    return AxisTrajectory(t, xs, us, by, by_speed, tuple(events))


class _Laws:
    """The constants of the equation, and what a whole sample's hold does."""

    def __init__(self, values: Mapping[str, float], h: float):
        self.m, self.F_c, self.k_v = values[MASS], values[COULOMB], values[VISCOUS]
        self.rate, self.h = self.k_v / self.m, h
        self.d_rate = np.zeros(len(DIRECTIONS))
        self.d_rate[DIRECTIONS.index(MASS)] = -self.k_v / self.m**2
        self.d_rate[DIRECTIONS.index(VISCOUS)] = 1 / self.m
        self.hold, self.slope = self.differentiate(h)

    def differentiate(self, h: float) -> tuple[Hold, Hold]:
        """What a hold of h does, and its derivatives by the rate."""
        z = make_hold(complex(self.rate, _TINY), h)
        parts = [z.keep, z.gain, z.path]
        return Hold(*(x.real for x in parts)), Hold(*(x.imag / _TINY for x in parts))

    def accelerate(self, pull: Any, sign: int) -> Any:
        """The acceleration without viscous friction [m/s²]."""
        return (pull - sign * self.F_c) / self.m

    def slope_of(self, i: int, acceleration: Any, sign: int) -> Any:
        """Its derivative along a direction."""
        name = DIRECTIONS[i]
        if name == MASS:
            return -acceleration / self.m
        if name == COULOMB:
            return -sign / self.m + 0 * acceleration
        return 1 / self.m + 0 * acceleration if name == OFFSET else 0 * acceleration


_FIRST_PIECE = 128
"""Samples that a run is followed at first before its end is looked for; then twice as many."""


def _fill_run(
    laws: _Laws,
    pull: NDArray,
    k: int,
    sign: int,
    state: _RunState,
    xs: NDArray,
    us: NDArray,
    dxs: NDArray,
    dus: NDArray,
) -> int:
    """Fill in a run that begins in `state` at sample k; return the last sample before it ends, at
    which `state` is left."""
    n, size, at, u = len(pull), _FIRST_PIECE, k, state.u
    hold, speeds = laws.hold, [np.array([state.u])]
    end = n - 1
    while at < n - 1:
        piece = pull[at : min(at + size, n - 1)]
        a = laws.accelerate(piece, sign)
        later = lfilter([hold.gain], [1.0, -hold.keep], a, zi=np.array([hold.keep * u]))[0]
        ended = np.flatnonzero(sign * later <= 0)
        if len(ended):
            end = at + int(ended[0])
            speeds.append(later[: ended[0]])
            break
        speeds.append(later)
        at, u, size = at + len(piece), float(later[-1]), 2 * size
    speed = np.concatenate(speeds)
    used, a = speed[:-1], laws.accelerate(pull[k:end], sign)
    xs[k] = state.x
    xs[k + 1 : end + 1] = state.x + np.cumsum(used * hold.gain + a * hold.path)
    us[k : end + 1] = speed
    gain, keep, slope = hold.gain, hold.keep, laws.slope
    for i in range(len(DIRECTIONS)):
        da, dr = laws.slope_of(i, a, sign), laws.d_rate[i]
        dxs[i, k], dus[i, k] = state.dx[i], state.du[i]
        if end > k:
            push = gain * da + dr * (slope.keep * used + slope.gain * a)
            later = lfilter([1.0], [1.0, -keep], push, zi=np.array([keep * state.du[i]]))[0]
            dus[i, k + 1 : end + 1] = later
            steps = dus[i, k:end] * gain + da * hold.path
            steps = steps + dr * (used * slope.gain + a * slope.path)
            dxs[i, k + 1 : end + 1] = state.dx[i] + np.cumsum(steps)
    state.x, state.u = float(xs[end]), float(us[end])
    state.dx, state.du = dxs[:, end].copy(), dus[:, end].copy()
    return end


def _end_run(
    laws: _Laws, pull: float, end: int, sign: int, state: _RunState, stick: float
) -> tuple[int, int, str, float]:
    """Take a run that ends within sample `end` to the next sample: (that, sign, kind of the event,
    its time after the sample)."""
    a = laws.accelerate(pull, sign)
    left = laws.h
    z = -laws.rate * state.u / a if a else 0.0
    tau = 0.0 if a == 0 else (math.log1p(z) / laws.rate if abs(z) > 1e-9 else -state.u / a)
    tau = min(max(tau, 0.0), laws.h)
    _move(laws, state, a, sign, tau)
    falls = a - laws.rate * state.u
    after = 0 if abs(pull) <= stick else int(math.copysign(1, pull))
    slopes = state.du
    state.u = 0.0
    if after == 0 or falls == 0:
        state.du = np.zeros_like(slopes)
        return end + 1, 0, "stick", tau
    # The moment of rest shifts with the parameters: by -du / a, from which the new run begins.
    b = laws.accelerate(pull, after)
    state.du = slopes * b / falls
    _move(laws, state, b, after, left - tau)
    return end + 1, after, "reversal", tau


def _move(laws: _Laws, state: _RunState, a: float, sign: int, h: float) -> None:
    """Take a state through a part of a sample."""
    hold, slope = laws.differentiate(h)
    x, u, dx, du = state.x, state.u, state.dx, state.du
    da = np.array([float(laws.slope_of(i, a, sign)) for i in range(len(DIRECTIONS))])
    state.x = x + u * hold.gain + a * hold.path
    state.u = u * hold.keep + a * hold.gain
    state.dx = dx + du * hold.gain + da * hold.path
    state.dx = state.dx + laws.d_rate * (u * slope.gain + a * slope.path)
    state.du = du * hold.keep + da * hold.gain + laws.d_rate * (u * slope.keep + a * slope.gain)
