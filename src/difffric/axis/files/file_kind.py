"""Whether a file is one of an axis: looked at in passing, so nothing is imported for it."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path

TEXTS = (".csv", ".txt", ".tsv", ".dat")
"""Suffixes of recordings that are text."""


def is_axis_file(path: str | os.PathLike) -> bool:
    """Whether a file is the set-up of an axis; False for what cannot be read, which the reader of
    other set-ups will say."""
    try:
        return "axis" in tomllib.loads(Path(path).read_bytes().decode("utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return False


def is_axis_recording(path: str | os.PathLike, channels: Iterable[str] = ()) -> bool:
    """Whether a text has a column of times and one of positions, as only recordings of an axis
    have, or is said to: `channels` are those of our names that a person gives columns of it. False
    for what cannot be read."""
    if {x.partition("_")[0].lower() for x in channels} & {"time", "drive"}:
        return True
    names = _read_heading(path)
    has_time = any(re.match(r"(time|t)\b|time_", x) for x in names)
    return has_time and any(x.startswith(("position", "x_", "x ")) or x == "x" for x in names)


def find_push_columns(path: str | os.PathLike) -> list[str]:
    """The columns of a text by which it is a table of pushes, and no recording of an axis; none
    for what cannot be read."""
    names = _read_heading(path)
    if any(re.match(r"(time|t)\b|time_", x) for x in names):
        return []
    starts = ("velocity", "release_velocity", "peak_force", "sliding_distance")
    found = [x for x in names if x.startswith(starts) and "_se_" not in x]
    return found if len(found) > 1 else []


def _read_heading(path: str | os.PathLike) -> list[str]:
    """The names in the first line of a text, in small letters; none of what cannot be read."""
    if Path(path).suffix.lower() not in TEXTS:
        return []
    try:
        with open(path, "rb") as file:
            head = file.read(4096).decode("utf-8", "replace").lower()
    except OSError:
        return []
    lines = [x for x in head.splitlines() if x.strip() and not x.startswith(("#", "%", "sep="))]
    return [x.strip(' "\ufeff') for x in re.split(r"[,;\t|]", lines[0])] if lines else []


def lacks_speeds(path: str | os.PathLike) -> bool:
    """Whether a `.tdms` has groups with a force and a position of which none says the speed of a
    push: the recording of an axis; False for what cannot be read."""
    if Path(path).suffix.lower() != ".tdms":
        return False
    import nptdms  # here, as texts need none

    try:
        groups = nptdms.TdmsFile.read_metadata(str(path)).groups()
    except Exception:  # npTDMS raises all sorts for a damaged file, of which its reader tells
        return False
    names = [{x.name.strip().lower() for x in group.channels()} for group in groups]
    return bool(groups) and all(
        {"force", "position"} <= own and "velocity_mm_min" not in group.properties
        for own, group in zip(names, groups, strict=True)
    )
