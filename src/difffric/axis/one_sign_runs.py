"""Where an axis moves one way: runs, between its reversals and rests.

Within a run the friction keeps its sign, so that no event needs to be found in noisy positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from difffric.axis.recordings import AxisRecordings, AxisStretch


@dataclass(frozen=True)
class MeasuredMotion:
    """What the positions of a stretch say of its speed."""

    speed: NDArray
    """(n,) [m/s], by quadratics over a short window"""
    direction: NDArray
    """(n,) 1 forwards, -1 backwards, 0 at rest or too slow to tell"""
    half_window: int
    """samples on either side of one that its speed is made of"""
    force: NDArray
    """(n,) the drive's force, smoothed as the slope of that speed is [N]"""


@dataclass(frozen=True)
class OneSignRun:
    """Samples `first` to `last` (without) of a stretch, in which the axis moves one way."""

    stretch: int
    first: int
    last: int
    sign: int

    @property
    def samples(self) -> slice:
        """Its samples in the stretch."""
        return slice(self.first, self.last)


LONGEST_RUN = 3.0
"""Seconds: longer runs are cut, each piece with a free start; what a drift could say in more is
not worth what it costs."""
LONGEST_STRETCH = 5.0
"""Seconds after which a recording without stretches of its own is cut."""
_REST = 0.05
"""Seconds that a rest lasts at least where a recording is cut."""
_WINDOW = 0.01
"""Seconds to either side that a speed is made of, at first."""
_WIDEST = 0.1
"""Seconds to either side at most."""
_CLEAR = 6.0
"""Standard errors of a speed from which on its sign is certain."""
_SLOW = 0.004
"""Share of the usual speed below which the sign is not used: there friction has its kink."""
_STEADY = 0.25
"""Share of the usual speed from which on an imposed motion counts as sliding."""
_SHORTEST = 16
"""Samples of a run at least."""


def estimate_encoder_noise(position: NDArray) -> float:
    """Return the standard deviation of one sample's error, from third differences [m]."""
    third = np.diff(position, 3)
    middle = float(np.median(np.abs(third - np.median(third)))) / 0.6745
    return max(middle, 0.05 * float(np.std(third))) / np.sqrt(20.0)


def measure_motion(stretch: AxisStretch, noise: float) -> MeasuredMotion:
    """Return speed and direction over a stretch whose encoder has this noise [m]."""
    t, x = stretch.time, stretch.position
    step = float(np.median(np.diff(t)))
    even = np.arange(t[0], t[-1] + step / 2, step)
    is_even = len(even) == len(t) and np.allclose(even, t, rtol=0, atol=1e-3 * step)
    on_grid = x if is_even else np.interp(even, t, x)
    half = max(3, round(_WINDOW / step))
    while True:
        half = min(half, (len(even) - 1) // 2)
        speed = np.asarray(savgol_filter(on_grid, 2 * half + 1, 2, deriv=1, delta=step))
        error = noise / step * np.sqrt(3.0 / (half * (half + 1.0) * (2 * half + 1.0)))
        usual = float(np.quantile(np.abs(speed), 0.9))
        if _CLEAR * error < 0.1 * usual or half * step >= _WIDEST or 2 * half + 3 > len(even):
            break
        half = min(2 * half, max(half + 1, round(_WIDEST / step)))
    least = max(_CLEAR * error, _SLOW * usual)
    force = stretch.force if is_even else np.interp(even, t, stretch.force)
    once = np.cumsum(force - force.mean()) * step
    path = np.concatenate(([0.0], np.cumsum(once - np.diff(once, prepend=0.0) / 2)[:-1])) * step
    smooth = np.asarray(savgol_filter(path, 2 * half + 1, 2, deriv=1, delta=step))
    smooth = np.gradient(smooth, step) + force.mean()
    if not is_even:
        speed, smooth = np.interp(t, even, speed), np.interp(t, even, smooth)
    sign = np.where(np.abs(speed) > least, np.sign(speed), 0)
    return MeasuredMotion(speed, sign.astype(int), half, smooth)


def keep_fast(motions: Sequence[MeasuredMotion]) -> list[MeasuredMotion]:
    """Return the same motions, at rest where they are slower than `_STEADY` of the usual speed: for
    a motion that is imposed, whose slow parts say more of how friction builds up than of its
    level."""
    usual = float(np.quantile(np.abs(np.concatenate([m.speed for m in motions])), 0.9))
    return [
        replace(
            m, direction=np.where(np.abs(m.speed) > _STEADY * usual, m.direction, 0), half_window=0
        )
        for m in motions
    ]


def find_runs(
    data: AxisRecordings, motions: Sequence[MeasuredMotion], noise: float
) -> tuple[OneSignRun, ...]:
    """Return all runs that are long enough to say something, in order of time."""
    found = []
    for k, (stretch, motion) in enumerate(zip(data.stretches, motions, strict=True)):
        for first, last, sign in iterate_constant(motion.direction):
            a, b = first, last
            a += motion.half_window if first > 0 else 0
            b -= motion.half_window if last < len(stretch) else 0
            if sign == 0 or b - a < _SHORTEST:
                continue
            if abs(stretch.position[b - 1] - stretch.position[a]) < 30 * noise:
                continue
            duration = stretch.time[b - 1] - stretch.time[a]
            pieces = max(1, int(np.ceil(duration / LONGEST_RUN)))
            edges = np.linspace(a, b, pieces + 1).round().astype(int)
            found += [OneSignRun(k, int(i), int(j), sign) for i, j in pairwise(edges)]
    return tuple(found)


def cut_at_rests(data: AxisRecordings, motions: Sequence[MeasuredMotion]) -> list[AxisStretch]:
    """Return the stretches of a recording that says none: cut in the middle of each rest, and
    where one lasts longer than `LONGEST_STRETCH`, at the next change of direction."""
    found: list[AxisStretch] = []
    for stretch, motion in zip(data.stretches, motions, strict=True):
        t, cuts = stretch.time, [0]
        has_moved = False
        for first, last, sign in iterate_constant(motion.direction):
            if sign:
                turn = has_moved and t[first] - t[cuts[-1]] > LONGEST_STRETCH
                if turn and first > cuts[-1]:
                    cuts.append(first)
                has_moved = True
            elif has_moved and last < len(t) and t[last - 1] - t[first] >= _REST:
                cuts.append((first + last) // 2)
                has_moved = False
        cuts.append(len(t))
        for a, b in pairwise(cuts):
            found.append(
                AxisStretch(
                    str(len(found) + 1),
                    t[a:b],
                    stretch.force[a:b],
                    stretch.position[a:b],
                    stretch.condition,
                )
            )
    return found


def iterate_constant(values: NDArray) -> list[tuple[int, int, int]]:
    """Return (first, last without, value) of each piece in which the values (n,) stay the same."""
    edges = np.flatnonzero(np.diff(values)) + 1
    ends = [0, *edges.tolist(), len(values)]
    return [(a, b, int(values[a])) for a, b in pairwise(ends) if b > a]
