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
"""Endings of files of measured pushes."""
_WILD = "*?["
"""Characters that make a path a pattern."""


@dataclass(frozen=True)
class ArchiveFile:
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
    """Whether `data` names many files: a folder, or a pattern that is not itself a file."""
    path = Path(data)
    return path.is_dir() or (not path.exists() and any(c in str(data) for c in _WILD))


def find_files(
    archive: str | os.PathLike, setup: str | os.PathLike | None = None, out: Path | None = None
) -> list[ArchiveFile]:
    """List the `.tdms` and `.csv` files of an archive, sorted by name.

    `archive` is a folder, which is searched with all folders in it, or a pattern (`**` stands for
    any folders). A file's rig is the nearest folder upwards, not above the archive, that has a
    `setup.toml`; a file without one takes `setup`, and its rig is its own folder. Hidden files and
    folders (a leading dot) and what lies in `out` are passed over; links to folders are not
    followed.

    Raises `InputError` where nothing is found, and for files that have no set-up.
    """
    base, paths = _list_paths(archive)
    inside = None if out is None else out.resolve()
    found, without = [], []
    for path in sorted(paths):
        if inside is not None and path.resolve().is_relative_to(inside):
            continue
        own = _find_setup(path.parent, base)
        if own is None and setup is None:
            without.append(path)
            continue
        folder = path.parent if own is None else own.parent
        try:
            said = path.stat()
        except OSError:  # gone since, or a link to nothing: reading it says so
            said = None
        found.append(
            ArchiveFile(
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


def _list_paths(archive: str | os.PathLike) -> tuple[Path, list[Path]]:
    """Return the archive's folder and its files of measured pushes, as absolute paths."""
    if Path(archive).is_dir():
        base = Path(archive).absolute()
        return base, list(_walk(base))
    parts = Path(archive).parts
    wild = [any(c in part for c in _WILD) for part in parts]
    fixed = wild.index(True) if any(wild) else len(parts) - 1
    base = Path(*parts[:fixed]).absolute()
    named = map(Path, glob.glob(str(Path(archive).absolute()), recursive=True))
    return base, [path for path in named if _is_data(path) and path.is_file()]


def _walk(base: Path) -> Iterator[Path]:
    """Yield the files of measured pushes in a folder tree, hidden folders left out."""
    for folder, folders, files in os.walk(base):
        folders[:] = [name for name in folders if not name.startswith(".")]
        yield from (path for name in files if _is_data(path := Path(folder, name)))


def _is_data(path: Path) -> bool:
    return path.suffix.lower() in KINDS and not path.name.startswith(".")


def _find_setup(folder: Path, base: Path) -> Path | None:
    """Return the nearest set-up from a folder upwards to `base`, None where there is none."""
    for place in (folder, *folder.parents):
        if (place / SETUP).is_file():
            return place / SETUP
        if place == base:
            return None
    return None
