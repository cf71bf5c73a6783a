"""What `residuals` asks of the model, by plain NumPy: all pushes at once and nothing compiled.

It serves where `simulation.columns` does; whole recordings, where every law is affine. Only the
coordinates that move are differentiated: a push's own mu_s alone costs a fraction of what a whole
Jacobian does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.compute import arrays as xp
from difffric.compute.dual_numbers import Dual, new_level, split
from difffric.compute.lanes import pick_lanes
from difffric.estimation.coordinates import START, names, rig_at, to_value
from difffric.estimation.residuals import (
    TRACE_CYCLES,
    Grid,
    Rows,
    SlidePush,
    TablePush,
    TracePush,
    set_stroke,
)
from difffric.rig.rig import Rig
from difffric.simulation.column_traces import ColumnTraces, follow_columns
from difffric.simulation.columns import observe_columns
from difffric.simulation.oscillator import ViscousSlide
from difffric.simulation.stepping.stepped_legs import SteppedLegs


def respond_in_columns(rig: Rig, pushes: Any, coordinates: NDArray, moving: Sequence[int]) -> Rows:
    """What n pushes answer at their coordinates (n, K): the rows of `pushes.respond`, stacked.

    `moving` are the indices of the coordinates that the rows are differentiated by, in ascending
    order; the others' columns are zeros.
    """
    moved = _Moved(rig, coordinates, list(moving))
    with np.errstate(all="ignore"):  # what is no number is refused by the search
        return _KINDS[type(pushes)](pushes, moved)


class _Moved:
    """A rig whose numbers are columns of n pushes, dual along the coordinates that move."""

    def __init__(self, base: Rig, coordinates: NDArray, moving: list[int]):
        self.base, self.coordinates, self.moving = base, coordinates, moving
        self.n, self.level = len(coordinates), new_level()
        self.columns: list[Any] = [_share(column) for column in coordinates.T]
        for step, j in zip(np.eye(len(moving)), moving, strict=True):
            self.columns[j] = Dual(self.columns[j], step[:, None], self.level)

    def rig(self, strokes: Any = None) -> Rig:
        """The rig, with each push's stroke [m] if it has any."""
        rig = rig_at(self.base, self.columns)
        return rig if strokes is None else set_stroke(rig, _share(np.asarray(strokes, float)))

    @property
    def start(self) -> Any:
        """The start offset [s] of each push."""
        return to_value(START, self.columns[names(self.base).index(START)])

    def split(self, y: Any) -> tuple[NDArray, NDArray]:
        """(value (n,), derivatives (moving, n)) of a column."""
        value, slope = split(y, self.level)
        shape = len(self.moving), self.n
        return np.broadcast_to(value, (self.n,)), np.broadcast_to(
            0.0 if slope is None else slope, shape
        )

    def join(self, jacobian: NDArray, r: NDArray) -> NDArray:
        """Rows (n, m, K + 1) from derivatives (moving, n, m) and residuals (n, m)."""
        rows = np.zeros((*r.shape, self.coordinates.shape[1] + 1))
        rows[..., self.moving] = np.moveaxis(jacobian, 0, -1)
        rows[..., -1] = r
        return rows


def _share(column: NDArray) -> Any:
    """One number for all pushes where it is the same: it is then computed with once."""
    return column[0] if (column == column[0]).all() else column


def _respond_table(pushes: TablePush, moved: _Moved) -> Rows:
    """F_p and d; a distance that does not exist counts as 0."""
    seen = observe_columns(moved.rig(pushes.stroke), np.asarray(pushes.velocity, float))
    F_p, dF = moved.split(seen.peak_force)
    d, dd = moved.split(seen.sliding_distance)
    model = np.stack([F_p, d], axis=1)
    measured = np.asarray(pushes.measured, float)
    there = ~np.isnan(measured)
    r = np.where(there, measured - np.where(np.isnan(model), 0.0, model), 0.0)
    jacobian = -np.stack([dF, dd], axis=2) * (there & ~np.isnan(model))
    return Rows(
        moved.join(np.nan_to_num(jacobian, nan=0.0), r), model, np.full((moved.n, 1), np.inf)
    )


def _respond_slides(pushes: SlidePush, moved: _Moved) -> Rows:
    """The distances of free slides."""
    at = moved.rig()
    v: Any = np.asarray(pushes.release_velocity, float)
    if at.affine:
        slid = ViscousSlide(-at.free(0.0), -xp.slope(at.free, *moved.columns)).rest(v)[1]
    else:
        slid = SteppedLegs().follow_free(at, 0.0, v, 0.0, np.inf, may_catch=False).slid
    d, dd = moved.split(slid)
    measured = np.asarray(pushes.measured, float)
    there = ~np.isnan(measured)
    r = np.where(there, measured - d[:, None], 0.0)
    model = np.stack([np.full(moved.n, np.nan), d], axis=1)
    return Rows(moved.join(-dd[:, :, None] * there, r), model, np.full((moved.n, 1), np.inf))


