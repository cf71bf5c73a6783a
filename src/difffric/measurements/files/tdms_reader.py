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
from difffric.measurements.headings import (
    HeadingError,
    ask_for_names,
    find_quantity,
    find_unit_of,
    find_unknown,
    read_heading,
    resolve_channels,
)
from difffric.measurements.quantities import (
    OF_RECORDING,
    MeasuredQuantity,
    describe_unknown,
    find_meant,
    gather_alike,
    join_problems,
    shorten_to_line,
)
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.units import UNITS, Unit, find_unit
from difffric.value_ranges import ANY

_SPEED = "velocity_mm_min"
_KEYS = {q.key: q for q in OF_RECORDING}

CHANNELS = {"force": ("force", "voltage"), "position": ("length",), "pusher": ("length",)}
"""name -> what its unit may be of"""

_USUAL = {"force": ("N", "V"), "position": ("um", "mm", "m"), "pusher": ("um", "mm", "m")}
"""name -> units that go without saying; others are converted, and that is told"""

_SIGNALS = (
    MeasuredQuantity("force_N", "force", ANY),
    MeasuredQuantity("position_um", "position", ANY),
    MeasuredQuantity("pusher_um", "pusher", ANY),
)
"""The channels as quantities: by their names they are found, whatever unit the names have."""


