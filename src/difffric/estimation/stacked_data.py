"""Measured pushes as a calibration takes them: stacked and padded, with the noise of each row.

`table_data`, `slides_data` and `traces_data` make `FitData` from the three kinds of data. One
padded shape serves many data sets with one compiled program. To add a kind, add a function here
and a class to `residuals`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.compute.pytrees import map_tree, pick
from difffric.errors import InputError
from difffric.estimation.block_means import stack_even
from difffric.estimation.coordinates import START, to_coordinate
from difffric.estimation.mixed_model import PADDING
from difffric.estimation.push_rigs import fill_strokes
from difffric.estimation.residuals import Grid, SlidePush, TablePush
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.measurements.reduction.reduce import Reduced
from difffric.rig import parameters
from difffric.rig.rig import Rig

TABLE, SLIDES, RECORDINGS = "table", "slides", "recordings"
"""The kinds of data."""


@dataclass(frozen=True)
class FitData:
    """n pushes of one kind, with m rows of residuals each."""

    kind: str
    pushes: Any
    """stacked, padded beyond n with copies of the first"""
    n: int
    weights: NDArray
    """(n, m) 1 / standard deviation where that is known, 1 where it belongs to a group, 0 where
    nothing was measured"""
    group: NDArray
    """(n, m) whose spread is to be estimated, -1: none's"""
    groups: tuple[str, ...]
    """`force`, `distance`"""
    counts: NDArray
    """(groups,) how many numbers a group has"""
    least: NDArray
    """(groups,) spreads below this are not looked for"""
    samples: int
    """how many numbers were measured in all"""
    guess: NDArray
    """(groups,) where the spreads start"""
    rough: NDArray
    """(n, m) weights for a first search, in which a model may be off by some per cent"""
    samples_of: Any = 1.0
    """(n,) how many numbers each push has"""
    left_out: int = 0
    in_few_steps: bool = False
    """whether a table is searched in so few steps that compiling a program takes longer"""
    worth: float = 0.0
    """what a step of a fit of recordings has to gain in chi-square"""
    start_bounds: tuple[NDArray, NDArray] | None = None
    """(n,) between which a push's own start offset lies, in coordinates: within what its recording
    holds; None: of a table"""


