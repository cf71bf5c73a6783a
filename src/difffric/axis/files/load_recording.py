"""Read the recording of an axis: a text with a row a sample, or a `.tdms`, a group a stretch."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence, Set
from itertools import pairwise
from pathlib import Path

import numpy as np

from difffric.axis.files.file_kind import TEXTS, find_push_columns
from difffric.axis.recordings import NEWTON, VOLT, AxisRecordings, AxisStretch
from difffric.errors import InputError
from difffric.measurements.files.named_columns import read_columns
from difffric.measurements.quantities import MeasuredQuantity, join_problems
from difffric.value_ranges import ANY

COLUMNS = (
    MeasuredQuantity("time_s", "time", ANY, also=("t",)),
    MeasuredQuantity("force_N", "force", ANY, also=("F",)),
    MeasuredQuantity("drive_V", "drive", ANY, also=("voltage",)),
    MeasuredQuantity("position_mm", "position", ANY, "0.001", also=("x",)),
    MeasuredQuantity("stretch", "stretch", ANY),
    MeasuredQuantity("condition", "condition"),
)
"""What a row of a recording may say; another unit in a column's name is converted."""


def load_axis(
    path: str | os.PathLike,
    *,
    skip_bad: bool = False,
    channels: Mapping[str, str] | None = None,
    needs_position: bool = True,
) -> AxisRecordings:
    """The recording of an axis, in SI units, its drive in volts where it was recorded so.

    `channels`: the name of a column or channel by ours, where they differ, such as
    `{"force": "Kraft"}`. With `skip_bad` rows that cannot be used are left out; without
    `needs_position` a text may be of forces alone, whose positions are NaN. Raises `InputError`
    naming all that is wrong with the file.
    """
    suffix = Path(path).suffix.lower()
    if suffix in (*TEXTS, ".xlsx"):
        return _read_text(path, skip_bad, needs_position, channels or {})
    if suffix == ".tdms":
        from difffric.axis.files.tdms_recording import read_tdms  # texts need no npTDMS

        return read_tdms(path, channels or {})
    if suffix == ".mat":
        name = Path(path).stem
        raise InputError(
            f"{path}: a MATLAB file; this line of MATLAB makes a table of it: "
            f"T = struct2table(load('{name}.mat')); writetable(T, '{name}.csv'), with columns "
            "time_s, force_N (or drive_V), position_mm"
        )
    raise InputError(
        f"{path}: expected the recording of an axis (.csv or .tdms), got {suffix or 'no suffix'}"
    )


def _find_needed(found: Set[str]) -> Sequence[Sequence[str]]:
    return (("time",), ("force", "drive"), ("position",))


def _find_needed_forces(found: Set[str]) -> Sequence[Sequence[str]]:
    return (("time",), ("force", "drive"))


def _read_text(
    path: str | os.PathLike, skip_bad: bool, needs_position: bool, channels: Mapping[str, str]
) -> AxisRecordings:
    needed = _find_needed if needs_position else _find_needed_forces
    of_pushes = find_push_columns(path)
    if of_pushes and not channels:
        raise InputError(
            f"{path}: a table of pushes ({', '.join(of_pushes)}) beside the set-up of an axis: "
            "expected time_s, force_N or drive_V, and position_mm, a row a sample"
        )
    read = read_columns(path, COLUMNS, find_needed=needed, channels=channels, pass_over=True)
    values, problems = read.values, [f"{path}: line {words}" for _, words in read.problems]
    unit = "force" if "force" in values else "drive"
    values.setdefault("position", np.full(len(read.lines), np.nan))
    names = ["time", unit, *(["position"] if needs_position else [])]
    empty = [i for i, row in enumerate(zip(*(values[n] for n in names), strict=True))
             if np.isnan(row).any()]  # fmt: skip
    told = {line for line, _ in read.problems}
    problems += [
        f"{path}: line {read.lines[i]}: empty where a number is needed"
        for i in empty
        if read.lines[i] not in told
    ]
    if problems and not skip_bad:
        raise InputError(join_problems([*problems, "--skip-bad leaves such rows out"]))
    if not read.lines:
        raise InputError(f"{path}: no rows, expected one for each sample")
    notes = [*read.notes]
    if "force" in values and "drive" in values:
        notes.append("force_N is used, drive_V beside it is not")
    keep = np.ones(len(read.lines), bool)
    keep[empty] = False
    if empty:
        notes.append(f"{len(empty)} rows left out, which lack a number")
    arrays = {n: np.asarray(values[n], float)[keep] for n in ("time", unit, "position")}
    groups = np.asarray(values.get("stretch", np.ones(len(keep))), float)[keep]
    groups = np.nan_to_num(groups, nan=-1.0)
    conditions = np.asarray(values.get("condition", [""] * len(keep)), dtype=str)[keep]
    changes = (groups[1:] != groups[:-1]) | (conditions[1:] != conditions[:-1])
    ends = [0, *(np.flatnonzero(changes) + 1), len(groups)]
    stretches = [
        AxisStretch(
            f"{groups[a]:g}",
            arrays["time"][a:b],
            arrays[unit][a:b],
            arrays["position"][a:b],
            str(conditions[a]) or None,
        )
        for a, b in pairwise(ends)
        if b > a
    ]
    return AxisRecordings(
        stretches,
        NEWTON if unit == "force" else VOLT,
        "stretch" in values,
        tuple(notes),
        str(path),
        read.headings,
    )
