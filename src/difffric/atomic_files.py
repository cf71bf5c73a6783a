"""Files read and written whole: a file appears complete or not at all."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from difffric import leftovers
from difffric.errors import InputError


def read_bytes(path: str | os.PathLike) -> bytes:
    """Read all of a file. Raises `InputError` where it cannot be read."""
    try:
        with open_file(path) as file:
            return file.read()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def open_file(path: str | os.PathLike) -> IO[bytes]:
    """Open a file for reading, without a buffer. Raises `InputError` where it cannot be."""
    if Path(path).is_dir():
        raise InputError(f"{path}: expected a file, got a folder")
    try:
        return open(path, "rb", buffering=0)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # a name with a NUL is a ValueError
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', error)}") from None


def write_whole(path: str | os.PathLike, write: Callable[[IO[bytes]], Any]) -> None:
    """Let `write` fill a file that then takes the path's place; where it fails nothing is left.

    Raises `InputError` where the path cannot be written.
    """
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.name}.{uuid.uuid4().hex}")
    try:
        with leftovers.guard(temporary):
            with open(temporary, "xb") as file:
                write(file)
            os.replace(temporary, target)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    finally:
        temporary.unlink(missing_ok=True)
