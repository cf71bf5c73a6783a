"""Whole recordings of many pushes by plain NumPy: force and position at every sample, with their
exact derivatives, where every law is affine.

The pushes are followed in columns as in `columns`; then each sample is found in the segment in
which it lies, and all samples of a mode are computed together.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.compute.dual_numbers import plain, split
from difffric.compute.lanes import join_lanes, pick_lanes, put_lanes, spread
from difffric.rig.rig import Rig
from difffric.simulation.closed_form import ClosedForm
from difffric.simulation.events import Mode
from difffric.simulation.observables import Observables, observe_segments
from difffric.simulation.segment_motion import move_within
from difffric.simulation.segments import Push, Segment

_CYCLES = 64
"""Cycles through the modes of a push in which bends are looked for."""
_BESIDE = 1e-6
"""So long before and after a segment begins [s], and twice as long, the force is read."""
_CHUNK = 8192
"""Samples that go together: their some dozens of intermediate columns stay in the second-level
cache."""


class ColumnTraces(NamedTuple):
    """n pushes that were followed, to be read at any time."""

    push: Push
    table: Segment
    """the starts of all segments, (rows n,): those of push i are i, i + n, i + 2 n, ..."""
    observables: Observables
    """columns (n,)"""

    @property
    def starts(self) -> NDArray:
        """(n, rows) when the segments of each push begin [s]; one that is not there begins with
        the one before it."""
        n = len(plain(self.observables.peak_force))
        return np.asarray(plain(self.table.t)).reshape(-1, n).T

    def read(self, index: NDArray, time: Any, level: int, directions: int) -> tuple[NDArray, ...]:
        """(force [N], its derivatives, position [m], its derivatives) as the sensors read them.

        `index` (N,) says of which push, `time` (N,) when [s]; it may be a dual number.
        Derivatives are those of this level, (directions, N).
        """
        starts, when = self.starts, plain(time)
        n = len(starts)
        row = np.zeros(len(index), int)
        for column in starts.T[1:]:
            row += column[index] <= when
        at, mode = row * n + index, np.asarray(plain(self.table.mode))
        force, d_force = np.empty(len(index)), np.zeros((directions, len(index)))
        x, d_x = np.empty(len(index)), np.zeros((directions, len(index)))
        for one in Mode:
            here = np.flatnonzero(mode[at] == one)
            for lo in range(0, len(here), _CHUNK):
                part = here[lo : lo + _CHUNK]
                with np.errstate(all="ignore"):  # what a choice leaves aside may be no number
                    read = self._read(pick_lanes((index, at, time), part))
                (force[part], df), (x[part], dx) = (split(y, level) for y in read)
                d_force[:, part] = 0.0 if df is None else df
                d_x[:, part] = 0.0 if dx is None else dx
        return force, d_force, x, d_x

    def _read(self, given: tuple[NDArray, NDArray, Any]) -> tuple[Any, Any]:
        """(force [N], position [m]) at some samples of one mode."""
        index, at, time = given
        rig, segment = pick_lanes(self.push.rig, index), pick_lanes(self.table, at)
        force, x, _ = move_within(rig, self.push.integrator, segment, time)
        return rig.force_sensor.read(force), rig.probe.read(x)


def follow_columns(rig: Rig, velocity: Any, n: int, cycles: int) -> ColumnTraces:
    """n pushes at `velocity` [m/s], each followed to its end or for so many cycles at most.

    The velocity and every number of the rig are one value or n, dual numbers among them.
    """
    with np.errstate(all="ignore"):  # what a choice leaves aside may be no number
        push = Push(rig, spread(rig.pusher.speed(velocity), n), ClosedForm())
        state = push.start()
        rows = [spread(state.segment, n)]
        state = spread(state, n)
        most = 1 if push.once else cycles
        while True:
            going = np.flatnonzero(~state.over & (state.cycles < most))
            if not len(going):
                break
            part, own = pick_lanes((state, push), going)
            after, starts = own.cycle(part)
            state = put_lanes(state, going, after, n)
            rows += [put_lanes(rows[-1], going, start, n) for start in starts[1:]]
        return ColumnTraces(push, join_lanes(rows), observe_segments(push, state))


def find_bends(rig: Rig, velocity: NDArray, n: int) -> list[tuple[NDArray, NDArray]]:
    """For each of n pushes at `velocity` [m/s] of an affine rig, when the force's slope may change
    [s], and by how much [N/s]: a jump of the force has an endless one, about."""
    traces, found = follow_columns(rig, velocity, n, _CYCLES), []
    for push, starts in enumerate(traces.starts):
        t = np.unique(starts[np.isfinite(starts)])
        near = (t + _BESIDE * np.array([-2.0, -1.0, 1.0, 2.0])[:, None]).ravel()
        force = traces.read(np.full(len(near), push), near, 0, 0)[0].reshape(4, -1)
        found.append((t, (force[3] - force[2] - force[1] + force[0]) / _BESIDE))
    return found
