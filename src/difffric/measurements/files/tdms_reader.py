"""Recordings, `.tdms`: a group a push, read channel by channel where they are asked for."""

from __future__ import annotations

import difflib
import math
import os
from collections.abc import Mapping
from decimal import Decimal
from typing import Any

import numpy as np
from nptdms.timestamp import TdmsTimestamp

from difffric.atomic_files import open_file
from difffric.errors import InputError
from difffric.measurements.files.tdms_samples import OpenFile, Samples, read_scaling
from difffric.measurements.files.tdms_segments import Contents, TdmsObject, read_contents
from difffric.measurements.quantities import (
    OF_RECORDING,
    describe_unknown,
    find_meant,
    join_problems,
    shorten_to_line,
)
from difffric.measurements.recordings import Channel, Recording, Recordings

_FORCE = {"N": ("N", 1.0), "V": ("V", 1.0)}
_LENGTH = {"um": ("m", 1e6), "µm": ("m", 1e6), "μm": ("m", 1e6), "mm": ("m", 1e3), "m": ("m", 1.0)}
_SPEED = "velocity_mm_min"
_KEYS = {q.key: q for q in OF_RECORDING}

CHANNELS = {"force": _FORCE, "position": _LENGTH, "pusher": _LENGTH}
"""name -> unit_string -> (unit here, what the file's numbers are divided by)"""


def read_recordings(path: str | os.PathLike, *, skip_bad: bool = False) -> Recordings:
    """The recorded pushes of a `.tdms` file, in the order of its groups, SI units.

    Only the file's description is read; the file stays open, and `Channel.read` takes from it
    what is asked for. A `.tdms_index` beside it is not used: one that is stale or damaged does no
    harm. With `skip_bad` groups that cannot be used are left out and told in
    `Recordings.skipped`; of a damaged file what lies before the damage is used.

    Raises `InputError` naming all that is wrong by group and channel. Samples are looked at when
    they are read: `Channel.read` raises `InputError` for one that is not finite.
    """
    file = open_file(path)
    try:
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        tag = file.read(4)
        if tag == b"TDSh":
            raise InputError(f"{path}: an index file, expected the .tdms file beside it")
        if tag != b"TDSm":
            what = (
                "not a TDMS file, which begins with TDSm" if size else "empty, expected a TDMS file"
            )
            raise InputError(f"{path}: {what}")
        contents = read_contents(file, size)
        recordings = _recordings(contents, OpenFile(file), path, skip_bad)
    except OSError as error:
        file.close()
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except BaseException:
        file.close()
        raise
    return recordings


def _recordings(contents: Contents, file: OpenFile, path, skip_bad: bool) -> Recordings:
    seen = [*contents.groups, *(group for group, _ in contents.channels), *contents.hurt]
    names = list(dict.fromkeys(seen))
    problems, pushes = [], []
    if contents.damage:
        problems.append(f"{path}: damaged: {contents.damage}")
    for name in names:
        where = f"{path}: group {name!r}"
        if name in contents.hurt:
            problems.append(f"{where}: not whole, as the file is damaged")
            continue
        push, found = _recording(contents, name, file, where)
        problems += found
        if push is not None:
            pushes.append(push)
    if not names and not problems:
        problems.append(f"{path}: no groups, expected one for each push")
    if problems and not (skip_bad and pushes):
        raise InputError(join_problems(problems))
    return Recordings(tuple(pushes), str(path), tuple(map(shorten_to_line, problems)))


def _recording(
    contents: Contents, name: str, file: OpenFile, where: str
) -> tuple[Recording | None, list[str]]:
    """A group's recording, or what is wrong with it."""
    group = contents.groups.get(name, TdmsObject())
    channels = {c: one for (g, c), one in contents.channels.items() if g == name}
    said, words = _properties(group.properties)
    problems = [f"{where}: {problem}" for problem in words]
    again = _describe_rewriting(group, channels)
    if again:
        problems.append(f"{where}: {again}")
    found: dict[str, Any] = {}
    for channel, one in channels.items():
        key = channel.strip().lower()
        here = f"{where}, channel {channel!r}"
        try:
            if key not in CHANNELS:
                # One that is ours but for a slip would be missed without a word.
                if near := difflib.get_close_matches(key, CHANNELS, n=1, cutoff=0.75):
                    raise ValueError(f"did you mean {near[0]}?")
                continue
            if key in found:
                raise ValueError(f"a second channel {key}, expected one")
            found[key] = _channel(contents, group, one, CHANNELS[key], file, here, bool(again))
        except ValueError as error:
            problems.append(f"{here}: {error}")
    if not {"force", "position"} & {channel.strip().lower() for channel in channels}:
        got = ", ".join(channels) or "none"
        problems.append(f"{where}: expected a channel force or position, got {got}")
    if problems:
        return None, problems
    return Recording(**said, **found, name=name, started=_find_start(channels)), []


