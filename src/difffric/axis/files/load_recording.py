"""Read the recording of an axis: a text with a row a sample, or a `.tdms`, a group a stretch."""

from __future__ import annotations

import os
from collections.abc import Sequence, Set
from itertools import pairwise
from pathlib import Path

import numpy as np

from difffric.atomic_files import open_file
from difffric.axis.files.file_kind import TEXTS
from difffric.axis.recordings import NEWTON, VOLT, AxisRecordings, AxisStretch
from difffric.errors import InputError
from difffric.measurements.files.named_columns import read_columns
from difffric.measurements.quantities import MeasuredQuantity, join_problems
from difffric.measurements.recordings import Recordings
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

_FORCE = {"N": NEWTON, "V": VOLT}
_LENGTH = {"um": 1e-6, "µm": 1e-6, "μm": 1e-6, "mm": 1e-3, "m": 1.0}


def load_axis(
    path: str | os.PathLike, *, skip_bad: bool = False, needs_position: bool = True
) -> AxisRecordings:
    """The recording of an axis, in SI units, its drive in volts where it was recorded so.

    With `skip_bad` rows that cannot be used are left out; without `needs_position` a text may be of
    forces alone, whose positions are NaN. Raises `InputError` naming all that is
    wrong with the file.
    """
    suffix = Path(path).suffix.lower()
    if suffix in TEXTS:
        return _read_text(path, skip_bad, needs_position)
    if suffix == ".tdms":
        return _read_tdms(path)
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


def convert_recordings(data: Recordings) -> AxisRecordings:
    """The recordings of a `.tdms` that was read as one of pushes, as those of an axis.

    Raises `InputError` where a group has no force or no position.
    """
    problems, stretches, units = [], [], set()
    for k, push in enumerate(data):
        if push.force is None or push.position is None:
            problems.append(f"{data.source}: group {push.name!r}: expected force and position")
            continue
        t = push.position.time
        force = push.force.samples
        if push.force.n != len(t) or push.force.dt != push.position.dt:
            at = np.searchsorted(push.force.time, t + 1e-9 * push.position.dt, side="right") - 1
            force = force[np.clip(at, 0, len(force) - 1)]
        units.add(push.force.unit)
        name = push.name or str(k + 1)
        stretches.append(AxisStretch(name, t, force, push.position.samples, push.condition or None))
    if len(units) > 1:
        problems.append(f"{data.source}: expected the force in one unit, got {sorted(units)}")
    if problems:
        raise InputError(join_problems(problems))
    return AxisRecordings(stretches, units.pop(), source=data.source)


def _find_needed(found: Set[str]) -> Sequence[Sequence[str]]:
    return (("time",), ("force", "drive"), ("position",))


def _find_needed_forces(found: Set[str]) -> Sequence[Sequence[str]]:
    return (("time",), ("force", "drive"))


def _read_text(path: str | os.PathLike, skip_bad: bool, needs_position: bool) -> AxisRecordings:
    needed = _find_needed if needs_position else _find_needed_forces
    read = read_columns(path, COLUMNS, find_needed=needed, pass_over=True)
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
    )


def _read_tdms(path: str | os.PathLike) -> AxisRecordings:
    import nptdms  # here, as texts need none

    open_file(path).close()
    try:
        file = nptdms.TdmsFile.read(str(path))
    except Exception as error:  # npTDMS raises all sorts for a damaged file
        raise InputError(f"{path}: not a TDMS file that can be read: {error}") from None
    problems, stretches, units = [], [], set()
    for group in file.groups():
        where = f"{path}: group {group.name!r}"
        channels = {x.name.strip().lower(): x for x in group.channels()}
        missing = [x for x in ("force", "position") if x not in channels]
        if missing:
            got = ", ".join(channels) or "none"
            problems.append(f"{where}: channel {' and '.join(missing)} missing, found {got}")
            continue
        force, position = channels["force"], channels["position"]
        of_force = str(force.properties.get("unit_string", "")).strip()
        of_position = str(position.properties.get("unit_string", "")).strip()
        step = position.properties.get("wf_increment")
        if of_force not in _FORCE:
            problems.append(f"{where}: force: unit_string: expected N or V, got {of_force!r}")
        if of_position not in _LENGTH:
            problems.append(
                f"{where}: position: unit_string: expected um, mm or m, got {of_position!r}"
            )
        if not isinstance(step, int | float) or not step > 0:
            problems.append(f"{where}: position: wf_increment: expected a number > 0, got {step!r}")
            continue
        x = np.asarray(position[:], float) * _LENGTH.get(of_position, 1.0)
        F = np.asarray(force[:], float)
        t = float(position.properties.get("wf_start_offset", 0.0)) + step * np.arange(len(x))
        of_samples = float(force.properties.get("wf_increment", step))
        begin = float(force.properties.get("wf_start_offset", 0.0))
        if len(F) == 0 or len(x) == 0:
            problems.append(f"{where}: no samples")
            continue
        at = np.floor((t - begin) / of_samples + 1e-6).astype(int)
        units.add(_FORCE.get(of_force, NEWTON))
        condition = group.properties.get("condition")
        stretches.append(
            AxisStretch(
                group.name,
                t,
                F[np.clip(at, 0, len(F) - 1)],
                x,
                None if condition is None else str(condition),
            )
        )
    if len(units) > 1:
        problems.append(f"{path}: expected the force in one unit, got {sorted(units)}")
    if problems or not stretches:
        raise InputError(join_problems(problems or [f"{path}: no groups"]))
    return AxisRecordings(stretches, units.pop(), source=str(path))
