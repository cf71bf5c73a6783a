"""What is written on the way to a whole file or folder, and must not stay where a process ends.

A process that is told to end while compiled code runs may not get back to the line that tidies up:
whoever ends it calls `remove_leftovers` first.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock

PLACING = Lock()
"""Is held while the files of a folder take their places, which is all or nothing: whoever ends the
process waits for it."""
_BEGUN: list[tuple[Path, bool]] = []
"""The files and folders that this process is about to make or is filling, in the order in which it
began; and whether all that is in a folder goes with it."""


@contextmanager
def guard(*paths: Path, whole: bool = True) -> Iterator[None]:
    """Say that these files or folders are of no use before what is done within has ended; who does
    it removes or renames them itself. Folders go with all that is in them, unless not `whole`: then
    only where they are empty."""
    entries = [(path, whole) for path in paths]
    _BEGUN.extend(entries)
    try:
        yield
    finally:
        for entry in entries:
            _BEGUN.remove(entry)


def remove_leftovers() -> None:
    """Remove all that is begun and not done, the last first."""
    for path, whole in reversed(_BEGUN.copy()):
        with suppress(OSError):
            if not path.is_dir():
                path.unlink()
            elif whole:
                # Another thread may just be removing it, too.
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.rmdir()
