"""Identify an archive: many files of many rigs become one Parquet data set with mu_s of each push.

The work has two stages. For the features each file is read and reduced to F_p and d, some files a
task. For the friction mu_s of the pushes is identified, some thousands of them a task, whatever
rigs they come from. What is on disk is true at any moment: each file appears whole, under a name
and with a key that say what it was made from. So a run that was killed, or an archive that has
grown, goes on with what is missing, and ends with the data set of a single run, bit for bit.
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
from difffric.fleet.archive import ArchiveFile, find_files
from difffric.fleet.columns import identify_columns
from difffric.fleet.features import MADE_WITH
from difffric.fleet.workers import Lost, Runner, start_workers
from difffric.identification.push_models import are_many
from difffric.known_so_far import KEPT_ON_DISK, tell_known
from difffric.output_folder import open_folder
from difffric.progress import Tell, silent
from difffric.rig.setup import Setup, refuse_recorded_motion
from difffric.rig.setup_toml import read_setup

FILES = 32
"""Files that a task reads. More would make a kill cost more, fewer would cost scheduling."""
BYTES = 4_000_000
"""What a task reads at most where its files are long, for the same reason."""
ROWS = 8192
"""Pushes that a task identifies at most, and that a file of the data set holds."""
GOES_ON = "; the same command goes on from there"
"""How the sentence ends that says what a run has done when it is stopped."""
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
    """number of files that were read in this run; the others were known"""
    fresh_parts: int
    """number of files of the data set that were made in this run"""
    without_stroke: tuple[str, ...] = ()
    """rigs whose set-up gives no stroke"""

    @property
    def pushes(self) -> pl.LazyFrame:
        """The data set, with the columns of `docs/formats.md`, `rig` and `date` among them."""
        return data_set(self.folder)


def data_set(folder: str | os.PathLike) -> pl.LazyFrame:
    """Open the pushes that `identify_fleet` left in a folder, by rig, date, file and push."""
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
    """Identify mu_s of every push of an archive, into the folder `out`.

    `archive` and `setup` are as in `fleet.archive.find_files`. A run goes on where an earlier one
    into the same folder ended; one run at a time may write to a folder.

    The work is done by `n_workers` processes of one thread each (one worker is this process), or by
    the workers of a dask `scheduler` (its address), which must see `archive` and `out` under the
    same paths. `tell(what, share done)` hears of the progress.

    Raises `InputError` where no file can be used, for files without a set-up, for a `setup` that
    cannot be read, without dask.distributed, and where `out` cannot be written.
    """
    out = Path(out)
    tell("looking for files", 0.0)
    sources = find_files(archive, setup, out)
    setups, broken = read_setups(sources, setup)
    with open_folder(out), start_workers(n_workers, scheduler) as run:
        _tidy(out)
        parts = (out / STATE).absolute()
        made = not parts.exists()
        parts.mkdir(exist_ok=True)
        good = [s for s in sources if s.rig not in broken]
        bad = {s.name: broken[s.rig] for s in sources if s.rig in broken}
        table, fresh, found = _read_features(good, setups, parts, use_data_mass, run, tell)
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
        again = _identify_all(table, rig_of, setups, out.absolute(), run, tell)
        listed = sorted((rig_of[file], file, why) for file, why in bad.items())
        _write_bad(out / "bad.csv", listed, skipped)
    files: dict[str, int] = {}
    for source in sources:
        files[source.rig] = files.get(source.rig, 0) + 1
    short = tuple(rig for rig, (x, _) in setups.items() if x.rig.pusher.stroke is None)
    return Fleet(out, files, tuple(listed), tuple(skipped), fresh, again, short)


def read_setups(
    sources: Sequence[ArchiveFile], given: str | os.PathLike | None
) -> tuple[dict[str, tuple[Setup, str]], dict[str, str]]:
    """Read the set-ups of all rigs once.

    Returns rig -> its set-up and a digest of its file, and rig -> why its set-up cannot be used.

    Raises `InputError` where that is the set-up that was `given` for files without one.
    """
    found, broken = {}, {}
    for source in sources:
        if source.rig in found or source.rig in broken:
            continue
        try:
            text = Path(source.setup).read_bytes()
            known = read_setup(source.setup)
            refuse_recorded_motion(known, f"{source.setup}: a fleet is pushed at constant speed")
            found[source.rig] = known, hashlib.sha256(text).hexdigest()
        except (InputError, OSError) as error:
            if given is not None and source.setup == str(Path(given).absolute()):
                raise InputError(str(error)) from None
            broken[source.rig] = " ".join(str(error).split())
    return found, broken


def _read_features(
    sources, setups, parts: Path, use_data_mass: bool, run: Runner, tell: Tell
) -> tuple[pl.DataFrame, int, dict[str, str]]:
    """Run the first stage on all files that no part has yet.

    Returns the features of all files that can be used, how many files were read in this run, and
    file -> reason of those that cannot be used, those among them that earlier runs refused.
    """
    rigs = {s.name: setups[s.rig][0].rig for s in sources}
    keys = {features.make_key(s, rigs[s.name], use_data_mass): s for s in sources}
    known = set(features.load_kept(parts, list(keys))["key"])
    new = [s for key, s in keys.items() if key not in known]
    bad: dict[str, str] = {}
    done = 0

    def task(some: Sequence[ArchiveFile]) -> features.ReadTask:
        own = tuple(rigs[s.name] for s in some)
        return features.ReadTask(tuple(some), own, str(parts), use_data_mass)

    waiting = [task(some) for some in _share_out(new)]
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
            tell_known(KEPT_ON_DISK, f"{done} of {len(new)} files are read{GOES_ON}")
        waiting = alone
    features.remove_unfinished(parts)
    kept = features.load_kept(parts, list(keys))
    refused = kept.filter(pl.col("refused").is_not_null()).select("file", "refused")
    pushes = kept.filter(pl.col("refused").is_null())
    return pushes, len(new), bad | dict(refused.iter_rows())


def _share_out(sources: Sequence[ArchiveFile]) -> Iterator[list[ArchiveFile]]:
    """Share files out to tasks: up to `FILES` each, and up to `BYTES` where that is several."""
    some: list[ArchiveFile] = []
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
    compiled: bool
    """whether compiled programs serve: decided for the archive as a whole, so that an answer does
    not depend on what is identified together"""


def _identify_all(table, rig_of, setups, out: Path, run: Runner, tell: Tell) -> int:
    """Run the second stage: make the data set what the features and set-ups say.

    Returns how many of its files were made in this run.
    """
    ordered = table.with_columns(rig=pl.col("file").replace_strict(rig_of, return_dtype=pl.String))
    ordered = ordered.sort("rig", "date", "file", "push", maintain_order=True)
    expected: set[Path] = set()

    def missing() -> Iterator[_Part]:
        for (rig, date), rows in ordered.group_by("rig", "date", maintain_order=True):
            folder = out / DATA_SET / f"rig={escape(str(rig))}" / f"date={date}"
            setup, digest = setups[rig]
            # A program takes either pushes or free slides.
            rows = rows.with_columns(slide=pl.col("velocity").is_null()).partition_by(
                "slide", include_key=False, maintain_order=True
            )
            pieces = [x.slice(i, ROWS) for x in rows for i in range(0, len(x), ROWS)]
            for i, piece in enumerate(pieces):
                path = folder / f"part-{i:04d}.parquet"
                expected.add(path)
                piece = piece.drop("key", "skipped", "refused")
                key = _make_key(piece, digest)
                if _read_key(path) != key:
                    many = are_many(setup.rig, len(ordered))
                    yield _Part(str(path), key, str(rig), setup, piece, many)

    made = done = 0
    for some, result in run(_identify, _pack(missing())):
        if isinstance(result, Lost):
            raise InputError(f"identifying {some[0].rig}: its process died: {result}")
        made += len(some)
        done += sum(len(part.table) for part in some)
        tell(f"identifying, {done} of {len(ordered)} pushes", 0.7 + 0.3 * done / len(ordered))
        tell_known(KEPT_ON_DISK, f"{made} new files of the data set, each whole{GOES_ON}")
    _remove_others(out / DATA_SET, expected)
    return made


def _pack(parts: Iterable[_Part]) -> Iterator[list[_Part]]:
    """Put parts together to tasks of some `ROWS` pushes."""
    some: list[_Part] = []
    for part in parts:
        if some and sum(len(x.table) for x in some) + len(part.table) > ROWS:
            yield some
            some = []
        some.append(part)
    if some:
        yield some


def _identify(parts: list[_Part]) -> None:
    """Do a task of the second stage: identify the pushes and write each part."""
    for compiled in (False, True):
        _identify_parts([part for part in parts if part.compiled == compiled], compiled)


def _identify_parts(parts: list[_Part], compiled: bool) -> None:
    """Identify the pushes of some parts by one way of computing, and write each."""
    given = [(part.setup, features.to_pushes(part.table)) for part in parts]
    for part, columns in zip(parts, identify_columns(given, compiled), strict=True):
        whole = pl.concat([part.table, columns], how="horizontal")
        whole = whole.select("rig", "date", pl.exclude("rig", "date")).rechunk()
        Path(part.path).parent.mkdir(parents=True, exist_ok=True)
        write_whole(
            part.path, lambda file, t=whole, k=part.key: t.write_parquet(file, metadata={_KEY: k})
        )


def _make_key(table: pl.DataFrame, setup: str) -> str:
    """Digest of what a part is made from: its features, its set-up's file, this library."""
    # As text, to the last digit: the bytes of a frame tell how it was put together, too.
    content = table.write_csv()
    return hashlib.sha256(f"{MADE_WITH} {setup} {content}".encode()).hexdigest()[:32]


def _read_key(path: Path) -> str | None:
    """Return the key that a file of the data set was written with; None where there is no such."""
    try:
        return pl.read_parquet_metadata(path).get(_KEY)
    except (pl.exceptions.PolarsError, OSError):
        return None


def escape(rig: str) -> str:
    """Return a rig's name as a folder's name can hold it. A dot is escaped too, as Windows has no
    folders that end in one."""
    return quote(rig, safe="").replace(".", "%2E")


def _remove_others(folder: Path, expected: set[Path]) -> None:
    """Remove all files of a folder tree but those `expected`: what the data set no longer has, and
    what a kill left half-written."""
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
    """Remove a folder and the files in it."""
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()


def _write_bad(
    path: Path,
    bad: Iterable[tuple[str, str, str]],
    skipped: Iterable[tuple[str, str, str]],
) -> None:
    """Write the table of what was left out, from (rig, file, reason) of files and of pushes."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("rig", "file", "left_out", "reason"))
    rows.writerows((rig, file, "file", why) for rig, file, why in bad)
    rows.writerows((rig, file, "push", why) for rig, file, why in skipped)
    write_whole(path, lambda file: file.write(text.getvalue().encode()))
