"""A fleet's recordings identified: many files of many rigs to one Parquet data set.

Two stages. Features: each file read and reduced to F_p and d, some files a task. Friction: mu_s of
the pushes, some thousands of them a task, whatever rigs they come from. What is on disk stays true
at any moment: each file appears whole, under a name and with a key that say what it was made from,
so that a run that was killed, or an archive that has grown, goes on with what is missing; what
remains is the data set of a single run, bit for bit.
"""

from __future__ import annotations

import csv
import hashlib
import io
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import polars as pl

from difffric.atomic_files import write_whole
from difffric.errors import InputError
from difffric.fleet import features
from difffric.fleet.archive import Source, find
from difffric.fleet.columns import friction
from difffric.fleet.features import MADE_WITH
from difffric.fleet.workers import Lost, Runner, workers
from difffric.output_folder import open_folder
from difffric.progress import Tell, silent
from difffric.rig.setup import Setup
from difffric.rig.setup_toml import read_setup

FILES = 32
"""Files that a task reads: more make a kill cost more, fewer the scheduler."""
BYTES = 4_000_000
"""The same, of long files."""
ROWS = 8192
"""Pushes that a task identifies, and that a file of the data set holds, at most."""
DATA_SET, STATE = "pushes", ".fleet"
_KEY = "difffric"


@dataclass(frozen=True)
class Fleet:
    """What a run left in its folder."""

    folder: Path
    files: dict[str, int]
    """files of each rig"""
    bad: tuple[tuple[str, str, str], ...]
    """(rig, file, why) of files that could not be used"""
    skipped: tuple[tuple[str, str, str], ...]
    """(rig, file, why) of pushes left out of files that could"""
    fresh_files: int
    """files that were read in this run; the others were known"""
    fresh_parts: int
    """files of the data set that were made in this run"""
    without_stroke: tuple[str, ...] = ()
    """rigs whose set-up gives none"""

    @property
    def pushes(self) -> pl.LazyFrame:
        """The data set, its columns those of `docs/formats.md`, with `rig` and `date`."""
        return data_set(self.folder)


def data_set(folder: str | os.PathLike) -> pl.LazyFrame:
    """The pushes that `identify_fleet` left in a folder, by rig, date, file and push."""
    files = sorted(Path(folder, DATA_SET).glob("rig=*/date=*/*.parquet"))
    return pl.concat([pl.scan_parquet(path, hive_partitioning=False) for path in files])


def identify_fleet(
    archive: str | os.PathLike,
    out: str | os.PathLike,
    *,
    setup: str | os.PathLike | None = None,
    n_workers: int = 1,
    scheduler: str | None = None,
    use_data_mass: bool = False,
    tell: Tell = silent,
) -> Fleet:
    """mu_s of every push of an archive (`fleet_archive.find`), into `out`, goes on where an
    earlier run ended.

    `n_workers` processes of one thread each, or the workers of a dask `scheduler` (an address),
    which must see archive and `out` under the same paths; one worker is this process. One run at a
    time may write to a folder. `tell(what, share done)` hears of the progress.

    Raises `InputError` where no file can be used, for files without a set-up, for a `setup` that
    cannot be read, without dask.distributed, and where `out` cannot be written.
    """
    out = Path(out)
    tell("looking for files", 0.0)
    sources = find(archive, setup, out)
    setups, broken = setups_of(sources, setup)
    with open_folder(out), workers(n_workers, scheduler) as run:
        _tidy(out)
        parts = (out / STATE).absolute()
        made = not parts.exists()
        parts.mkdir(exist_ok=True)
        good = [s for s in sources if s.rig not in broken]
        bad = {s.name: broken[s.rig] for s in sources if s.rig in broken}
        table, fresh, found = _features(good, setups, parts, use_data_mass, run, tell)
        bad |= found
        if not len(table):
            if made:
                _remove(parts)
            first = next(iter(bad.items()))
            raise InputError(
                f"{archive}: none of {len(sources)} files can be used: {': '.join(first)}"
            )
        rig_of = {s.name: s.rig for s in sources}
        rows = table.filter(pl.col("skipped").list.len() > 0)
        skipped = [
            (rig_of[file], file, line)
            for file, lines in rows.select("file", "skipped").iter_rows()
            for line in lines
        ]
        again = _friction(table, rig_of, setups, out.absolute(), run, tell)
        listed = sorted((rig_of[file], file, why) for file, why in bad.items())
        _write_bad(out / "bad.csv", listed, skipped)
    files: dict[str, int] = {}
    for source in sources:
        files[source.rig] = files.get(source.rig, 0) + 1
    short = tuple(rig for rig, (x, _) in setups.items() if x.rig.pusher.stroke is None)
    return Fleet(out, files, tuple(listed), tuple(skipped), fresh, again, short)