def _channel(
    contents: Contents,
    group: TdmsObject,
    one: TdmsObject,
    units: Mapping[str, tuple[str, float]],
    file: OpenFile,
    where: str,
    twice: bool,
) -> Channel:
    """One channel. Raises `ValueError` for what is wrong with it."""
    says = one.properties
    if one.n == 0:
        raise ValueError("no samples")
    if one.dtype is None:
        raise ValueError("its samples are not numbers")
    unit = says.get("unit_string")
    if not isinstance(unit, str) or unit.strip() not in units:
        got = "it is missing" if unit is None else f"got {unit!r}"
        raise ValueError(f"unit_string: expected {_or(units)}, {got}")
    dt = _number(says, "wf_increment")
    if dt is None:
        raise ValueError("wf_increment: missing, expected the sampling interval in s")
    start = _number(says, "wf_start_offset") or 0.0
    if dt <= 0 or not math.isfinite(start + one.n * dt):
        raise ValueError(f"wf_increment: expected a number > 0, got {dt}")
    if start and start + dt == start:
        raise ValueError(f"wf_start_offset: {start} s is beyond all intervals of {dt} s")
    samples = _number(says, "wf_samples")
    if samples is not None and not twice and not _agree(samples, one):
        raise ValueError(f"wf_samples is {samples:g}, found {one.n} samples")
    to, divisor = units[unit.strip()]
    scaling = read_scaling(says, group.properties, contents.root)
    return Channel(one.n, dt, start, to, Samples(file, where, one, scaling, divisor).read)


def _find_start(channels: Mapping[str, TdmsObject]) -> float:
    """The earliest `wf_start_time` of a group's channels [s since 1970]; NaN where none is said.
    A clock that was never set says 1904."""
    said = [one.properties.get("wf_start_time") for one in channels.values()]
    times = [float(t.as_datetime64("s").astype(int)) for t in said if isinstance(t, TdmsTimestamp)]
    return min((t for t in times if t > 0), default=math.nan)


def _agree(samples: float, one: TdmsObject) -> bool:
    """Whether a channel may hold `wf_samples` samples a waveform: LabVIEW says there how long
    the whole is, or each of the writings that it streamed."""
    if one.n == samples:
        return True
    in_parts = all(piece.values <= samples for piece in one.pieces)
    return 0 < samples < one.n and (in_parts or one.n % samples == 0)


def _describe_rewriting(group: TdmsObject, channels: Mapping[str, TdmsObject]) -> str:
    """What to say of a group that stands for two pushes, as after a concatenation; else empty.

    A writer that streams may repeat a group's properties, but then its `wf_samples` is that of
    the whole.
    """
    speeds = [says[_SPEED] for says in group.told if _SPEED in says]
    parted = [c for c, one in channels.items() if one.segments > 1]
    if len(speeds) < 2 or not parted:
        return ""
    whole = all(channels[c].properties.get("wf_samples") == channels[c].n for c in parted)
    if len(set(speeds)) == 1 and whole:
        return ""
    return f"written {len(speeds)} times, expected a group of its own for each push"


def _properties(given: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """(a group's properties as fields of a `Recording`, what is wrong with them)."""
    said: dict[str, Any] = {}
    problems = []
    for key, q in _KEYS.items():
        if key not in given:
            continue
        value = given[key]
        if q.range is None:
            said[q.attribute] = str(value).strip()
            continue
        number = isinstance(value, int | float) and not isinstance(value, bool)
        x = float(value) if number else math.nan
        si = q.to_si(Decimal(repr(x))) if math.isfinite(x) else x
        if math.isfinite(si) and q.range.holds(si):
            said[q.attribute] = si
        else:
            problems.append(f"{key}: {q.range.describe_expected(si)}, got {value!r}")
    for name, value in given.items():
        if name in _KEYS or not isinstance(value, int | float):
            continue
        # A file may say what it likes, but a mass in grams must not pass for none.
        if (q := find_meant(name, OF_RECORDING, 0.8)) and q.key not in given:
            problems.append(f"property {name}: {describe_unknown(name, [q])}")
    if "velocity_mm_min" not in given and not any("velocity_mm_min" in p for p in problems):
        problems.append("velocity_mm_min: missing, expected a number > 0")
    return said, problems


def _number(says: Mapping[str, Any], key: str) -> float | None:
    """A number among a channel's properties; None: not said."""
    value = says.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError(f"{key}: expected a number, got {value!r}")
    return float(value)


def _or(names) -> str:
    *first, last = names
    return f"{', '.join(first)} or {last}" if first else last
