"""A recorded tip's motion, smoothed: what drives a push whose set-up asks for the recorded pusher.

A cubic spline on even knots, with a kink of its own wherever the acceleration jumps, is fitted to
the samples of the channel `pusher` by least squares. The number of knots, and with it the bandwidth
below which the motion is followed, is that of the least expected error (AICc).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from difffric.errors import InputError
from difffric.measurements.noise import estimate_quiet_noise
from difffric.measurements.quantities import gather_alike, join_problems, shorten_to_line
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.number_text import format_number
from difffric.rig.pusher import RecordedMotion
from difffric.units import to_mm_min, to_um

INTERVALS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
"""Even intervals between knots that are tried."""
_FINER = 2
"""Places further in this list there are twice as many."""
MOST_KINKS = 4
"""Jumps of the acceleration that are looked for: a ramp has one, a trapezium three."""
PIECES = INTERVALS[-1] + MOST_KINKS + 1
"""Pieces that every motion is padded to, so that one program follows all pushes."""
_DEGREE = 3
"""Of the spline: its speed is of second degree, and has no corner but at a kink."""
_KINK = 20.0
"""The chi-square that a kink must explain: noise alone does so once in a thousand motions."""
_APART = 3.0
"""Samples between two kinks at least."""
_PLACES = 240
"""Places at which a kink is looked for."""
_ROWS = 1024
"""Moving samples beyond which neighbours are averaged: more would only take longer."""
_FEWEST = 16
"""Samples of its way that a tip must have."""
_PER_COEFFICIENT = 4
"""Samples for each coefficient of the spline at least."""
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
    """[Hz] half the knots that there are in a second"""
    kinks: tuple[float, ...]
    """when the acceleration jumps [s]"""
    variance: tuple[float, float, float]
    """mean over the motion of the variance of y [m^2], of V [m^2/s^2], and their covariance"""
    memory: float
    """over which the errors of y and V are one [s]: the motion's time a coefficient"""

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
    splines = _fit_splines(way)
    best = min(range(len(splines)), key=lambda i: splines[i].criterion)
    return _describe(way, splines[best], splines[min(best + _FINER, len(splines) - 1)])


class _Way(NamedTuple):
    """A tip's way, as a spline takes it: rows of (time, position, weight)."""

    t: NDArray
    y: NDArray
    weight: NDArray
    """1 / standard deviation [1/m]"""
    end: float
    travel: float
    noise: float
    dt: float