def setups_of(
    sources: Sequence[Source], given: str | os.PathLike | None
) -> tuple[dict[str, tuple[Setup, str]], dict[str, str]]:
    """(each rig's set-up and a digest of its file, each rig's problem)."""
    found, broken = {}, {}
    for source in sources:
        if source.rig in found or source.rig in broken:
            continue
        try:
            text = Path(source.setup).read_bytes()
            found[source.rig] = read_setup(source.setup), hashlib.sha256(text).hexdigest()
        except (InputError, OSError) as error:
            if given is not None and source.setup == str(Path(given).absolute()):
                raise InputError(str(error)) from None
            broken[source.rig] = " ".join(str(error).split())
    return found, broken


def _features(
    sources, setups, parts: Path, use_data_mass: bool, run: Runner, tell: Tell
) -> tuple[pl.DataFrame, int, dict[str, str]]:
    """(the features of all files that can be used, how many were read, why of the others)."""
    rigs = {s.name: setups[s.rig][0].rig for s in sources}
    keys = {features.key_of(s, rigs[s.name], use_data_mass): s for s in sources}
    known = set(features.kept(parts, list(keys))["key"])
    new = [s for key, s in keys.items() if key not in known]
    bad: dict[str, str] = {}
    done = 0

    def task(some: Sequence[Source]) -> features.Task:
        own = tuple(rigs[s.name] for s in some)
        return features.Task(tuple(some), own, str(parts), use_data_mass)

    waiting = [task(some) for some in _shared_out(new)]
    while waiting:
        alone = []
        for one, found in run(features.extract, waiting):
            if isinstance(found, Lost):  # one of its files is too much for a process: which?
                if len(one.sources) == 1:
                    bad[one.sources[0].name] = f"its process died: {found}"
                alone += [task([s]) for s in one.sources if len(one.sources) > 1]
                continue
            bad |= dict(found)
            done += len(one.sources)
            tell(f"reading recordings, {done} of {len(new)}", 0.7 * done / len(new))
        waiting = alone
    features.unfinished(parts)
    return features.kept(parts, list(keys)), len(new), bad


def _shared_out(sources: Sequence[Source]) -> Iterator[list[Source]]:
    """Files of a task: up to `FILES`, and up to `BYTES` where that are several."""
    some: list[Source] = []
    for source in sources:
        if some and (len(some) == FILES or sum(s.size for s in some) + source.size > BYTES):
            yield some
            some = []
        some.append(source)
    if some:
        yield some


@dataclass(frozen=True)
class _Part:
    """A file of the data set that is to be made."""

    path: str
    key: str
    rig: str
    setup: Setup
    table: pl.DataFrame


