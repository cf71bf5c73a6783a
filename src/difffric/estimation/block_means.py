"""Recordings as means over blocks of samples, whitened, padded and stacked for a fit.

Two kinds, for the two engines of fits:

* `stack_even` makes blocks of one length on an even grid, as a calibration takes them: it follows
  few models through many samples, and corrects a block's mean by the second difference.
* `stack_uneven` makes blocks that are short beside an event and long elsewhere, as a diagnosis
  takes them: it follows many models. What an effect does to a push is sharp where contact begins,
  is lost or the pusher stops, and smooth in between; there blocks lose nothing, if the model is
  averaged over them as the samples were.

They differ in more than the blocks' lengths: an even channel is read a piece at a time, and its
noise is AR(1) again, across gaps too; that of uneven blocks is so only nearly, from neighbour to
neighbour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.residuals import Grid, TracePush
from difffric.measurements.noise import Noise, make_whitening
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.measurements.reduction.reduce import Reduced

MOST_BLOCKS = 2048
"""Even blocks that a channel is aimed at: more would cost time and say little more."""
_SLOW = 0.2
"""Radians of the fastest oscillation that an even block may last: its mean is then exact to 1e-6
of the block's curvature, once the second difference is taken care of."""
BEFORE, AFTER = 0.02, 0.03
"""Quiet time and rest that are kept [s]: they hold the position's zero, and the end."""

_GROWTH = 0.15
"""The longest that an uneven block may be, over its distance to the nearest event."""
LONGEST = 1e-3
"""The longest uneven block [s] while the part moves; at rest it is five times as long."""
_FASTEST = 0.4
"""Radians of the contact's own oscillation that an uneven block lasts at most: two points then
give the model's mean over it to 1e-5 of its swing."""
_ABOUT = 5.5
"""Samples before and after a bend of the force that are each a block of their own. The mean over a
bend is not that of two points, and a model's bend is not quite where the measured one is."""
_BEND_ERROR = 0.02
"""By how much two points then miss the mean, over the change of slope times the block's length."""
_UNSEEN = 0.1
"""Such an error, over the noise of the block's mean, that does not matter."""
_ROOM = 1024
"""Uneven blocks are padded to this, or to twice, four times as many: nearly all recordings then
share one shape and one program."""


@dataclass(frozen=True)
class EvenBlocks:
    """n recordings in even blocks, stacked as `residuals.TracePush` takes them, with what a fit
    asks about their noise."""

    pushes: TracePush
    levels: NDArray
    """(n, 2) standard deviation of a block mean of force [N] and position [m]"""
    counts: NDArray
    """(n, 2) block means kept"""
    left_out: int
    """block means left out because they lie beside a jump"""


def choose_block_size(channel: Channel, fastest: float, duration: float) -> int:
    """How many samples an even block may hold without losing anything that oscillates at up to
    `fastest` [rad/s], over `duration` [s] of a channel."""
    wanted = int(np.ceil(duration / channel.dt / MOST_BLOCKS))
    return max(1, min(wanted, int(_SLOW / fastest / channel.dt)))


def average_blocks(channel: Channel, t_0: float, t_1: float, size: int) -> tuple[NDArray, NDArray]:
    """Times [s] and means of whole blocks of `size` samples between two times [s]. The channel is
    read a piece at a time, so that a long recording needs no more memory than a short one."""
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


def stack_even(
    recordings: Recordings,
    details: Sequence[Reduced],
    strokes: NDArray,
    fastest: float,
    jumps: NDArray | None = None,
    guard: float = 0.0,
) -> EvenBlocks:
    """All recordings in even blocks, on grids of one padded length.

    `strokes` (n,) [m]; `fastest` [rad/s] bounds the contact's oscillation. Force samples within a
    sample (a block and a half for block means) and `guard` [s] of a jump are left out: of t = 0,
    of the stroke's end, and of `jumps` (n, any) [s], which a model knows better.
    """
    ends = [_find_end(r, x) for r, x in zip(recordings, details, strict=True)]
    made = []
    for i, (r, x, end) in enumerate(zip(recordings, details, ends, strict=True)):
        known = [0.0, strokes[i] / r.velocity] if jumps is None else [0.0, *jumps[i]]
        beside = np.array([t for t in known if np.isfinite(t)])
        row = []
        for channel, noise in ((r.force, x.noise_force), (r.position, x.noise_position)):
            if channel is None or noise is None:
                row.append(None)
                continue
            size = choose_block_size(channel, fastest, min(-channel.start, BEFORE) + end)
            t, y = average_blocks(channel, -BEFORE, end, size)
            keep = np.ones(len(t), bool)
            if channel is r.force:
                reach = (1.0 if size == 1 else 1.5 * size) * channel.dt + guard
                keep = (np.abs(t[:, None] - beside) > reach).all(axis=1)
            row.append((t, y, keep, noise.average(size), size, channel.dt * size))
        made.append(row)
    longest = max(len(c[0]) for row in made for c in row if c is not None)
    length = int(2 ** np.ceil(np.log2(max(longest, 256))))
    if 3 * length // 4 >= longest:
        length = 3 * length // 4
    columns = [[_make_grid(row[j], length) for row in made] for j in range(2)]
    same = all(
        f is not None and x is not None and len(f[0]) == len(x[0]) and np.allclose(f[0], x[0])
        for f, x in made
    )
    grids = [
        Grid(*map(np.stack, zip(*(grid[:-1] for grid in column), strict=True)))
        for column in columns
    ]
    if same:
        grids[1] = grids[1]._replace(t=None)
    levels = np.array([[1.0 if c is None else c[3].level for c in row] for row in made])
    kept = np.array([[0 if c is None else c[2].sum() for c in row] for row in made])
    total = sum(len(c[0]) for row in made for c in row if c is not None)
    return EvenBlocks(
        pushes=TracePush(np.array([r.velocity for r in recordings]), np.asarray(strokes), *grids),
        levels=levels,
        counts=kept,
        left_out=int(total - kept.sum()),
    )


