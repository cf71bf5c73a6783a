"""Recordings as means over blocks that are short beside an event and long elsewhere.

A diagnosis follows many models through all samples. What an effect does to a push is sharp where
contact begins, is lost or the pusher stops, and smooth in between: there blocks of samples lose
nothing, if the model is averaged over them as the samples were.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.traces import AFTER, BEFORE
from difffric.measurements.noise import Noise
from difffric.measurements.recordings import Channel, Recording
from difffric.measurements.reduction.reduce import Reduced

GROWTH = 0.15
"""Of a block's distance to the nearest event: its length at most."""
LONGEST = 1e-3
"""Of a block while the part moves [s]; at rest five times as long."""
FASTEST = 0.4
"""Radians of the contact's own oscillation that a block lasts at most: two points then give the
model's mean over it to 1e-5 of its swing."""
ROOM = 512
"""Blocks are padded to this, or to twice, four times as many: few shapes, few compilations."""


class Blocks(NamedTuple):
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


def blocks_of(
    channel: Channel | None,
    noise: Noise | None,
    events: Sequence[float],
    beside: Sequence[float],
    rest: float,
    end: float,
    longest: float,
) -> Blocks:
    """One channel from shortly before the push to `end` [s].

    `events` [s] are where blocks are short, `beside` [s] those beside which samples are left
    out; from `rest` [s] on nothing moves; `longest` [s] bounds a block until then.
    """
    if channel is None or noise is None:
        none = np.zeros(0)
        return Blocks(none, none.astype(int), none.astype(int), none, none, none, np.zeros(()))
    t, y = channel.between(-BEFORE, end)
    keep = np.ones(len(t), bool)
    for event in beside:
        keep &= np.abs(t - event) > 1.01 * channel.dt
    t, y = t[keep], y[keep]
    starts = _starts(t, channel.dt, np.sort([x for x in events if np.isfinite(x)]), rest, longest)
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
    a, b = _whitening(t, starts, sizes, channel.dt, noise)
    return Blocks(instants, first, second, means, a, b, np.asarray(float(len(t))))


def _starts(t, dt, events, rest, longest) -> NDArray:
    """Indices at which blocks begin."""
    starts, i, n = [], 0, len(t)
    most, idle = max(1, int(longest / dt)), max(1, int(5 * LONGEST / dt))
    while i < n:
        starts.append(i)
        ahead = np.searchsorted(events, t[i] - 0.5 * dt)
        before = t[i] - events[ahead - 1] if ahead else np.inf
        after = events[ahead] - t[i] if ahead < len(events) else np.inf
        still = t[i] > rest or (ahead == 0 and after > 5 * LONGEST)
        cap = idle if still else most
        size = int(min(cap, GROWTH * before / dt, max(GROWTH * after / dt, 1.0)))
        size = max(1, size)
        # No block reaches over samples that were left out.
        stop = min(i + size, n)
        whole = np.flatnonzero(np.diff(t[i:stop]) > 1.5 * dt)
        i = i + int(whole[0]) + 1 if len(whole) else stop
    return np.array(starts)


def _whitening(t, starts, sizes, dt, noise: Noise) -> tuple[NDArray, NDArray]:
    """The map to independent residuals: AR(1) noise averaged over blocks is nearly AR(1) again,
    with these variances and correlations of neighbours."""
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


def _ends(recording: Recording, reduced: Reduced) -> float:
    channels = [c for c in (recording.force, recording.position) if c is not None]
    last = min(c.start + c.n * c.dt for c in channels)
    return last if np.isnan(reduced.rest_time) else min(last, reduced.rest_time + AFTER)


def stacked_blocks(
    recordings: Sequence[Recording],
    details: Sequence[Reduced],
    strokes: NDArray,
    frequency: float,
) -> tuple[Blocks, Blocks]:
    """Force and position of n pushes, padded and stacked.

    `strokes` (n,) [m]; `frequency` [rad/s] is the contact's own.
    """
    longest = min(LONGEST, FASTEST / frequency)
    rows = []
    for r, x, stroke in zip(recordings, details, strokes, strict=True):
        stop = stroke / r.velocity
        beside = [e for e in (0.0, stop, *x.onsets, *x.jumps) if np.isfinite(e)]
        events = [*beside, x.release_time]
        rest = x.rest_time if np.isfinite(x.rest_time) else np.inf
        end = _ends(r, x)
        given = events, beside, rest, end, longest
        rows.append(
            (
                blocks_of(r.force, x.noise_force, *given),
                blocks_of(r.position, x.noise_position, events, (), rest, end, longest),
            )
        )
    both = [row[0] for row in rows], [row[1] for row in rows]
    m = ROOM
    while m < max(len(p.y) for parts in both for p in parts):
        m *= 2
    first, second = (stacked(parts, m, 2 * m) for parts in both)
    return first, second


def stacked(parts: Sequence[Blocks], m: int, e: int) -> Blocks:
    """Pushes' blocks padded to m, at e instants; what is beyond is cut off."""

    def padded(x, size, last=False):
        x = x[:size]
        out = np.zeros(size, x.dtype)
        out[: len(x)] = x
        if last and len(x):
            out[len(x) :] = x[-1]
        return out

    def fields_of(p: Blocks) -> list:
        fit = min(m, int(np.searchsorted(p.second, e)))
        return [padded(p.t, e, last=True), *(padded(x[:fit], m) for x in p[1:6]), p.samples]

    fields = [fields_of(p) for p in parts]
    return Blocks(*(np.stack(column) for column in zip(*fields, strict=True)))