def _respond_traces(pushes: TracePush, moved: _Moved) -> Rows:
    """Every sample of force and position, as the triangular factor of [J | r] of each channel."""
    speed = np.asarray(pushes.velocity, float)
    traces = follow_columns(moved.rig(pushes.stroke), speed, moved.n, TRACE_CYCLES)
    force, position = pushes.force, pushes.position
    if position.t is None:
        both = force._replace(a=np.maximum(force.a, position.a))
        read = _read_channels(traces, moved, both)
    else:
        read = (
            _read_channels(traces, moved, force)[0],
            _read_channels(traces, moved, position)[1],
        )
    factors = [
        _factorise(_compare(force, read[0], centred=False)),
        _factorise(_compare(position, read[1], centred=True)),
    ]
    size = moved.coordinates.shape[1] + 1
    rows, columns = np.zeros((moved.n, 2, size, size)), np.array([*moved.moving, size - 1])
    for channel, factor in enumerate(factors):
        rows[:, channel, : len(columns), columns] = np.moveaxis(factor, 2, 0)
    seen = traces.observables
    model = np.stack([moved.split(y)[0] for y in (seen.peak_force, seen.sliding_distance)], axis=1)
    start = moved.split(moved.start)[0]
    return Rows(rows.reshape(moved.n, 2 * size, size), model, traces.starts + start[:, None])


def _read_channels(traces: ColumnTraces, moved: _Moved, grid: Grid) -> tuple[NDArray, NDArray]:
    """The model's force and position at the times of a grid, as far as samples are kept: each
    (moving + 1, n, samples), derivatives first."""
    t = np.asarray(grid.t)
    n, length = t.shape
    kept = np.asarray(grid.a) > 0
    # The mean of the last block that is kept asks for the value beyond it.
    beyond = np.where(kept.any(axis=1), length + 1 - np.argmax(kept[:, ::-1], axis=1), 0)
    where = np.flatnonzero(np.arange(length) < beyond[:, None])
    index = where // length
    time = t.ravel()[where] - pick_lanes(moved.start, index)
    found = traces.read(index, time, moved.level, len(moved.moving))
    out = np.zeros((2, len(moved.moving) + 1, n * length))
    for channel, (value, slope) in zip(out, (found[:2], found[2:]), strict=True):
        channel[:-1, where], channel[-1, where] = slope, value
    force, position = out.reshape(2, -1, n, length)
    return force, position


def _compare(grid: Grid, read: NDArray, centred: bool) -> NDArray:
    """Measured less model, averaged over blocks and made independent, and its derivatives before
    it: (moving + 1, n, samples). `centred`: less what an unknown zero can explain."""
    curve = np.asarray(grid.curve)[:, None]
    r = -read
    r[..., 1:-1] -= curve * (read[..., :-2] - 2 * read[..., 1:-1] + read[..., 2:])
    r[-1] += grid.y
    a, b, before = np.asarray(grid.a), np.asarray(grid.b), np.asarray(grid.before)
    r = a * r - b * np.take_along_axis(r, before[None], axis=2)
    if centred:
        one = a - b
        norm = np.sum(one**2, axis=1)
        share = np.einsum("nt,knt->kn", one, r) / np.where(norm > 0, norm, 1.0)
        r -= one * share[..., None]
    return r


def _factorise(r: NDArray) -> NDArray:
    """The triangular factors (n, k, k) of k columns (k, n, samples), with no negative diagonal, so
    that they are continuous."""
    k, n, _ = r.shape
    R = np.zeros((n, k, k))
    for j in range(k):  # modified Gram-Schmidt, as accurate as Householder's for the factor alone
        size = np.sqrt(np.einsum("nt,nt->n", r[j], r[j]))
        q = r[j] / np.where(size > 0, size, 1.0)[:, None]
        R[:, j, j:] = np.einsum("nt,knt->nk", q, r[j:])
        r[j + 1 :] -= q * R[:, j, j + 1 :].T[:, :, None]
    return R


_KINDS: dict[type, Callable[[Any, _Moved], Rows]] = {
    TablePush: _respond_table,
    SlidePush: _respond_slides,
    TracePush: _respond_traces,
}
