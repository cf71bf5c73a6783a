"""What each recording of a fleet says without a model (F_p, d, noise), kept in parts on disk.

A part holds the pushes of some files, and with each the key of its file: what the file, its rig's
sensors and this library were when it was read. A part appears whole or not at all, so that a run
that was killed goes on with the files that no part has.
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
from difffric.fleet.archive import Source
from difffric.measurements.checks import checked_data
from difffric.measurements.load_file import load
from difffric.measurements.pushes import COLUMNS, Pushes
from difffric.measurements.recordings import Recordings
from difffric.measurements.reduction.reduce import reduce_recordings
from difffric.rig.rig import Rig

LAYOUT = 1
"""Of parts and data set: another one is made anew."""
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
}
"""A row a push, in the order of the file; `skipped` stands with the file's first."""


@dataclass(frozen=True)
class Task:
    """Files to be read in one go, each with its rig, into a part of the folder."""

    sources: tuple[Source, ...]
    rigs: tuple[Rig, ...]
    folder: str
    use_data_mass: bool

    @property
    def name(self) -> str:
        """Of the part: what it is made of."""
        keys = [
            key_of(s, r, self.use_data_mass) for s, r in zip(self.sources, self.rigs, strict=True)
        ]
        return hashlib.sha256("".join(keys).encode()).hexdigest()[:32]


def key_of(source: Source, rig: Rig, use_data_mass: bool) -> str:
    """What decides a file's features: name, size, time of writing; mass and force sensor of the
    rig, against which it is checked; this library."""
    sensor = rig.force_sensor
    numbers = [float(x) for x in (rig.mass, sensor.sensitivity, sensor.range)]
    said = [MADE_WITH, source.name, source.size, source.changed, numbers, use_data_mass]
    return hashlib.sha256(repr(said).encode()).hexdigest()[:32]


def extract(task: Task) -> list[tuple[str, str]]:
    """Read the files of a task into its part; (file, why) of each that cannot be used.

    Whatever goes wrong with a file is its own matter: it is told, and the others are read.
    """
    tables, bad = [], []
    for source, rig in zip(task.sources, task.rigs, strict=True):
        try:
            tables.append(features(source, rig, task.use_data_mass))
        except InputError as error:
            bad.append((source.name, _without_folder(str(error), source)))
        except Exception as error:
            bad.append((source.name, f"{type(error).__name__}: {error}"))
    if tables:
        write_whole(Path(task.folder, f"{task.name}.parquet"), pl.concat(tables).write_parquet)
    return bad


def features(source: Source, rig: Rig, use_data_mass: bool = False) -> pl.DataFrame:
    """A file's pushes, columns as in `SCHEMA`, SI units.

    Raises `InputError` where none of them can be used.
    """
    how: Any = {"use_data_mass": use_data_mass, "skip_bad": True}
    try:
        data = load(source.path, skip_bad=True)
        if isinstance(data, Recordings):
            reduction = reduce_recordings(checked_data(data, rig, **how), skip_bad=True)
            pushes, details = reduction.pushes, reduction.details
            names = [r.name for r in reduction.recordings]
            days = [_day(source, r.started) for r in reduction.recordings]
        else:
            pushes, details = checked_data(data, rig, **how), ()
            names, days = [""] * len(pushes), [_day(source, np.nan)] * len(pushes)
    except OSError as error:
        raise InputError(f"{source.path}: cannot be read: {error.strerror}") from None
    n = len(pushes)
    skipped = [_without_folder(line, source) for line in pushes.skipped]
    columns = {name: getattr(pushes, name) for name in _NUMBERS}
    noise = {
        f"noise_{which}": [
            None if (x := getattr(one, f"noise_{which}")) is None else x.level for one in details
        ]
        or [None] * n
        for which in ("force", "position")
    }
    table = {
        "file": [source.name] * n,
        "push": np.arange(n),
        "name": names,
        "date": days,
        "condition": list(pushes.condition),
        **columns,
        **noise,
        "missing": [one.reason or None for one in details] or [None] * n,
        "key": [key_of(source, rig, use_data_mass)] * n,
        "skipped": [skipped, *[[]] * (n - 1)],
    }
    return pl.DataFrame(table, schema=SCHEMA).with_columns(pl.col(pl.Float64).fill_nan(None))


def pushes_of(table: pl.DataFrame) -> Pushes:
    """The pushes of some rows of `SCHEMA`."""
    columns: dict[str, Any] = {name: table[name].fill_null(np.nan).to_numpy() for name in _NUMBERS}
    return Pushes(**columns, condition=tuple(table["condition"]))


def kept(folder: Path, keys: Sequence[str]) -> pl.DataFrame:
    """The pushes of all files whose keys are asked for, as far as the folder's parts have them,
    in the order of files and pushes. A part that has none of them any more is removed; one that
    cannot be read, too."""
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


def _day(source: Source, started: float) -> str:
    """The date [UTC] of a recording: its own, else that of the file's last writing."""
    seconds = source.changed / 1e9 if np.isnan(started) else started
    return datetime.fromtimestamp(max(seconds, 0.0), UTC).date().isoformat()


def _without_folder(text: str, source: Source) -> str:
    """A message with the file's name in the archive in place of its path, in one line."""
    return " ".join(text.replace(source.path, source.name).removeprefix(f"{source.name}: ").split())


def unfinished(folder: Path) -> None:
    """Remove what a killed process had begun to write in a folder tree."""
    for path, _, files in os.walk(folder):
        for name in files:
            if name.startswith("."):
                Path(path, name).unlink(missing_ok=True)