def _find_way(recording: Recording) -> _Way:
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
    end = _find_stop(t[: last + 1], y[: last + 1], level, noise, dt)
    inside = t < end
    size = -(-int(inside.sum()) // _ROWS)
    n = int(inside.sum()) // size * size
    rows_t, rows_y = (x[:n].reshape(-1, size).mean(axis=1) for x in (t, y))
    return _Way(
        t=np.concatenate([[0.0], rows_t, [end]]),
        y=np.concatenate([[0.0], rows_y, [level]]),
        weight=np.sqrt([len(quiet), *np.full(len(rows_t), size), standing]) / noise,
        end=end,
        travel=level,
        noise=noise,
        dt=dt * size,
    )


def _measure_noise(channel: Channel) -> float:
    """Standard deviation of a sample [m], as large as if samples were independent."""
    return float(estimate_quiet_noise(channel).average(_LEVEL).level * np.sqrt(_LEVEL))


def _find_stop(t: NDArray, y: NDArray, level: float, noise: float, dt: float) -> float:
    """When the tip comes to where it stands [s]: where a line through its last samples before meets
    that level, near the first sample that is there but for the noise."""
    most = max(_FEWEST, int(_STRAIGHT / dt))
    some = slice(max(len(t) - 1 - most, 0), len(t) - 1)
    slope, offset = np.polyfit(t[some] - t[-1], y[some], 1)
    if slope <= 0:
        return float(t[-1])
    late = 2 * dt + 1.5 * _ARRIVED * noise / slope
    return float(t[-1] + np.clip((level - offset) / slope, -2 * dt, late))


def _check_speed(way: _Way, velocity: float) -> None:
    speed = way.travel / way.end
    if not velocity / _OTHER_UNIT < speed < velocity * _OTHER_UNIT:
        raise InputError(
            f"pusher went at {to_mm_min(speed):.4g} mm/min, its command was "
            f"{to_mm_min(velocity):.4g} mm/min: is the channel's unit right?"
        )


class _Spline(NamedTuple):
    """A fitted spline."""

    knots: NDArray
    kinks: tuple[float, ...]
    coefficients: NDArray
    covariance: NDArray
    criterion: float

    def design(self, t: NDArray, slope: bool = False) -> NDArray:
        """What each coefficient adds to y, or to V, at the times t [s]."""
        return _design(self.knots, self.kinks, t, slope)


def _design(knots: NDArray, kinks: Sequence[float], t: NDArray, slope: bool) -> NDArray:
    beyond = np.maximum(t[:, None] - np.asarray(kinks, float)[None], 0.0)
    if not slope:
        even = BSpline.design_matrix(t, knots, _DEGREE).toarray()
        return np.column_stack([even, beyond**2])
    unit = np.eye(len(knots) - _DEGREE - 1)
    return np.column_stack([BSpline(knots, unit, _DEGREE).derivative()(t), 2 * beyond])


def _fit_splines(way: _Way) -> list[_Spline]:
    """A spline of each number of intervals that the samples allow."""
    most = len(way.t) / _PER_COEFFICIENT
    return [_fit_spline(way, n) for n in INTERVALS if n == 1 or n + _DEGREE <= most]


def _fit_spline(way: _Way, intervals: int) -> _Spline:
    """The spline of so many even intervals, with the kinks that it needs."""
    ends = np.zeros(_DEGREE), np.full(_DEGREE, way.end)
    knots = np.concatenate([ends[0], np.linspace(0, way.end, intervals + 1), ends[1]])
    places = np.linspace(0, way.end, _PLACES + 2)[1:-1]
    places = places[(places > 2 * way.dt) & (places < way.end - 2 * way.dt)]
    bends = way.weight[:, None] * np.maximum(way.t[:, None] - places, 0.0) ** 2
    y, kinks = way.weight * way.y, list[float]()
    while True:
        A = way.weight[:, None] * _design(knots, kinks, way.t, False)
        Q, R = np.linalg.qr(A)
        r = y - Q @ (Q.T @ y)
        if len(kinks) >= MOST_KINKS or not len(places):
            break
        new = bends - Q @ (Q.T @ bends)
        size = np.sum(new**2, axis=0)
        known = size > 1e-9 * np.sum(bends**2, axis=0)
        for kink in kinks:
            known &= np.abs(places - kink) > _APART * way.dt
        gain = np.where(known, (r @ new) ** 2 / np.where(known, size, 1.0), 0.0)
        if gain.max() < _KINK:
            break
        kinks = sorted([*kinks, float(places[int(np.argmax(gain))])])
    n, p = A.shape[0], A.shape[1] + len(kinks)  # where a kink lies is found, too
    chi2 = float(r @ r)
    inverse = np.linalg.pinv(R)
    wide = max(1.0, chi2 / max(n - p, 1))
    criterion = chi2 + 2 * p + 2 * p * (p + 1) / max(n - p - 1, 1e-3)
    coefficients = inverse @ (Q.T @ y)
    return _Spline(knots, tuple(kinks), coefficients, wide * inverse @ inverse.T, criterion)


def _describe(way: _Way, spline: _Spline, finer: _Spline) -> SmoothedMotion:
    """The motion that a spline is. What it smooths away besides the noise is not in its covariance:
    its error is told as that of a `finer` one, which smooths away next to nothing else."""
    corners = np.unique(np.concatenate([spline.knots[_DEGREE : -_DEGREE - 1], spline.kinks]))
    ends = np.append(corners[1:], way.end)
    shares = np.array([0.25, 0.5, 0.75])
    inside = corners[:, None] + (ends - corners)[:, None] * shares
    V = (spline.design(inside.ravel(), slope=True) @ spline.coefficients).reshape(inside.shape)
    rates = np.zeros((PIECES + 1, 3))
    for i, (start, at, speed) in enumerate(zip(corners, inside, V, strict=True)):
        rates[i] = np.linalg.solve(np.vander(at - start, 3, increasing=True), speed)
    padded = np.full(PIECES + 1, np.inf)
    padded[: len(corners)] = corners
    t = np.linspace(0, way.end, 200)
    B, dB = finer.design(t), finer.design(t, slope=True)
    pairs = ((B, B), (dB, dB), (B, dB))
    y, speed, both = (float(np.mean(np.sum((a @ finer.covariance) * b, 1))) for a, b in pairs)
    intervals = len(spline.knots) - 2 * _DEGREE - 1
    return SmoothedMotion(
        law=RecordedMotion(padded, rates, way.end),
        travel=way.travel,
        noise=way.noise,
        bandwidth=0.5 * intervals / way.end,
        kinks=spline.kinks,
        variance=(y, speed, both),
        memory=way.end / len(finer.coefficients),
    )
