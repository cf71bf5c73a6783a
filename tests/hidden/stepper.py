"""One push by the compiled copy of the reference, with the laws of `forms` around its own.

It also notes when the contact force jumps, which samples beside it cannot be compared with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.hidden import compiled, forms

# The laws are in place now: the modules below take them as they are. The reference is far more
# accurate than any sensor: here 1e-10 will do, in a third of the time.
compiled.module("runge_kutta").TOLERANCE = 1e-13
events = compiled.module("effect_events")
law = compiled.module("jit").law
CONTACTS, JUMPS = events.CONTACTS, 20
STOPPED_AT = forms.SIZE
_touch, _stop = events.touch, events.stop


@law
def touch(t, s, p, mode, tally):
    _touch(t, s, p, mode, tally)
    p[STOPPED_AT + tally[CONTACTS]] = t


@law
def stop(t, s, p, mode, tally, loss):
    p[STOPPED_AT] = t
    _stop(t, s, p, mode, tally, loss)


events.touch, events.stop = touch, stop
effects = compiled.module("effects")
effects.SHARE_OF_PERIOD, effects.MAX_STEPS = 1 / 25, 100_000
prepare, integrate, as_read = forms.parameters.prepare, effects.integrate, effects.as_read
DELAY, PROBE, FIRST = forms.parameters.DELAY, forms.parameters.PROBE, forms.FIRST
PEAK, X_REST, X_LOSS, T_LOSS, T_REST = range(5)
REGIME, REASON = effects.REGIME, effects.REASON


@compiled.stored
def run(numbers, others, times):
    """Numbers, counts, read force and position at the times, the jumps; X_REST and X_LOSS are what
    the probe reads there but for its scale, PEAK is what the sensor reads."""
    p = np.full(FIRST + others.size + JUMPS, np.nan)
    p[:FIRST] = prepare(numbers)
    p[FIRST : FIRST + others.size] = others
    force, position, unused = (np.zeros(times.size), np.zeros(times.size), np.zeros(times.size))
    again = p.copy()  # where the jumps of the second pass go
    if p[DELAY] > 0:
        found, counts = integrate(p, times, force, unused)
        integrate(again, times - p[DELAY], unused, position)
        when, x, none = np.zeros(1), np.zeros(1), np.zeros(1)
        when[0] = found[T_LOSS] - p[DELAY]
        integrate(again, when, none, x)
        found[X_LOSS] = x[0]
    else:
        found, counts = integrate(p, times, force, position)
    for i in range(times.size):
        force[i] = as_read(force[i] if times[i] >= 0 else 0.0, p)
    found[PEAK] = as_read(found[PEAK], p)
    return found, counts, force, position, p[FIRST + others.size :]


@dataclass(frozen=True)
class Run:
    """One push as the sensors read it, but for noise. SI units."""

    peak_force: float
    left_at: float
    """read position at the loss of contact; NaN where the part rests in contact"""
    rests_at: float
    end: float
    """when all is at rest [s]"""
    regime: str
    contacts: int
    reason: str
    """why there is no answer; empty where there is one"""
    force: np.ndarray
    position: np.ndarray
    jumps: np.ndarray
    """when the contact force may jump [s]"""

    @property
    def sliding_distance(self) -> float:
        return self.rests_at - self.left_at


def follow(numbers: np.ndarray, others: np.ndarray, times: np.ndarray) -> Run:
    """A push from the reference's vector and the numbers of `forms`, at the times [s]."""
    found, counts, force, position, jumps = run(numbers, others, times)
    scale = numbers[PROBE]
    regime = effects.REGIMES[counts[REGIME]]
    return Run(
        peak_force=float(found[PEAK]),
        left_at=float(scale * found[X_LOSS]) if counts[REGIME] >= 2 else math.nan,
        rests_at=float(scale * found[X_REST]),
        end=float(found[T_REST]),
        regime=regime,
        contacts=int(counts[CONTACTS]),
        reason=effects.REASONS[counts[REASON]],
        force=force,
        position=scale * position,
        jumps=np.append(0.0, jumps[np.isfinite(jumps)]),
    )