def _make_grid(
    made: tuple[NDArray, NDArray, NDArray, Noise, int, float] | None, length: int
) -> Grid:
    """One channel's grid, padded to `length`, from (times, means, which to keep, noise of a mean,
    samples of a block, a block's length [s]); an absent channel is a grid of nothing."""
    zeros = np.zeros(length)
    if made is None:
        return Grid(zeros, zeros, zeros, zeros, np.zeros(length, int), np.zeros(()))
    t, y, keep, noise, size, step = made
    out = {name: zeros.copy() for name in "yab"}
    n = len(t)
    out["y"][:n] = y
    kept = np.flatnonzero(keep)
    map_ = make_whitening(kept, Noise(1.0, noise.correlation))
    out["a"][kept], out["b"][kept] = map_.scale, map_.back
    before = np.zeros(length, int)
    before[kept[1:]] = kept[:-1]
    first = t[0] if n else 0.0
    curve = np.asarray((1.0 - 1.0 / size**2) / 24.0)
    return Grid(first + step * np.arange(length), out["y"], out["a"], out["b"], before, curve)


class UnevenBlocks(NamedTuple):
    """One channel of one push: m block means, which a model meets at e instants.

    The model's mean over block i is that of its values at `t[first[i]]` and `t[second[i]]` (Gauss'
    two points; one instant for a single sample). Whitened residuals are
    `a_i r_i - b_i r_{i-1}`: independent, of unit variance. Padding has a = b = 0.
    """

    t: NDArray
    """(e,) [s] from the start of the pusher's motion"""
    first: NDArray
    second: NDArray
    """(m,) indices of instants"""
    y: NDArray
    """(m,) [N] or [m]"""
    a: NDArray
    b: NDArray
    """(m,)"""
    samples: NDArray
    """(): how many samples all blocks hold"""
    doubt: NDArray | None = None
    """(m, any) as of `residuals.Grid`"""


def make_uneven(
    channel: Channel | None,
    noise: Noise | None,
    events: Sequence[float],
    beside: Sequence[float],
    rest: float,
    end: float,
    longest: float,
    bends: Sequence[float] | NDArray = (),
) -> UnevenBlocks:
    """One channel in uneven blocks, from shortly before the push to `end` [s].

    `events` [s] are where blocks are short, `beside` [s] those beside which samples are left
    out; from `rest` [s] on nothing moves; `longest` [s] bounds a block until then. No block
    reaches over one of the `bends` [s].
    """
    if channel is None or noise is None:
        none = np.zeros(0)
        return UnevenBlocks(
            none, none.astype(int), none.astype(int), none, none, none, np.zeros(())
        )
    t, y = channel.between(-BEFORE, end)
    keep = np.ones(len(t), bool)
    for event in beside:
        keep &= np.abs(t - event) > 1.01 * channel.dt
    t, y = t[keep], y[keep]
    known = np.sort([x for x in events if np.isfinite(x)])
    starts = _choose_starts(t, channel.dt, known, rest, longest, np.sort(bends))
    sizes = np.diff(np.append(starts, len(t)))
    means = np.add.reduceat(y, starts) / sizes
    middle = 0.5 * (t[starts] + t[starts + sizes - 1])
    # Half the distance of two points whose values have the block's mean, to fourth order.
    reach = channel.dt * np.sqrt((sizes**2 - 1) / 12.0)
    single = sizes == 1
    first = np.cumsum(np.where(single, 1, 2)) - np.where(single, 1, 2)
    second = first + ~single
    instants = np.empty(second[-1] + 1)
    instants[first], instants[second] = middle - reach, middle + reach
    a, b = _whiten_neighbours(t, starts, sizes, channel.dt, noise)
    return UnevenBlocks(instants, first, second, means, a, b, np.asarray(float(len(t))))


