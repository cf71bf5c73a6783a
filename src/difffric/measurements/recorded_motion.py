"""A recorded tip's motion, smoothed: what drives a push whose set-up asks for the recorded pusher.

A smoothing spline with a kink wherever the acceleration jumps goes through the samples of the
channel `pusher` (`motion_splines`). How far it may be off is told as independent modes, each a
motion that may have to be added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.errors import InputError
from difffric.measurements.motion_splines import (
    INTERVALS,
    MOST_KINKS,
    Spline,
    Way,
    smooth_again,
    smooth_way,
)
from difffric.measurements.noise import estimate_quiet_noise
from difffric.measurements.quantities import gather_alike, join_problems, shorten_to_line
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.number_text import format_number
from difffric.rig.pusher import RecordedMotion
from difffric.units import to_mm_min, to_um

_FINER = 2
"""Places further in this list there are twice as many."""
MODES = 32
"""Ways in which a motion may be off that are carried: padded with none."""
_FINE = 400
"""Times at which a motion is looked at."""
_SUDDEN = 0.5
"""Of the mean speed: a tip that comes faster to where it stands is taken to stop at once."""
_ROUNDS, _SAME_END = 3, 1e-6
"""Times that the end is looked for again; a change of it, as a share, that is none."""
PIECES = INTERVALS[-1] + MOST_KINKS + 1
"""Pieces that every motion is padded to, so that one program follows all pushes."""
_ROWS = 1024
"""Moving samples beyond which neighbours are averaged: more would only take longer."""
_FEWEST = 16
"""Samples of its way that a tip must have."""
_LEVEL = 8
"""Samples whose mean says where the tip stands."""
_ARRIVED = 4.0
"""Standard deviations of the noise within which the tip has come to where it stands."""
_STRAIGHT = 5e-4
"""Time [s] before its stop over which the tip keeps its speed."""
_LEAST_NOISE = 1e-7
"""Of the travel: what is known better is rounding."""
_OTHER_UNIT = 3.0
"""A mean speed this many times the commanded one, or less than its share, is in another unit."""


@dataclass(frozen=True)
class SmoothedMotion:
    """One recorded motion of the tip, from t = 0 to where it stands."""

    law: RecordedMotion
    """padded to `PIECES`"""
    travel: float
    """how far the tip went [m]"""
    noise: float
    """standard deviation of a sample of the channel [m]"""
    bandwidth: float
    """[Hz] half the numbers that the samples determine in a second"""
    kinks: tuple[float, ...]
    """when the acceleration jumps [s]"""
    variance: tuple[float, float, float]
    """mean over the motion of the variance of y [m^2], of V [m^2/s^2], and their covariance"""
    memory: float
    """over which the errors of y and V are one [s]: the motion's time over the numbers that the
    samples determine"""
    modes: RecordedMotion
    """stacked changes of `law`, by which the motion may be off: independent, each a standard
    deviation"""

    @property
    def end(self) -> float:
        """When the tip stands [s]."""
        return float(self.law.end)

    def force_error(self, k: float, b: float) -> float:
        """Standard deviation [N] of the force k y + b V that the motion's error makes."""
        y, V, both = self.variance
        return float(np.sqrt(max(k * k * y + b * b * V + 2 * k * b * both, 0.0)))


def take_recorded_motion(data: Recordings, skip_bad: bool = False) -> Recordings:
    """The recordings, each with the motion of its own tip: `stroke` is then the travel that was
    recorded, and `velocity` the mean speed over it.

    With `skip_bad` pushes whose pusher cannot be used are left out and told in `.skipped`. Raises
    `InputError` naming the pushes without a channel `pusher`, and those whose channel says no
    motion.
    """
    found: list[Recording] = []
    problems: list[tuple[str, str]] = []
    for i, push in enumerate(data):
        try:
            smoothed = smooth_motion(push)
        except InputError as error:
            where = f"{data.source}: " if data.source else ""
            problems.append((f"{where}group {push.name or i + 1!r}", f": {error}"))
            continue
        found.append(
            replace(
                push,
                motion=smoothed,
                stroke=smoothed.travel,
                velocity=smoothed.travel / smoothed.end,
            )
        )
    if problems and not (skip_bad and found):
        raise InputError(join_problems(gather_alike(problems, len(data))))
    skipped = (shorten_to_line(place + words) for place, words in problems)
    return replace(data, pushes=tuple(found), skipped=(*data.skipped, *skipped))