def read_recordings(
    path: str | os.PathLike, *, skip_bad: bool = False, channels: Mapping[str, str] | None = None
) -> Recordings:
    """The recorded pushes of a `.tdms` file, in the order of its groups, SI units.

    `channels`: the name of a channel or of a group's property by ours, where they differ; units
    other than the contract's are converted, which `Recordings.notes` tells.

    Only the file's description is read; the file stays open, and `Channel.read` takes from it
    what is asked for. A `.tdms_index` beside it is not used: one that is stale or damaged does no
    harm. With `skip_bad` groups that cannot be used are left out and told in
    `Recordings.skipped`; of a damaged file what lies before the damage is used.

    Raises `InputError` naming all that is wrong by group and channel, once where it is the same in
    several groups. Samples are looked at when
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
        recordings = _recordings(contents, OpenFile(file), path, skip_bad, channels or {})
    except OSError as error:
        file.close()
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except BaseException:
        file.close()
        raise
    return recordings


def _recordings(
    contents: Contents, file: OpenFile, path, skip_bad: bool, meant: Mapping[str, str]
) -> Recordings:
    seen = [*contents.groups, *(group for group, _ in contents.channels), *contents.hurt]
    names = list(dict.fromkeys(seen))
    problems: list[tuple[str, str]] = []
    notes: list[tuple[str, str]] = []
    pushes = []
    for name in names:
        where = f"{path}: group {name!r}"
        if name in contents.hurt:
            problems.append((where, ": not whole, as the file is damaged"))
            continue
        group = _Group(contents, name, where, meant)
        push = group.read(file)
        problems += [(where, words) for words in group.problems]
        if push is not None:
            pushes.append(push)
            notes += [("", words) for words in group.notes]
    lines = [f"{path}: damaged: {contents.damage}"] if contents.damage else []
    if lines and pushes and not skip_bad:
        lines[0] += f"; {len(pushes)} pushes before it are whole: --skip-bad takes them alone"
    if not names and not lines:
        lines.append(f"{path}: no groups, expected one for each push")
    if (problems or lines) and not (skip_bad and pushes):
        raise InputError(join_problems(lines + gather_alike(problems, len(names))))
    skipped = [*lines, *(where + words for where, words in problems)]
    told = tuple(gather_alike(notes, len(pushes)))
    return Recordings(tuple(pushes), str(path), tuple(map(shorten_to_line, skipped)), told)


class _Group:
    """A group of a file, which is to be a recording: what is wrong with it, what is converted."""

    def __init__(self, contents: Contents, name: str, where: str, meant: Mapping[str, str]):
        self.problems: list[str] = []
        self.notes: list[str] = []
        self._contents, self._name, self._where = contents, name, where
        self._own = contents.groups.get(name, TdmsObject())
        self._channels = {c: one for (g, c), one in contents.channels.items() if g == name}
        signals, problems = resolve_channels(meant, [*self._channels], _SIGNALS)
        said, more = resolve_channels(meant, [*self._own.properties], OF_RECORDING)
        self._meant = signals | said
        unknown = find_unknown(meant, (*_SIGNALS, *OF_RECORDING))
        self.problems += [f": {problem}" for problem in (*unknown, *problems, *more)]

    def read(self, file: OpenFile) -> Recording | None:
        """The recording, or None where something is wrong with it."""
        said = self._read_properties()
        again = _describe_rewriting(self._own, self._channels)
        if again:
            self.problems.append(f": {again}")
        found: dict[str, Any] = {}
        for channel, one in self._channels.items():
            try:
                key = self._find_key(channel)
                if key is None:
                    continue
                if key in found:
                    raise ValueError(f"a second channel {key}, expected one")
                found[key] = self._read_channel(channel, key, one, file, bool(again))
            except ValueError as error:
                self.problems.append(f", channel {channel!r}: {error}")
        if not {"force", "position"} & {self._find_key(c, False) for c in self._channels}:
            self.problems.append(f": {self._describe_missing()}")
        if self.problems:
            return None
        start = _find_start(self._channels)
        return Recording(**said, **found, name=self._name, started=start)

    def _find_key(self, channel: str, strict: bool = True) -> str | None:
        """What a channel is: `force`, `position`, `pusher` or None.

        Raises `ValueError`, if `strict`, for one that is ours but for a slip: it would be missed
        without a word.
        """
        q = find_quantity(self._meant.get(channel, channel), _SIGNALS)
        if q is not None:
            return q.attribute
        key = channel.strip().lower()
        near = difflib.get_close_matches(key, CHANNELS, n=1, cutoff=0.75) if strict else []
        if near:
            raise ValueError(f"did you mean {near[0]}? Then give --channel {near[0]}={channel!r}")
        return None

    def _describe_missing(self) -> str:
        """What to say where neither force nor position is there, and how to say which is which."""
        got = ", ".join(self._channels) or "none"
        units = [str(one.properties.get("unit_string", "")) for one in self._channels.values()]
        remedy = ""
        if self._channels:
            asked = ask_for_names([_SIGNALS[:2]], [*self._channels], units)
            remedy = f": say which is which, with {asked}"
        return f"expected a channel force or position, got {got}{remedy}"

    def _read_channel(
        self, channel: str, key: str, one: TdmsObject, file: OpenFile, twice: bool
    ) -> Channel:
        """One channel. Raises `ValueError` for what is wrong with it."""
        says = one.properties
        if one.n == 0:
            raise ValueError("no samples")
        if one.dtype is None:
            raise ValueError("its samples are not numbers")
        unit = self._find_unit(channel, key, says.get("unit_string"))
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
        scaling = read_scaling(says, self._own.properties, self._contents.root)
        where = f"{self._where}, channel {channel!r}"
        to = {"force": "N", "voltage": "V", "length": "m"}[unit.of]
        return Channel(one.n, dt, start, to, Samples(file, where, one, scaling, unit).read)

    def _find_unit(self, channel: str, key: str, said: Any) -> Unit:
        """The unit of a channel: its `unit_string`, or where it has none what its name says, or
        what the reader was told. Raises `ValueError` where none of them is one that fits."""
        text = said.strip() if isinstance(said, str) else ""
        unit = find_unit(text)
        if not text:
            unit = find_unit_of(self._meant.get(channel, "")) or find_unit_of(channel)
        if unit is None or unit.of not in CHANNELS[key]:
            *first, last = _USUAL[key]
            usual = f"{', '.join(first)} or {last}"
            others = [u.symbol for u in UNITS if u.of in CHANNELS[key]]
            more = ", ".join(x for x in others if x not in _USUAL[key])
            got = f"got {said!r}" if text else "it is missing"
            remedy = "" if text else f": --channel {key}_{_USUAL[key][0]}={channel!r} says it"
            raise ValueError(f"unit_string: expected {usual} ({more} are converted), {got}{remedy}")
        if unit.symbol not in _USUAL[key]:
            self.notes.append(f"channel {channel}: converted from {unit.symbol}")
        return unit

    def _read_properties(self) -> dict[str, Any]:
        """The group's properties as fields of a `Recording`."""
        said: dict[str, Any] = {}
        given = self._own.properties
        for name, value in given.items():
            q = self._find_property(name, value)
            if q is None:
                continue
            if q.range is None:
                said[q.attribute] = str(value).strip()
                continue
            number = isinstance(value, int | float) and not isinstance(value, bool)
            x = float(value) if number else math.nan
            si = q.to_si(Decimal(repr(x))) if math.isfinite(x) else x
            if math.isfinite(si) and q.range.holds(si):
                said[q.attribute] = si
            else:
                self.problems.append(f": {name}: {q.range.describe_expected(si)}, got {value!r}")
        tried = any(q.stem in problem for problem in self.problems for q in (_KEYS[_SPEED],))
        if "velocity" not in said and not tried:
            numbers = [name for name, value in given.items() if isinstance(value, int | float)]
            asked = ask_for_names([[_KEYS[_SPEED]]], numbers, [""] * len(numbers))
            found = f" (found {', '.join(numbers)}: {asked} says which it is)" if numbers else ""
            self.problems.append(f": {_SPEED}: missing, expected a number > 0{found}")
        return said

    def _find_property(self, name: str, value: Any) -> MeasuredQuantity | None:
        """The quantity of a property, in the unit that its name says; None: another one. A file
        may say what it likes, but a mass that we do not understand must not pass for none."""
        if name in _KEYS:
            return _KEYS[name]
        meant = self._meant.get(name, "")
        if not meant and not isinstance(value, int | float):
            return None
        try:
            heading = read_heading(name, OF_RECORDING, meant=meant)
        except HeadingError as error:
            if meant:
                self.problems.append(f": property {name}: {error}")
            near = None if meant else find_meant(name, OF_RECORDING, 0.8)
            if near is not None and near.key not in self._own.properties:
                self.problems.append(f": property {name}: {describe_unknown(name, [near])}")
            return None
        q = heading.quantity
        if _find_own_key(q) in self._own.properties:
            return None
        if heading.note:
            self.notes.append(f"property {name}: {heading.note}")
        return q


def _find_own_key(q: MeasuredQuantity) -> str:
    """The contract's name of a quantity that a file has under another one."""
    return next(own.key for own in OF_RECORDING if own.attribute == q.attribute)


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


def _number(says: Mapping[str, Any], key: str) -> float | None:
    """A number among a channel's properties; None: not said."""
    value = says.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError(f"{key}: expected a number, got {value!r}")
    return float(value)