def _choose_starts(
    t: NDArray, dt: float, events: NDArray, rest: float, longest: float, bends: NDArray
) -> NDArray:
    """The indices of the samples at `t` [s] at which uneven blocks begin."""
    starts, i, n = [], 0, len(t)
    most, idle = max(1, int(longest / dt)), max(1, int(5 * LONGEST / dt))
    while i < n:
        starts.append(i)
        ahead = np.searchsorted(events, t[i] - 0.5 * dt)
        before = t[i] - events[ahead - 1] if ahead else np.inf
        after = events[ahead] - t[i] if ahead < len(events) else np.inf
        still = t[i] > rest or (ahead == 0 and after > 5 * LONGEST)
        cap = idle if still else most
        size = int(min(cap, _GROWTH * before / dt, max(_GROWTH * after / dt, 1.0)))
        coming = np.searchsorted(bends, t[i] - _ABOUT * dt)
        if coming < len(bends):
            size = min(size, int((bends[coming] - t[i]) / dt - _ABOUT))
        size = max(1, size)
        # No block reaches over samples that were left out.
        stop = min(i + size, n)
        whole = np.flatnonzero(np.diff(t[i:stop]) > 1.5 * dt)
        i = i + int(whole[0]) + 1 if len(whole) else stop
    return np.array(starts)


def _whiten_neighbours(
    t: NDArray, starts: NDArray, sizes: NDArray, dt: float, noise: Noise
) -> tuple[NDArray, NDArray]:
    """The factors a, b of `UnevenBlocks` that make residuals independent: AR(1) noise averaged
    over blocks is nearly AR(1) again, with these variances and correlations of neighbours."""
    phi = noise.correlation
    level = noise.level / np.sqrt([noise.effective(int(n)) for n in sizes])
    rho = np.zeros(len(starts))
    if phi:
        last = starts[:-1] + sizes[:-1] - 1
        gap = np.maximum(np.round((t[starts[1:]] - t[last]) / dt), 1)
        n_0, n_1 = sizes[:-1], sizes[1:]
        shared = (1 - phi**n_0) * (1 - phi**n_1) / ((1 - phi) ** 2 * n_0 * n_1)
        power = np.sign(phi) ** gap * np.abs(phi) ** gap
        rho[1:] = noise.level**2 * power * shared / (level[:-1] * level[1:])
    scale = 1.0 / np.sqrt(1 - rho**2)
    before = np.concatenate([level[:1], level[:-1]])
    return scale / level, rho * scale / before


def stack_uneven(
    recordings: Sequence[Recording],
    details: Sequence[Reduced],
    strokes: NDArray,
    frequency: float,
    bends: Sequence[tuple[NDArray, NDArray]] | None = None,
) -> tuple[UnevenBlocks, UnevenBlocks]:
    """Force and position of n pushes in uneven blocks, padded and stacked.

    `strokes` (n,) [m]; `frequency` [rad/s] is the contact's own; `bends` are, for each push, when
    a model's force bends [s] and by how much [N/s]: no block reaches over what the noise shows.
    """
    longest = min(LONGEST, _FASTEST / frequency)
    rows = []
    of_each = bends or [(np.zeros(0), np.zeros(0))] * len(recordings)
    for r, x, stroke, (times, by) in zip(recordings, details, strokes, of_each, strict=True):
        stop = stroke / r.velocity
        beside = [e for e in (0.0, stop, *x.onsets, *x.jumps) if np.isfinite(e)]
        events = [*beside, *x.partings, x.release_time]
        rest = x.rest_time if np.isfinite(x.rest_time) else np.inf
        end = _find_end(r, x)
        given = events, beside, rest, end, longest
        seen = np.zeros(len(times), bool)
        if r.force is not None and x.noise_force is not None:
            level = x.noise_force.level / np.sqrt(longest / r.force.dt)
            seen = _BEND_ERROR * np.abs(by) * longest > _UNSEEN * level
        rows.append(
            (
                make_uneven(r.force, x.noise_force, *given, times[seen]),
                make_uneven(r.position, x.noise_position, events, (), rest, end, longest),
            )
        )
    both = [row[0] for row in rows], [row[1] for row in rows]
    m = _ROOM
    while m < max(len(p.y) for parts in both for p in parts):
        m *= 2
    first, second = (pad_uneven(parts, m, 2 * m) for parts in both)
    return first, second


def pad_uneven(parts: Sequence[UnevenBlocks], m: int, e: int) -> UnevenBlocks:
    """Pushes' blocks padded to m, at e instants, and stacked; what is beyond is cut off."""

    def pad(x: NDArray, size: int, last: bool = False) -> NDArray:
        x = x[:size]
        out = np.zeros(size, x.dtype)
        out[: len(x)] = x
        if last and len(x):
            out[len(x) :] = x[-1]
        return out

    def pad_fields(p: UnevenBlocks) -> list:
        fit = min(m, int(np.searchsorted(p.second, e)))
        return [pad(p.t, e, last=True), *(pad(x[:fit], m) for x in p[1:6]), p.samples]

    fields = [pad_fields(p) for p in parts]
    return UnevenBlocks(*(np.stack(column) for column in zip(*fields, strict=True)))


def _find_end(recording: Recording, reduced: Reduced) -> float:
    """The time [s] at which the samples stop to say anything."""
    channels = [c for c in (recording.force, recording.position) if c is not None]
    last = min(c.start + c.n * c.dt for c in channels)
    return last if np.isnan(reduced.rest_time) else min(last, reduced.rest_time + AFTER)
