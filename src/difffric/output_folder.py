"""Folders that results are written to, and answers in a form that JSON can hold."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from difffric import leftovers
from difffric.errors import InputError


def check_writable(folder: str | os.PathLike) -> Path:
    """Return the folder's path.

    Nothing is left behind: a folder that is not there yet is made by `open_folder`.

    Raises `InputError` where the folder cannot be written to, or cannot be made.
    """
    path = Path(folder)
    there = next(p for p in (path, *path.absolute().parents) if p.exists())
    if not there.is_dir():
        raise InputError(f"{there} is a file; --out needs a folder")
    try:
        with tempfile.NamedTemporaryFile(dir=there):
            pass
    except OSError as error:
        raise InputError(
            f"{path}: cannot write here ({error.strerror}); give another folder with --out"
        ) from error
    return path


@contextmanager
def open_folder(folder: str | os.PathLike) -> Iterator[Path]:
    """Make the folder if need be and yield its path.

    Where the work inside fails, a folder that was made for it and is still empty is removed again.

    Raises `InputError` where the folder cannot be written to, or cannot be made.
    """
    path = check_writable(folder)
    missing = [p for p in (path, *path.parents) if not p.exists()]
    path.mkdir(parents=True, exist_ok=True)
    try:
        with leftovers.guard(*reversed(missing), whole=False):
            yield path
    except BaseException:
        for made in missing:
            with suppress(OSError):  # it holds something after all
                made.rmdir()
        raise


def to_json_types(answer: Any) -> Any:
    """Return an answer as JSON can hold it: Python's own types, and null for what is no number."""
    import numpy as np  # here, as a command's help, which needs none, takes half as long again

    if isinstance(answer, Mapping):
        return {str(key): to_json_types(value) for key, value in answer.items()}
    if isinstance(answer, (list, tuple)):
        return [to_json_types(value) for value in answer]
    if isinstance(answer, (bool, np.bool_)):
        return bool(answer)
    if answer is None or isinstance(answer, str):
        return answer
    if isinstance(answer, (int, np.integer)):
        return int(answer)
    if np.ndim(answer) > 0:
        return to_json_types(np.asarray(answer).tolist())
    value = float(answer)
    return value if math.isfinite(value) else None
