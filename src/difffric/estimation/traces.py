"""Recordings ready for a fit: whitened block means on even grids, what lies beside jumps out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.residuals import Grid, TracePush
from difffric.measurements.noise import Noise, whitening
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.measurements.reduction.reduce import Reduced

MOST = 2048
"""Block means a channel aimed at: more samples would cost time and say little more."""
SLOW = 0.2
"""Radians of the fastest oscillation that a block may last: its mean is then exact to 1e-6 of
the block's curvature, once the second difference is taken care of."""
BEFORE, AFTER = 0.02, 0.03
"""Quiet time and rest that are kept [s]: they hold the position's zero, and the end."""


@dataclass(frozen=True)
class Traces:
    """n recordings as `TracePush` takes them, stacked, with what a fit asks about their noise."""

    pushes: TracePush
    levels: NDArray
    """(n, 2) standard deviation of a block mean of force [N] and position [m]"""
    counts: NDArray
    """(n, 2) block means kept"""
    left_out: int
    """block means left out because they lie beside a jump"""


def block_size(channel: Channel, fastest: float, duration: float) -> int:
    """Samples that a block mean takes without losing anything that oscillates at up to
    `fastest` [rad/s]."""
    wanted = int(np.ceil(duration / channel.dt / MOST))
    return max(1, min(wanted, int(SLOW / fastest / channel.dt)))


def block_means(channel: Channel, t_0: float, t_1: float, size: int) -> tuple[NDArray, NDArray]:
    """(times, means) of whole blocks between two times [s], read a chunk at a time."""
    lo = max(0, int(np.ceil((t_0 - channel.start) / channel.dt - 1e-9)))
    hi = min(channel.n, int(np.floor((t_1 - channel.start) / channel.dt + 1e-9)) + 1)
    n = max((hi - lo) // size, 0)
    step = max((1 << 20) // size, 1)
    parts = [
        channel.read(lo + i * size, lo + min(i + step, n) * size).reshape(-1, size).mean(axis=1)
        for i in range(0, n, step)
    ]
    means = np.concatenate(parts) if parts else np.zeros(0)
    return channel.start + channel.dt * (lo + size * np.arange(n) + 0.5 * (size - 1)), means


def stacked_traces(
    recordings: Recordings,
    details: Sequence[Reduced],
    strokes: NDArray,
    fastest: float,
    jumps: NDArray | None = None,
    guard: float = 0.0,
) -> Traces:
    """All recordings on grids of one padded length.

    `fastest` [rad/s] bounds the contact's oscillation. Force samples within a sample (a block
    and a half for block means) and `guard` [s] of a jump are left out: of t = 0, of the stroke's
    end, and of `jumps` (n, any) [s], which a model knows better.
    """
    ends = [_end(r, x) for r, x in zip(recordings, details, strict=True)]
    made = []
    for i, (r, x, end) in enumerate(zip(recordings, details, ends, strict=True)):
        known = [0.0, strokes[i] / r.velocity] if jumps is None else [0.0, *jumps[i]]
        beside = np.array([t for t in known if np.isfinite(t)])
        row = []
        for channel, noise in ((r.force, x.noise_force), (r.position, x.noise_position)):
            if channel is None or noise is None:
                row.append(None)
                continue
            size = block_size(channel, fastest, min(-channel.start, BEFORE) + end)
            t, y = block_means(channel, -BEFORE, end, size)
            keep = np.ones(len(t), bool)
            if channel is r.force:
                reach = (1.0 if size == 1 else 1.5 * size) * channel.dt + guard
                keep = (np.abs(t[:, None] - beside) > reach).all(axis=1)
            row.append((t, y, keep, noise.averaged(size), size, channel.dt * size))
        made.append(row)
    longest = max(len(c[0]) for row in made for c in row if c is not None)
    length = int(2 ** np.ceil(np.log2(max(longest, 256))))
    if 3 * length // 4 >= longest:
        length = 3 * length // 4
    columns = [[_padded(row[j], length) for row in made] for j in range(2)]
    same = all(
        f is not None and x is not None and len(f[0]) == len(x[0]) and np.allclose(f[0], x[0])
        for f, x in made
    )
    grids = [Grid(*map(np.stack, zip(*column, strict=True))) for column in columns]
    if same:
        grids[1] = grids[1]._replace(t=None)
    kept = np.array([[0 if c is None else c[2].sum() for c in row] for row in made])
    total = sum(len(c[0]) for row in made for c in row if c is not None)
    return Traces(
        pushes=TracePush(np.array([r.velocity for r in recordings]), np.asarray(strokes), *grids),
        levels=np.array([[1.0 if c is None else c[3].level for c in row] for row in made]),
        counts=kept,
        left_out=int(total - kept.sum()),
    )


def _end(recording: Recording, reduced: Reduced) -> float:
    """Where the samples stop to say anything [s]."""
    channels = [c for c in (recording.force, recording.position) if c is not None]
    last = min(c.start + c.n * c.dt for c in channels)
    return last if np.isnan(reduced.rest_time) else min(last, reduced.rest_time + AFTER)


def _padded(made, length: int) -> Grid:
    """One channel's grid, padded; an absent channel is a grid of nothing."""
    zeros = np.zeros(length)
    if made is None:
        return Grid(zeros, zeros, zeros, zeros, np.zeros(length, int), np.zeros(()))
    t, y, keep, noise, size, step = made
    out = {name: zeros.copy() for name in "yab"}
    n = len(t)
    out["y"][:n] = y
    kept = np.flatnonzero(keep)
    map_ = whitening(kept, Noise(1.0, noise.correlation))
    out["a"][kept], out["b"][kept] = map_.scale, map_.back
    before = np.zeros(length, int)
    before[kept[1:]] = kept[:-1]
    first = t[0] if n else 0.0
    curve = np.asarray((1.0 - 1.0 / size**2) / 24.0)
    return Grid(first + step * np.arange(length), out["y"], out["a"], out["b"], before, curve)
