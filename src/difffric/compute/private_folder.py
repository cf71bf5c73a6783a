"""Folders in which compiled programs are kept: this user's alone, as what they hold is run."""

from __future__ import annotations

import atexit
import os
import stat
from contextlib import suppress
from pathlib import Path

REFUSED = "not a folder that this user alone may write to"
_MARK = ".difffric-"
"""Files that say which processes, by number, may be writing."""


def make_private(folder: Path) -> bool:
    """Make the folder if need be. Whether it is there, and nobody else may write to it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        return is_private(os.lstat(folder))
    except OSError:
        return False


def is_private(status: os.stat_result) -> bool:
    """Whether what was looked at is this user's, no link, and nobody else may write it."""
    if not hasattr(os, "getuid"):
        return True
    others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return status.st_uid == os.getuid() and not others and not stat.S_ISLNK(status.st_mode)


def sweep(folder: Path) -> None:
    """Take out of the folder what a killed process may have left half-written, and tell the next
    processes that this one may be writing.

    For a cache whose files do not appear whole (JAX's): all that was written since the killed
    process began is removed, other processes' too, which make it anew.
    """
    with suppress(OSError):
        for mark in folder.glob(f"{_MARK}*"):
            if is_running(int(mark.name.removeprefix(_MARK))):
                continue
            since = mark.stat().st_mtime_ns
            for file in folder.iterdir():
                with suppress(OSError):
                    if not file.name.startswith(_MARK) and file.stat().st_mtime_ns >= since:
                        file.unlink()
            mark.unlink(missing_ok=True)
        own = folder / f"{_MARK}{os.getpid()}"
        own.touch()
        atexit.register(own.unlink, missing_ok=True)


def is_running(process: int) -> bool:
    """Whether there is a process of this number."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's, or not a question that this system answers
        return True
    return True