def _friction(table, rig_of, setups, out: Path, run: Runner, tell: Tell) -> int:
    """Bring the data set to what the features and set-ups say; how many of its files were made."""
    ordered = table.with_columns(rig=pl.col("file").replace_strict(rig_of, return_dtype=pl.String))
    ordered = ordered.sort("rig", "date", "file", "push", maintain_order=True)
    expected: set[Path] = set()

    def missing() -> Iterator[_Part]:
        for (rig, date), rows in ordered.group_by("rig", "date", maintain_order=True):
            folder = out / DATA_SET / f"rig={escaped(str(rig))}" / f"date={date}"
            setup, digest = setups[rig]
            # A program takes either pushes or free slides.
            rows = rows.with_columns(slide=pl.col("velocity").is_null()).partition_by(
                "slide", include_key=False, maintain_order=True
            )
            pieces = [x.slice(i, ROWS) for x in rows for i in range(0, len(x), ROWS)]
            for i, piece in enumerate(pieces):
                path = folder / f"part-{i:04d}.parquet"
                expected.add(path)
                piece = piece.drop("key", "skipped")
                key = _key(piece, digest)
                if _said_key(path) != key:
                    yield _Part(str(path), key, str(rig), setup, piece)

    made = done = 0
    for some, result in run(_identify, _packed(missing())):
        if isinstance(result, Lost):
            raise InputError(f"identifying {some[0].rig}: its process died: {result}")
        made += len(some)
        done += sum(len(part.table) for part in some)
        tell(f"identifying, {done} of {len(ordered)} pushes", 0.7 + 0.3 * done / len(ordered))
    _only(out / DATA_SET, expected)
    return made


def _packed(parts: Iterable[_Part]) -> Iterator[list[_Part]]:
    """Parts put together to some `ROWS` pushes a task."""
    some: list[_Part] = []
    for part in parts:
        if some and sum(len(x.table) for x in some) + len(part.table) > ROWS:
            yield some
            some = []
        some.append(part)
    if some:
        yield some


def _identify(parts: list[_Part]) -> None:
    """A task of the second stage: identify, and write each part."""
    found = friction([(part.setup, features.pushes_of(part.table)) for part in parts])
    for part, columns in zip(parts, found, strict=True):
        whole = pl.concat([part.table, columns], how="horizontal")
        whole = whole.select("rig", "date", pl.exclude("rig", "date")).rechunk()
        Path(part.path).parent.mkdir(parents=True, exist_ok=True)
        write_whole(
            part.path, lambda file, t=whole, k=part.key: t.write_parquet(file, metadata={_KEY: k})
        )


def _key(table: pl.DataFrame, setup: str) -> str:
    """What a part is made from: its features, the set-up's file, this library."""
    # As text, to the last digit: the bytes of a frame tell how it was put together, too.
    content = table.write_csv()
    return hashlib.sha256(f"{MADE_WITH} {setup} {content}".encode()).hexdigest()[:32]


def _said_key(path: Path) -> str | None:
    try:
        return pl.read_parquet_metadata(path).get(_KEY)
    except (pl.exceptions.PolarsError, OSError):
        return None


def escaped(rig: str) -> str:
    """A rig's name as part of a folder's; those that end in a dot are not Windows's."""
    return quote(rig, safe="").replace(".", "%2E")


def _only(folder: Path, expected: set[Path]) -> None:
    """Remove what the data set no longer has, and what a kill left half-written."""
    for path, _, files in os.walk(folder, topdown=False):
        for name in files:
            if Path(path, name) not in expected:
                Path(path, name).unlink(missing_ok=True)
        if not os.listdir(path):
            os.rmdir(path)


def _tidy(out: Path) -> None:
    """Remove what a killed run had begun to write beside the data set."""
    for folder in out.glob(".writing-*"):
        shutil.rmtree(folder, ignore_errors=True)
    for file in out.glob(".bad.csv.*"):
        file.unlink(missing_ok=True)


def _remove(folder: Path) -> None:
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()


def _write_bad(path: Path, bad, skipped) -> None:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("rig", "file", "left_out", "reason"))
    rows.writerows((rig, file, "file", why) for rig, file, why in bad)
    rows.writerows((rig, file, "push", why) for rig, file, why in skipped)
    write_whole(path, lambda file: file.write(text.getvalue().encode()))
