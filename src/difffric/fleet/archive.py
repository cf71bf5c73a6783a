"""A fleet's archive: which files it holds, which rig each belongs to, and that rig's set-up."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from difffric.errors import InputError

SETUP = "setup.toml"
KINDS = (".csv", ".tdms")
_WILD = "*?["


@dataclass(frozen=True)
class Source:
    """A file of measured pushes."""

    path: str
    """absolute"""
    name: str
    """relative to the archive, with forward slashes"""
    rig: str
    """the folder that holds its set-up, relative to the archive; `.` is the archive itself"""
    setup: str
    """absolute path of its setup.toml"""
    size: int
    """bytes"""
    changed: int
    """when its content was last written [ns since 1970]"""


def is_archive(data: str | os.PathLike) -> bool:
    """Whether DATA names many files: a folder, or a pattern that is not itself a file."""
    path = Path(data)
    return path.is_dir() or (not path.exists() and any(c in str(data) for c in _WILD))


def find(
    archive: str | os.PathLike, setup: str | os.PathLike | None = None, out: Path | None = None
) -> list[Source]:
    """The `.tdms` and `.csv` files of a folder tree or of a pattern (`**` for any folders), by
    name.

    A file's rig is the nearest folder upwards, not above the archive, that has a `setup.toml`.
    Without one it takes `setup`, and its rig is its own folder. What is hidden (a leading dot)
    and what lies in `out` is passed over. Links to folders are not followed.

    Raises `InputError` where nothing is found, and for files that have no set-up.
    """
    base, paths = _paths(archive)
    inside = None if out is None else out.resolve()
    found, without = [], []
    for path in sorted(paths):
        if inside is not None and path.resolve().is_relative_to(inside):
            continue
        own = _setup_of(path.parent, base)
        if own is None and setup is None:
            without.append(path)
            continue
        folder = path.parent if own is None else own.parent
        try:
            said = path.stat()
        except OSError:  # gone since, or a link to nothing: reading it says so
            said = None
        found.append(
            Source(
                path=str(path),
                name=path.relative_to(base).as_posix(),
                rig=folder.relative_to(base).as_posix(),
                setup=str(Path(setup or "").absolute() if own is None else own),
                size=-1 if said is None else said.st_size,
                changed=-1 if said is None else said.st_mtime_ns,
            )
        )
    if without:
        raise InputError(
            f"{without[0]}: no {SETUP} in its folder or above it, up to {base} "
            f"({len(without)} files are without one): give --setup"
        )
    if not found:
        raise InputError(f"{archive}: expected .tdms or .csv files, found none")
    return found


def _paths(archive: str | os.PathLike) -> tuple[Path, list[Path]]:
    """(the archive's folder, its files of measured pushes), absolute."""
    if Path(archive).is_dir():
        base = Path(archive).absolute()
        return base, list(_walked(base))
    parts = Path(archive).parts
    wild = [any(c in part for c in _WILD) for part in parts]
    fixed = wild.index(True) if any(wild) else len(parts) - 1
    base = Path(*parts[:fixed]).absolute()
    named = map(Path, glob.glob(str(Path(archive).absolute()), recursive=True))
    return base, [path for path in named if _is_data(path) and path.is_file()]


def _walked(base: Path) -> Iterator[Path]:
    for folder, folders, files in os.walk(base):
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield from (path for name in files if _is_data(path := Path(folder, name)))


def _is_data(path: Path) -> bool:
    return path.suffix.lower() in KINDS and not path.name.startswith(".")


def _setup_of(folder: Path, base: Path) -> Path | None:
    """The nearest set-up upwards."""
    for place in (folder, *folder.parents):
        if (place / SETUP).is_file():
            return place / SETUP
        if place == base:
            return None
    return None
