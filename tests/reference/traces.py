"""Force and position of one push at many times at once: `exact`'s solution in numpy.

`exact` finds the events, in floats; here each mode's closed form is written down once more, from
its state at the mode's start, for an array of times. All numbers are in SI units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.reference import exact


@dataclass(frozen=True)
class Course:
    """One push of the plain model, to be evaluated at any times."""

    answer: exact.Result
    m: float
    mu_s: float
    ratio: float
    k_v: float
    k: float
    b: float
    v: float
    stroke: float | None

    @property
    def peak_force(self) -> float:
        return self.answer.peak_force

    @property
    def sliding_distance(self) -> float | None:
        return self.answer.sliding_distance

    @property
    def regime(self) -> str | None:
        return self.answer.regime

    @property
    def contacts(self) -> int:
        return self.answer.contacts

    @property
    def end(self) -> float:
        """When all is at rest; infinity where that never comes."""
        last = self.answer.segments[-1]
        return last.start if last.mode == "rest" else math.inf

    @property
    def jumps(self) -> np.ndarray:
        """When the force jumps by the damper: at t = 0, at each new contact, and where the pusher
        stops while it approaches."""
        states, segments = self.answer.states, self.answer.segments
        at = [0.0]
        for before, state, segment in zip(states, states[1:], segments, strict=False):
            caught = segment.mode in ("free", "waiting") and state.z == 0
            halted = before.moving and not state.moving and segment.mode in ("closing", "stuck")
            at += [state.t] * (caught or halted)
        return np.array(at)

    def __call__(self, times) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(contact force, part's position, pusher's travel) at times relative to t = 0, any
        before it included; at a jump, the values after it."""
        t = np.ravel(np.asarray(times, float))
        force, x, y = np.zeros((3, len(t)))
        starts = [state.t for state in self.answer.states]
        which = np.searchsorted(starts, t, side="right") - 1
        for i in np.unique(which[which >= 0]):
            here = which == i
            segment, state = self.answer.segments[i], self.answer.states[i]
            force[here], x[here], y[here] = self._mode(segment.mode, state, t[here] - state.t)
        shape = np.shape(times)
        return force.reshape(shape), x.reshape(shape), y.reshape(shape)

    def _mode(self, mode, s, t):
        m, k, k_v = self.m, self.k, self.k_v
        speed = self.v if s.moving else 0.0
        kinetic = self.ratio * self.mu_s * m * exact.GRAVITY
        y = s.x + s.z + speed * t
        if mode in ("closing", "rebounding"):
            b = self.b if mode == "closing" else 0.0
            z_steady = (kinetic + k_v * speed) / k
            q, w = _oscillation((b + k_v) / (2 * m), k / m, s.z - z_steady, speed - s.u, t)
            z = z_steady + q
            return b * w + k * z, y - z, y
        if mode == "stuck":
            return self.b * self.v + k * (s.z + speed * t), s.x, y
        if mode == "free":
            rate = k_v / m
            return 0.0, s.x + s.u * _decay1(rate, t) - kinetic / m * _decay2(rate, t), y
        return k * max(s.z, 0.0) if mode == "rest" else 0.0, s.x, y


def _oscillation(sigma, omega0_squared, s0, s1, t):
    """s(t) and s'(t) with s'' + 2 sigma s' + omega0^2 s = 0, s(0) = s0, s'(0) = s1.

    s = c (s0 cosh rt + (s1 + sigma s0) sinh(rt)/r) with c = exp(-sigma t) and
    r = sqrt(sigma^2 - omega0^2), real or imaginary.
    """
    r = np.sqrt(complex(sigma**2 - omega0_squared))
    slow = np.exp(-omega0_squared / (sigma + r) * t)  # exp((r - sigma) t), without cancellation
    fast = np.exp(-(sigma + r) * t)
    cosh = ((slow + fast) / 2).real
    near = abs(r) * t < 1e-3
    series = t * (1 + (r * t) ** 2 / 6 + (r * t) ** 4 / 120) * np.exp(-sigma * t)
    sinh = np.where(near, series, (slow - fast) / (2 * r if r else 1.0)).real
    s = s0 * cosh + (s1 + sigma * s0) * sinh
    return s, s1 * cosh - (omega0_squared * s0 + sigma * s1) * sinh


def _decay1(rate, t):
    """(1 - exp(-rate t)) / rate."""
    return -np.expm1(-rate * t) / rate if rate else t


def _decay2(rate, t):
    """(t - _decay1) / rate, by its power series where the difference would cancel."""
    a = rate * t
    series = np.zeros_like(a)
    for n in range(20, 1, -1):
        series = (1 - a * series) / n
    series = t**2 * series
    far = a > 0.5
    return np.where(far, (t - _decay1(rate, t)) / (rate or 1.0), series) if far.any() else series


def follow(m, mu_s, ratio, k_v, k, b, v, stroke=None, *, horizon=0.0) -> Course:
    """One push, its events found in floats. A push without stroke that never leaves is followed
    to `horizon` at least. Raises ValueError for more contacts than are followed."""
    rig = (m, mu_s, ratio, k_v, k, b, v, stroke)
    answer = exact.push(*rig, arithmetic=exact.FLOAT, horizon=horizon)
    if answer.too_many_contacts:
        raise ValueError(f"more than {exact.MAX_CONTACTS} contacts")
    return Course(answer, *rig)


def slide(m, mu_s, ratio, k_v, u) -> float:
    """Distance [m] of a free slide to rest that begins at the speed u: m u' = -F - k_v u."""
    F = ratio * mu_s * m * exact.GRAVITY
    rate = k_v / m
    t_rest = math.log1p(k_v * u / F) / rate if rate else m * u / F
    t = np.array(t_rest)
    return float(u * _decay1(rate, t) - F / m * _decay2(rate, t))
