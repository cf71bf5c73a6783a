"""Recorded motion of an axis: time, force and position of each stretch, in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from difffric.errors import InputError

VOLT, NEWTON = "V", "N"


@dataclass(frozen=True)
class AxisStretch:
    """One piece of a recording, which has a friction level of its own."""

    name: str
    time: NDArray
    """(n,) [s], growing"""
    force: NDArray
    """(n,) of the drive, held from sample to sample [N, or V where `AxisRecordings.unit` says V]"""
    position: NDArray
    """(n,) [m]"""
    condition: str | None = None

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True)
class AxisRecordings:
    """The stretches of an axis' recording, in the order in which they were made."""

    stretches: Sequence[AxisStretch]
    unit: str = NEWTON
    """of the force: `N`, or `V` where the drive's voltage was recorded"""
    are_given: bool = True
    """whether the file says where stretches begin; else they are cut at rests"""
    notes: Sequence[str] = ()
    """what is odd about the data, a line each"""
    source: str = "the recording"
    columns: Mapping[str, str] = field(default_factory=dict)
    """what a text calls its columns, by our name without a unit (`position`: `position_mm`)"""

    def __len__(self) -> int:
        return len(self.stretches)

    @property
    def samples(self) -> int:
        """How many samples all stretches have together."""
        return sum(len(x) for x in self.stretches)

    def select(self, chosen: Sequence[int]) -> AxisRecordings:
        """Return the recording with some of its stretches only."""
        return replace(self, stretches=[self.stretches[i] for i in chosen], are_given=True)


def convert_to_newtons(data: AxisRecordings, gain: float | None) -> AxisRecordings:
    """Return the recording with its drive in newtons, by the drive's gain [N/V].

    Raises `InputError` where the drive was recorded in volts and the set-up has no gain.
    """
    if data.unit == NEWTON:
        return data
    if gain is None:
        raise InputError(
            f"{data.source}: the drive is in volts; give [drive] gain_N_per_V in the set-up"
        )
    stretches = [replace(x, force=gain * x.force) for x in data.stretches]
    return replace(data, stretches=stretches, unit=NEWTON)


def check_recordings(data: AxisRecordings) -> AxisRecordings:
    """Return the recording cut at its gaps, with a note for what is odd about it.

    Raises `InputError` where time does not grow, or where there is nothing to fit.
    """
    notes, stretches = [*data.notes], []
    for one in data.stretches:
        step = np.diff(one.time)
        if np.any(step <= 0):
            k = int(np.argmax(step <= 0)) + 1
            raise InputError(
                f"{data.source}: time_s does not grow at sample {k + 1} of stretch {one.name}: "
                f"{one.time[k - 1]:g} s is followed by {one.time[k]:g} s"
            )
        stretches += _cut_at_gaps(one, step, notes)
    stretches = [x for x in stretches if len(x) >= FEWEST]
    if not stretches:
        raise InputError(f"{data.source}: expected a stretch of {FEWEST} samples or more")
    notes += _find_oddities(stretches, data)
    return replace(data, stretches=stretches, notes=tuple(dict.fromkeys(notes)))


FEWEST = 50
"""Samples that a stretch must have: fewer say nothing about an acceleration."""
_GAP = 3.5
"""Sampling intervals without a sample that make a gap; one or two may be a late clock."""
_SATURATED = 0.01
"""Share of samples at the very largest force from which on the drive counts as saturated."""
_WRAP = 0.5
"""Share of the whole range that a position jumps by, within a sample, where it wraps."""


def _cut_at_gaps(one: AxisStretch, step: NDArray, notes: list[str]) -> list[AxisStretch]:
    """The stretch as pieces without a gap, and without a jump of a position that wraps."""
    gap = step > _GAP * np.median(step)
    jump = np.abs(np.diff(one.position))
    wraps = (jump > _WRAP * max(np.ptp(one.position), 1e-300)) & (jump > 50 * np.median(jump))
    if gap.any():
        count = f"{int(gap.sum())} gaps" if gap.sum() > 1 else "1 gap"
        notes.append(f"{count} in time: the stretches are cut there")
    if wraps.any():
        notes.append(
            f"the position jumps by {jump.max():.4g} m within a sample, {int(wraps.sum())} times "
            "(an encoder that wraps?): the stretches are cut there"
        )
    ends = [0, *(np.flatnonzero(gap | wraps) + 1), len(one)]
    if len(ends) == 2:
        return [one]
    return [
        AxisStretch(
            f"{one.name}.{i + 1}", one.time[a:b], one.force[a:b], one.position[a:b], one.condition
        )
        for i, (a, b) in enumerate(pairwise(ends))
    ]


def _find_oddities(stretches: Sequence[AxisStretch], data: AxisRecordings) -> list[str]:
    """Notes on a drive at its limit.

    Raises `InputError` where nothing moves at all, or no force ever changes.
    """
    force = np.concatenate([x.force for x in stretches])
    position = np.concatenate([x.position for x in stretches])
    if max(np.ptp(x.position) for x in stretches) == 0:
        raise InputError(
            f"{data.source}: the position never changes (a force without motion): nothing about "
            "mass or sliding friction can be said; record a move"
        )
    if not (np.isfinite(force).all() and np.isfinite(position).all()):
        raise InputError(f"{data.source}: expected finite numbers only")
    if np.ptp(force) == 0:
        raise InputError(
            f"{data.source}: the force is {force[0]:g} {data.unit} throughout (motion without a "
            "force): nothing about mass or friction can be said; is its channel connected?"
        )
    notes = []
    if force.size > 1000:
        for end, word in ((force.max(), "largest"), (force.min(), "smallest")):
            share = np.mean(force == end)
            if share > _SATURATED and _is_flat(force, end):
                notes.append(
                    f"{100 * share:.0f} % of the samples stand at the {word} force {end:.5g} "
                    f"{data.unit} (a saturated drive?): what it gave beyond is not in the data"
                )
    return notes


def _is_flat(force: NDArray, end: float) -> bool:
    """Whether a force stands at its end while the samples nearest to it are rare: a limit."""
    near = (np.abs(force - end) < 0.02 * np.ptp(force)) & (force != end)
    return near.sum() < 0.5 * np.sum(force == end)