def pad(array: Any, n: int) -> Any:
    """An array, or a tree of arrays, with n entries along the first axis, padded with copies of the
    first entry up to the next multiple of `PADDING`."""
    whole = -(-n // PADDING) * PADDING
    index = np.concatenate([np.arange(n), np.zeros(whole - n, int)])
    return map_tree(lambda a: np.asarray(a)[index], array)


def find_strokes(rig: Rig, stroke: NDArray, motion: Any = None) -> tuple[Rig, NDArray]:
    """Each push's stroke [m], infinite without one; and the rig, which then has a stroke too
    wherever a push has one, and a recorded motion where the pushes have (stacked)."""
    own = rig.pusher.stroke
    strokes = fill_strokes(own, stroke)
    if motion is not None:
        return parameters.with_stroke(rig, pick(motion, 0)), np.asarray(stroke, float)
    if strokes is None:
        return rig, np.full(len(stroke), np.inf)
    return parameters.with_stroke(rig, np.inf if own is None else float(own)), strokes


def table_data(rig: Rig, pushes: Pushes, noise: Sequence[float | None]) -> tuple[Rig, FitData]:
    """A table's F_p and d, and the rig, with a stroke where a push has one.

    `noise` (force [N], distance [m]) stands in where a push gives no standard error; where it is
    None too, the spread is estimated with the rest.

    Raises `InputError` where nothing was measured.
    """
    rig, strokes = find_strokes(rig, pushes.stroke)
    measured = np.stack([pushes.peak_force, pushes.sliding_distance], axis=1)
    given = np.stack([pushes.peak_force_se, pushes.sliding_distance_se], axis=1)
    data = TablePush(pushes.velocity, strokes, measured)
    return rig, _add_noise(TABLE, data, measured, given, noise, ("force", "distance"))


def slides_data(rig: Rig, pushes: Pushes, noise: float | None) -> FitData:
    """Free slides: d from the release speed, whose error counts through dd/dv = 2 d / v.

    `noise` [m] stands in as in `table_data`. Raises `InputError` where nothing was measured.
    """
    d, v = pushes.sliding_distance, pushes.release_velocity
    through = np.nan_to_num(2 * d / v * pushes.release_velocity_se)
    own = np.where(
        np.isnan(pushes.sliding_distance_se), noise or np.nan, pushes.sliding_distance_se
    )
    given = np.hypot(own, through)
    data = SlidePush(v, d[:, None])
    return _add_noise(SLIDES, data, d[:, None], given[:, None], [None], ("distance",))


def _add_noise(
    kind: str,
    data: Any,
    measured: NDArray,
    given: NDArray,
    noise: Sequence[float | None],
    names: Sequence[str],
) -> FitData:
    """The data of n pushes with m measured numbers each (n, m).

    Their standard errors are those that are `given` (n, m), NaN where they are not, else `noise`
    (m,); where that is None the spread is to be estimated. `names` (m,) are the channels'.
    """
    n, m = measured.shape
    present = np.isfinite(measured)
    if not present.any():
        raise InputError("nothing was measured: expected peak forces or sliding distances")
    default = np.array([np.nan if x is None else x for x in noise])
    sd = np.where(np.isnan(given), default, given)
    open_ = present & np.isnan(sd)
    which = [j for j in range(m) if open_[:, j].any()]
    group = np.full((n, m), -1)
    least, guess = [], []
    for g, j in enumerate(which):
        group[open_[:, j], j] = g
        size = np.abs(measured[open_[:, j], j])
        least.append(1e-5 * size.max())
        guess.append(max(0.05 * np.std(size), 1e-3 * size.max()))
    known = np.where(open_ | ~present, 1.0, np.where(np.isnan(sd), 1.0, sd))
    rough = np.hypot(np.where(open_, 0.0, known), 0.05 * np.abs(np.where(present, measured, 1.0)))
    floor = 0.01 * np.max(np.abs(measured), axis=0, where=present, initial=0.0)
    rough = np.maximum(rough, np.where(open_, floor, 0.0))
    return FitData(
        kind=kind,
        pushes=pad(data, n),
        n=n,
        weights=present / known,
        group=group,
        groups=tuple(names[j] for j in which),
        counts=np.array([(group == g).sum() for g in range(len(which))], float),
        least=np.array(least),
        samples=int(present.sum()),
        guess=np.array(guess),
        rough=present / rough,
    )


def traces_data(
    rig: Rig,
    recordings: Recordings,
    details: Sequence[Reduced],
    fastest: float,
    coordinates: int,
    jumps: NDArray | None = None,
    guard: float = 0.0,
    motion: Any = None,
) -> tuple[Rig, FitData]:
    """Whole recordings, and the rig, with a stroke where one of them has one, or with the stacked
    `motion` that was recorded of the tips.

    A channel's samples come as `coordinates` + 1 rows of equal weight. `fastest` [rad/s], `jumps`
    (n, any) [s] and `guard` [s] are those of `block_means.stack_even`.
    """
    rig, strokes = find_strokes(rig, np.array([r.stroke for r in recordings]), motion)
    made = stack_even(recordings, details, strokes, fastest, jumps, guard)
    pushes = made.pushes if motion is None else made.pushes._replace(stroke=motion)
    weights = np.repeat(np.where(made.counts > 0, 1.0 / made.levels, 0.0), coordinates + 1, axis=1)
    n = len(recordings)
    none = np.zeros(0)
    return rig, FitData(
        kind=RECORDINGS,
        pushes=pad(pushes, n),
        n=n,
        weights=weights,
        group=np.full(weights.shape, -1),
        groups=(),
        counts=none,
        least=none,
        samples=int(made.counts.sum()),
        guess=none,
        rough=weights,
        samples_of=np.maximum(made.counts.sum(axis=1), 1),
        left_out=made.left_out,
        start_bounds=_bound_starts(recordings, details),
    )


def _bound_starts(recordings: Recordings, details: Sequence[Reduced]) -> tuple[NDArray, NDArray]:
    """(first, last) coordinates (n,) at which the pushers may have started: within the recording,
    and not after its peak. One that begins after t = 0 does not show the start: as much before as
    after t = 0 is allowed."""
    ends = []
    for recording, detail in zip(recordings, details, strict=True):
        channels = [c for c in (recording.force, recording.position) if c is not None]
        first = min(c.start for c in channels)
        last = max(c.start + c.dt * c.n for c in channels)
        first -= max(c.dt for c in channels)
        peak = detail.peak_time if np.isfinite(detail.peak_time) else last
        ends.append((-last if first > 0 else first, max(peak, first)))
    low, high = np.array(ends).T
    return to_coordinate(START, low), to_coordinate(START, high)


def as_if_white(data: FitData) -> FitData:
    """The data of recordings with samples that count as if their noise had no correlation."""

    def ignore_correlation(grid: Grid) -> Grid:
        return grid._replace(a=np.where(grid.a > 0, 1.0, 0.0), b=np.zeros_like(grid.b))

    force, position = data.pushes.force, data.pushes.position
    pushes = data.pushes._replace(
        force=ignore_correlation(force), position=ignore_correlation(position)
    )
    return replace(data, pushes=pushes)