def describe_motion(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A note of how the recorded motions were smoothed; none where none drives its push."""
    found = [r.motion for r in recordings if r.motion is not None]
    if not found:
        return ()
    bands = [x.bandwidth for x in found]
    ends = dict.fromkeys(format_number(x, 3) for x in (min(bands), max(bands)))
    noise = float(np.sqrt(np.mean([x.noise**2 for x in found])))
    speed = float(np.sqrt(np.mean([x.variance[1] for x in found])))
    kinks = sum(len(x.kinks) for x in found)
    jumps = "" if not kinks else f", with {kinks} jumps of acceleration"
    return (
        f"driven by the recorded pusher: {format_number(to_um(noise), 3)} µm of noise a sample, "
        f"smoothed to {' to '.join(ends)} Hz{jumps}; its speed is known to "
        f"{format_number(1e3 * speed, 3)} mm/s",
    )


def smooth_motion(recording: Recording) -> SmoothedMotion:
    """The motion of a recording's tip.

    Raises `InputError` for a recording without a channel `pusher`, one with samples that are no
    numbers, with too few of them, with a tip that does not start, move forwards and stand, or whose
    speed is far from the commanded one.
    """
    if recording.pusher is None:
        raise InputError('no channel pusher, which [pusher] motion = "recorded" asks for')
    way = _find_way(recording)
    _check_speed(way, recording.velocity)
    spline = smooth_way(way)
    for _ in range(_ROUNDS):
        end = _find_end(way, spline)
        if end == way.end:
            break
        way = _find_way(recording, end)
        spline = smooth_again(way, spline)
    return _describe(way, spline)


def _find_way(recording: Recording, end: float | None = None) -> Way:
    """The way of a recording's tip, up to its `end` [s] where that is known better than from its
    last samples."""
    channel = recording.pusher
    assert channel is not None
    t, y = channel.time, np.asarray(channel.samples, float)
    if not np.isfinite(y).all():
        raise InputError("pusher has samples that are no numbers")
    quiet, moving = y[t <= 0], t > 0
    if len(quiet) < _LEVEL or moving.sum() < _FEWEST:
        raise InputError(
            f"pusher has {len(quiet)} samples before t = 0 and {int(moving.sum())} after it: "
            f"expected {_LEVEL} and {_FEWEST} at least"
        )
    noise = _measure_noise(channel)
    start = float(np.mean(quiet))
    t, y = t[moving], y[moving] - start
    means = np.convolve(y, np.full(_LEVEL, 1.0 / _LEVEL), "valid")
    top = float(means.max())
    noise = max(noise, _LEAST_NOISE * abs(top))
    if top < 10 * noise:
        raise InputError("pusher does not move forwards")
    last = int(np.argmax(y >= top - _ARRIVED * noise))
    stands = np.abs(y[last:] - top) <= 1.5 * _ARRIVED * noise
    rest = len(stands) if stands.all() else int(np.argmin(stands))
    if rest < _LEVEL:
        raise InputError(
            f"pusher still moves where its recording ends, at {t[-1]:.4g} s: expected it to stand"
        )
    standing = rest - max(rest // 4, 1)  # the first of them may still be on their way
    level = float(np.mean(y[last + rest - standing : last + rest]))
    if last < _FEWEST:
        raise InputError(f"pusher has {last} samples of its way: expected {_FEWEST} at least")
    dt = channel.dt
    stop, slope = _find_stop(t[: last + 1], y[: last + 1], level, noise, dt)
    end = stop if end is None else float(np.clip(end, stop - 2 * dt, stop + 2 * dt))
    sudden = slope * end > _SUDDEN * level
    inside = t < end
    size = -(-int(inside.sum()) // _ROWS)
    n = int(inside.sum()) // size * size
    rows_t, rows_y = (x[:n].reshape(-1, size).mean(axis=1) for x in (t, y))
    rows = np.column_stack([rows_t, rows_y, np.full(len(rows_t), size)])
    first, last_row = [(0.0, 0.0, len(quiet))], [(end, level, standing)]
    rows = np.vstack([first, rows] if sudden else [first, rows, last_row])
    return Way(
        t=rows[:, 0],
        y=rows[:, 1],
        weight=np.sqrt(rows[:, 2]) / noise,
        end=end,
        travel=level,
        level_error=noise / float(np.sqrt(standing)),
        noise=noise,
        sudden=bool(sudden),
        dt=dt * size,
    )


def _find_end(way: Way, spline: Spline) -> float:
    """When the tip comes to where it stands [s], by a spline: that of the way where it comes there
    slowly."""
    if not way.sudden:
        return way.end
    at = np.array([way.end])
    y, V = (float((spline.design(at, x) @ spline.coefficients)[0]) for x in (False, True))
    late = (way.travel - y) / V if V > 0 else 0.0
    return way.end + late if abs(late) > _SAME_END * way.end else way.end


def _measure_noise(channel: Channel) -> float:
    """Standard deviation of a sample [m], as large as if samples were independent."""
    return float(estimate_quiet_noise(channel).average(_LEVEL).level * np.sqrt(_LEVEL))


def _find_stop(
    t: NDArray, y: NDArray, level: float, noise: float, dt: float
) -> tuple[float, float]:
    """(when the tip comes to where it stands [s], how fast [m/s]): where a line through its last
    samples before meets that level, near the first sample that is there but for the noise."""
    most = max(_FEWEST, int(_STRAIGHT / dt))
    some = slice(max(len(t) - 1 - most, 0), len(t) - 1)
    slope, offset = np.polyfit(t[some] - t[-1], y[some], 1)
    if slope <= 0:
        return float(t[-1]), 0.0
    late = 2 * dt + 1.5 * _ARRIVED * noise / slope
    return float(t[-1] + np.clip((level - offset) / slope, -2 * dt, late)), float(slope)


def _check_speed(way: Way, velocity: float) -> None:
    speed = way.travel / way.end
    if not velocity / _OTHER_UNIT < speed < velocity * _OTHER_UNIT:
        raise InputError(
            f"pusher went at {to_mm_min(speed):.4g} mm/min, its command was "
            f"{to_mm_min(velocity):.4g} mm/min: is the channel's unit right?"
        )


def _describe(way: Way, spline: Spline) -> SmoothedMotion:
    """The motion that a spline is, and how far it may be off."""
    corners = spline.corners
    ends = np.append(corners[1:], way.end)
    shares = np.array([0.25, 0.5, 0.75])
    inside = corners[:, None] + (ends - corners)[:, None] * shares

    def find_rates(V: NDArray) -> NDArray:
        """(pieces, 3, ...) the polynomials through speeds at three times of each piece."""
        powers = ((inside - corners[:, None])[..., None]) ** np.arange(3)
        return np.linalg.solve(powers, V.reshape(*inside.shape, -1))

    rates, padded = np.zeros((PIECES + 1, 3)), np.full(PIECES + 1, np.inf)
    rates[: len(corners)] = find_rates(spline.design(inside.ravel(), True) @ spline.coefficients)[
        ..., 0
    ]
    padded[: len(corners)] = corners
    t = (np.arange(_FINE) + 0.5) * way.end / _FINE
    changes, ends_late = _list_modes(way, spline, t)
    # The law begins at 0: only the way since then may be off.
    B = (spline.vary(t) - spline.vary(np.zeros(1))) @ changes
    dB = spline.vary(t, slope=True) @ changes
    y, speed, both = (float(np.mean(np.sum(a * b, 1))) for a, b in ((B, B), (dB, dB), (B, dB)))
    most = changes.shape[1]
    modes = np.zeros((MODES, PIECES + 1, 3))
    by = find_rates(spline.vary(inside.ravel(), True) @ changes)
    modes[:most, : len(corners)] = np.moveaxis(by, 2, 0)
    late: Any = np.zeros(MODES)
    late[:most] = ends_late
    return SmoothedMotion(
        law=RecordedMotion(padded, rates, way.end),
        travel=way.travel,
        noise=way.noise,
        bandwidth=0.5 * spline.freedom / way.end,
        kinks=spline.kinks,
        variance=(y, speed, both),
        memory=way.end / spline.freedom,
        modes=RecordedMotion(np.tile(padded, (MODES, 1)), modes, late),
    )


def _list_modes(way: Way, spline: Spline, t: NDArray) -> tuple[NDArray, NDArray]:
    """(changes of the spline's numbers (p, modes), of the end [s]) by which the motion may be off:
    independent, each a standard deviation, those that change the speed most at the times t."""
    values, vectors = np.linalg.eigh(spline.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    at = np.array([way.end])
    V = float((spline.design(at, True) @ spline.coefficients)[0])
    late = np.zeros(root.shape[1] + 1)
    if way.sudden:
        late = np.append(-(spline.vary(at) @ root)[0], way.level_error) / V
    root = np.column_stack([root, np.zeros(len(root))])
    # A later end is the speed for as much longer.
    seen = np.vstack([spline.vary(t, slope=True) @ root, np.sqrt(_FINE / way.end) * V * late])
    _, _, turned = np.linalg.svd(seen, full_matrices=False)
    turned = turned[:MODES].T
    return root @ turned, late @ turned
