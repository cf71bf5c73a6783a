"""The features of a fleet's recordings (F_p, d, noise: what needs no model), kept on disk in parts.

A part holds the pushes of some files, or why a file holds none, and with each the key of its file:
what the file, its rig's sensors and this library were when it was read. A part appears whole or
not at all, so that a run that was killed goes on with the files that no part has.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from difffric.atomic_files import write_whole
from difffric.errors import InputError
from difffric.fleet.archive import ArchiveFile
from difffric.measurements.checks import check_data
from difffric.measurements.load_file import load
from difffric.measurements.pushes import COLUMNS, Pushes
from difffric.measurements.recordings import Recordings
from difffric.measurements.reduction.reduce import reduce_recordings
from difffric.rig.rig import Rig

LAYOUT = 2
"""Version of the parts' and the data set's layout: what has another one is made anew."""
MADE_WITH = f"difffric {version('difffric')}, layout {LAYOUT}"
_NUMBERS = tuple(name for name in COLUMNS if name != "condition")

SCHEMA = {
    "file": pl.String,
    "push": pl.Int64,
    "name": pl.String,
    "date": pl.String,
    "condition": pl.String,
    **dict.fromkeys(_NUMBERS, pl.Float64),
    "noise_force": pl.Float64,
    "noise_position": pl.Float64,
    "missing": pl.String,
    "key": pl.String,
    "skipped": pl.List(pl.String),
    "refused": pl.String,
}
"""Columns of a part. Each push has a row, in the order of its file; what was `skipped` of a file
stands with its first push. A file that cannot be used has one row, with the reason in `refused`."""


@dataclass(frozen=True)
class ReadTask:
    """Files to be read in one go, each with its rig, into a part of the folder."""

    sources: tuple[ArchiveFile, ...]
    rigs: tuple[Rig, ...]
    folder: str
    use_data_mass: bool

    @property
    def name(self) -> str:
        """Name of the part, a digest of what it is made from."""
        keys = [
            make_key(s, r, self.use_data_mass) for s, r in zip(self.sources, self.rigs, strict=True)
        ]
        return hashlib.sha256("".join(keys).encode()).hexdigest()[:32]


def make_key(source: ArchiveFile, rig: Rig, use_data_mass: bool) -> str:
    """Digest of all that decides a file's features: its name, size and time of writing; mass and
    force sensor of the rig, against which it is checked; and this library."""
    sensor = rig.force_sensor
    numbers = [float(x) for x in (rig.mass, sensor.sensitivity, sensor.range)]
    said = [MADE_WITH, source.name, source.size, source.changed, numbers, use_data_mass]
    return hashlib.sha256(repr(said).encode()).hexdigest()[:32]


def extract(task: ReadTask) -> list[tuple[str, str]]:
    """Read the files of a task into its part; return (file, reason) of each that cannot be used.

    Whatever goes wrong with one file does not keep the others from being read. What is refused for
    what it holds goes into the part with its reason, and need not be read again.
    """
    columns: dict[str, list[Any]] = {name: [] for name in SCHEMA}
    bad = []
    for source, rig in zip(task.sources, task.rigs, strict=True):
        try:
            found = read_features(source, rig, task.use_data_mass)
        except InputError as error:
            reason = _strip_folder(str(error), source)
            bad.append((source.name, reason))
            if not _comes_of_content(error):
                continue
            key = make_key(source, rig, task.use_data_mass)
            found = {"file": [source.name], "push": [0], "key": [key], "refused": [reason]}
        except Exception as error:
            bad.append((source.name, f"{type(error).__name__}: {error}"))
            continue
        for name, column in columns.items():
            column.extend(found.get(name, [None]))
    if columns["file"]:
        # One table for all files, as to make one takes longer than to fill it.
        table = pl.DataFrame(columns, schema=SCHEMA).with_columns(pl.col(pl.Float64).fill_nan(None))
        write_whole(Path(task.folder, f"{task.name}.parquet"), table.write_parquet)
    return bad


def _comes_of_content(error: BaseException) -> bool:
    """Whether a file was refused for what it holds, and would be again; what a disk could not read
    it may read another time."""
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, OSError):
            return False
        seen = seen.__cause__ or seen.__context__
    return True


def read_features(
    source: ArchiveFile, rig: Rig, use_data_mass: bool = False
) -> dict[str, list[Any]]:
    """Return a file's pushes as columns, those of `SCHEMA`, in SI units; NaN: not to be had.

    Raises `InputError` where none of them can be used.
    """
    how: Any = {"use_data_mass": use_data_mass, "skip_bad": True}
    try:
        data = load(source.path, skip_bad=True)
        if isinstance(data, Recordings):
            reduction = reduce_recordings(check_data(data, rig, **how), skip_bad=True)
            pushes, details = reduction.pushes, reduction.details
            names = [r.name for r in reduction.recordings]
            days = [_find_day(source, r.started) for r in reduction.recordings]
        else:
            pushes, details = check_data(data, rig, **how), ()
            names, days = [""] * len(pushes), [_find_day(source, np.nan)] * len(pushes)
    except OSError as error:
        raise InputError(f"{source.path}: cannot be read: {error.strerror}") from None
    n = len(pushes)
    skipped = [_strip_folder(line, source) for line in pushes.skipped]
    columns = {name: getattr(pushes, name).tolist() for name in _NUMBERS}
    for which in ("force", "position"):
        noises = [getattr(one, f"noise_{which}") for one in details] or [None] * n
        columns[f"noise_{which}"] = [None if x is None else x.level for x in noises]
    return {
        "file": [source.name] * n,
        "push": list(range(n)),
        "name": names,
        "date": days,
        "condition": list(pushes.condition),
        **columns,
        "missing": [one.reason or None for one in details] or [None] * n,
        "key": [make_key(source, rig, use_data_mass)] * n,
        "skipped": [skipped, *[[]] * (n - 1)],
        "refused": [None] * n,
    }


def to_pushes(table: pl.DataFrame) -> Pushes:
    """Return the pushes of some rows of a table of the columns `SCHEMA`."""
    columns: dict[str, Any] = {name: table[name].fill_null(np.nan).to_numpy() for name in _NUMBERS}
    return Pushes(**columns, condition=tuple(table["condition"]))


def load_kept(folder: Path, keys: Sequence[str]) -> pl.DataFrame:
    """Return the pushes, or the refusal, of all files whose keys are asked for, as far as the parts
    in a folder have them, sorted by file and push.

    A part that has none of them any more is removed, and so is one that cannot be read.
    """
    tables, wanted = [pl.DataFrame(schema=SCHEMA)], pl.Series(keys, dtype=pl.String).implode()
    for path in sorted(folder.glob("*.parquet")):
        try:
            table = pl.read_parquet(path, hive_partitioning=False)
            table = table.select(pl.col(name).cast(kind) for name, kind in SCHEMA.items())
        except (pl.exceptions.PolarsError, OSError):
            table = tables[0]
        table = table.filter(pl.col("key").is_in(wanted))
        if not len(table):
            path.unlink(missing_ok=True)
        tables.append(table)
    whole = pl.concat(tables).unique(["key", "push"], keep="first", maintain_order=True)
    return whole.sort("file", "push")


def _find_day(source: ArchiveFile, started: float) -> str:
    """The date [UTC] of a recording: its own (`started`, s since 1970), else that of the file's
    last writing."""
    seconds = source.changed / 1e9 if np.isnan(started) else started
    return datetime.fromtimestamp(max(seconds, 0.0), UTC).date().isoformat()


def _strip_folder(text: str, source: ArchiveFile) -> str:
    """Return a message in one line, with the file's name in the archive in place of its path."""
    return " ".join(text.replace(source.path, source.name).removeprefix(f"{source.name}: ").split())


def remove_unfinished(folder: Path) -> None:
    """Remove the files that a killed process had begun to write in a folder tree."""
    for path, _, files in os.walk(folder):
        for name in files:
            if name.startswith("."):
                Path(path, name).unlink(missing_ok=True)
