"""Folders in which compiled programs are kept: this user's alone, as what they hold is run."""

from __future__ import annotations

import atexit
import os
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: there two processes may make the same
    fcntl = None

FOLDER = "DIFFFRIC_PROGRAMS"
"""Environment variable: where programs are kept; unset or empty: nowhere."""
REFUSED = "not a folder that this user alone may write to"
_MARK = ".difffric-"
"""Files that say which processes, by number, may be writing."""
_PATIENCE = 600.0
"""How long [s] one waits for another that holds a lock: a process that was stopped holds it on."""
_GLANCE = 0.02
"""Between two looks at a lock [s]: nothing beside what is made under one."""


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


@contextmanager
def hold(path: Path) -> Iterator[None]:
    """Hold the lock of this name against threads and processes; wait until it is free. The system
    frees that of a process which has ended. Where there are no locks, none is held."""
    handle = _lock(path)
    try:
        yield
    finally:
        if handle is not None:
            with suppress(OSError):
                path.unlink()
            os.close(handle)


def _lock(path: Path) -> int | None:
    """The lock's file, open; None where there are no locks, or patience has ended."""
    end = time.monotonic() + _PATIENCE
    while fcntl is not None and time.monotonic() < end:
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError:
            return None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(handle).st_ino == os.stat(path).st_ino:
                return handle
        except (BlockingIOError, FileNotFoundError):
            pass  # held; or just let go and removed
        except OSError:  # this file system has none
            os.close(handle)
            return None
        os.close(handle)
        time.sleep(_GLANCE)
    return None
