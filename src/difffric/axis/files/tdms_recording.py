"""The recording of an axis as a `.tdms`: a group a stretch, with a channel for each signal."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import nptdms
import numpy as np
from numpy.typing import NDArray

from difffric.atomic_files import open_file
from difffric.axis.recordings import NEWTON, VOLT, AxisRecordings, AxisStretch
from difffric.errors import InputError
from difffric.measurements.headings import (
    ask_for_names,
    find_quantity,
    find_unit_of,
    find_unknown,
    resolve_channels,
)
from difffric.measurements.quantities import MeasuredQuantity, gather_alike, join_problems
from difffric.units import Unit, find_unit
from difffric.value_ranges import ANY

_FORCE, _DRIVE, _POSITION, _TIME = "force", "drive", "position", "time"
_SIGNALS = (
    MeasuredQuantity("force_N", _FORCE, ANY),
    MeasuredQuantity("drive_V", _DRIVE, ANY),
    MeasuredQuantity("position_mm", _POSITION, ANY),
    MeasuredQuantity("time_s", _TIME, ANY),
)
"""The channels as quantities: by their names they are found, whatever unit the names have."""
_OF = {
    _FORCE: ("force", "voltage"), _DRIVE: ("force", "voltage"), _POSITION: ("length",),
    _TIME: ("time",),
}  # fmt: skip
_EXPECTED = {_FORCE: "N or V", _DRIVE: "V or N", _POSITION: "um, mm or m", _TIME: "s"}


@dataclass(frozen=True)
class _Signal:
    """A channel's samples and their times."""

    samples: NDArray
    """(n,) in SI"""
    unit: Unit
    begin: float
    step: float | None
    """[s]; None: not said"""


def read_tdms(path: str | os.PathLike, channels: Mapping[str, str]) -> AxisRecordings:
    """Return the recording of a `.tdms`; `channels` has a channel's name by ours.

    Raises `InputError` naming what is wrong, by group.
    """
    open_file(path).close()
    try:
        file = nptdms.TdmsFile.read(str(path))
    except Exception as error:  # npTDMS raises all sorts for a damaged file
        raise InputError(f"{path}: not a TDMS file that can be read: {error}") from None
    groups = [x for x in file.groups() if x.channels()]
    problems: list[tuple[str, str]] = []
    notes: list[tuple[str, str]] = []
    stretches, units = [], set()
    for group in groups:
        where = f"{path}: group {group.name!r}"
        try:
            stretch, unit = _read_group(group, channels, notes)
        except ValueError as error:
            problems.append((where, f": {error}"))
            continue
        units.add(unit)
        stretches.append(stretch)
    if len(units) > 1:
        problems.append((f"{path}", f": expected the force in one unit, got {sorted(units)}"))
    if problems or not stretches:
        listed = gather_alike(problems, len(groups), "groups")
        raise InputError(join_problems(listed or [f"{path}: no groups with channels"]))
    told = gather_alike(notes, len(groups), "groups")
    if any("velocity_mm_min" in x.properties for x in groups):
        told.append(
            "its groups say the speed of a push: read as an axis that the force drives, as the "
            "set-up has [axis]"
        )
    return AxisRecordings(stretches, units.pop(), notes=tuple(told), source=str(path))


def _read_group(
    group: Any, meant: Mapping[str, str], notes: list[tuple[str, str]]
) -> tuple[AxisStretch, str]:
    """A group's stretch, and the unit of its force. Raises `ValueError` for what is wrong."""
    own = {str(x.name): x for x in group.channels()}
    meanings, problems = resolve_channels(meant, [*own], _SIGNALS)
    problems = [*find_unknown(meant, _SIGNALS), *problems]
    if problems:
        raise ValueError("; ".join(problems))
    found: dict[str, _Signal] = {}
    for name, channel in own.items():
        q = find_quantity(meanings.get(name, name), _SIGNALS)
        if q is None:
            continue
        if q.attribute in found:
            raise ValueError(f"a second channel {q.attribute}, expected one")
        found[q.attribute] = _read_signal(channel, q.attribute, meanings.get(name, ""), notes)
    drive = found.get(_FORCE) or found.get(_DRIVE)
    position = found.get(_POSITION)
    if drive is None or position is None:
        raise ValueError(_describe_missing(own, drive is None, position is None))
    t = _find_times(found, position)
    condition = group.properties.get("condition")
    force = drive.samples
    if _TIME in found and drive.step is None:
        if len(force) != len(t):
            raise ValueError(f"{len(force)} samples of the force, {len(t)} of the time")
    else:
        at = np.floor((t - drive.begin) / (drive.step or position.step or 1.0) + 1e-6).astype(int)
        force = force[np.clip(at, 0, len(force) - 1)]
    stretch = AxisStretch(
        group.name, t, force, position.samples, None if condition is None else str(condition)
    )
    return stretch, NEWTON if drive.unit.of == "force" else VOLT


def _find_times(found: Mapping[str, _Signal], position: _Signal) -> NDArray:
    """The times of the positions' samples: the waveform's, else those of a channel of times."""
    if position.step is not None:
        return position.begin + position.step * np.arange(len(position.samples))
    if _TIME not in found:
        raise ValueError(
            "position: wf_increment: missing, expected the sampling interval in s, or a channel "
            "time"
        )
    t = found[_TIME].samples
    if len(t) != len(position.samples):
        raise ValueError(f"{len(t)} samples of the time, {len(position.samples)} of the position")
    return t


def _read_signal(channel: Any, key: str, meaning: str, notes: list[tuple[str, str]]) -> _Signal:
    """A channel in SI. Raises `ValueError` for what is wrong with it."""
    says = channel.properties
    said = str(says.get("unit_string", "")).strip()
    unit = find_unit(said) if said else find_unit_of(meaning) or find_unit_of(channel.name)
    if unit is None or unit.of not in _OF[key]:
        if key == _TIME and not said:
            unit = find_unit("s")
        else:
            raise ValueError(
                f"{channel.name}: unit_string: expected {_EXPECTED[key]}, "
                f"got {repr(said) if said else 'none'}"
            )
    assert unit is not None
    if len(channel) == 0:
        raise ValueError(f"{channel.name}: no samples")
    try:
        samples = np.asarray(channel[:], float) * unit.in_si
    except (TypeError, ValueError):
        raise ValueError(f"{channel.name}: its samples are not numbers") from None
    if unit.in_si != 1.0 and unit.symbol not in ("um", "mm"):
        notes.append(("", f"channel {channel.name}: converted from {unit.symbol}"))
    step = says.get("wf_increment")
    if step is not None and not (isinstance(step, int | float) and step > 0):
        raise ValueError(f"{channel.name}: wf_increment: expected a number > 0, got {step!r}")
    return _Signal(samples, unit, float(says.get("wf_start_offset", 0.0)), step)


def _describe_missing(own: Mapping[str, Any], no_drive: bool, no_position: bool) -> str:
    """What to say where a signal is missing, and how to say which channel it is."""
    asked = [list(_SIGNALS[:2])] if no_drive else []
    asked += [[_SIGNALS[2]]] if no_position else []
    units = [str(x.properties.get("unit_string", "")) for x in own.values()]
    names = " and ".join([*["force"] * no_drive, *["position"] * no_position])
    remedy = ask_for_names(asked, [*own], units)
    return f"channel {names} missing, found {', '.join(own)}: say which is which, with {remedy}"
