"""A monitor's state file, which is whole or not there, belongs to one set-up, and is known to be
undamaged by a digest of its content."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from difffric.atomic_files import read_bytes, write_whole
from difffric.errors import InputError
from difffric.monitoring.monitor import Monitor
from difffric.rig.setup import Setup

VERSION = 1
"""Version of the file's layout; a file of another one is not read."""


def save(path: str | os.PathLike, monitor: Monitor, sources: list[dict]) -> None:
    """Write all that a monitor knows, and the files that were counted (`sources`).

    After a kill or a power cut the file is the old or the new one. Raises `InputError` where it
    cannot be written.
    """
    body = {"sources": sources, "monitor": monitor.as_dict()}
    text = json.dumps(body, allow_nan=False)
    head = {
        "difffric_monitor": VERSION,
        "setup": fingerprint(monitor.setup),
        "digest": _digest(text),
    }

    def write(file):
        file.write(f'{json.dumps(head)[:-1]}, "body": {text}}}\n'.encode())
        file.flush()
        os.fsync(file.fileno())

    write_whole(path, write)
    _keep_name(Path(os.path.realpath(path)).parent)


def load(path: str | os.PathLike, setup: Setup) -> tuple[Monitor, list[dict]]:
    """Read a state: return a monitor that goes on where the file's stopped, and the files counted.

    Raises `InputError` for a file that cannot be read, is damaged, of another version, or of
    another set-up; the file is left as it is.
    """
    damaged = f"{path}: a damaged state: expected what difffric monitor wrote; it is left as it is"
    try:
        found = json.loads(read_bytes(path))
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError):
        raise InputError(damaged) from None
    if not isinstance(found, Mapping) or "difffric_monitor" not in found:
        raise InputError(f"{path}: not a state of difffric monitor; it is left as it is")
    if found["difffric_monitor"] != VERSION:
        raise InputError(
            f"{path}: a state of version {found['difffric_monitor']}, expected {VERSION}"
        )
    body = found.get("body")
    if found.get("digest") != _digest(json.dumps(body)):
        raise InputError(damaged)
    if found.get("setup") != fingerprint(setup):
        raise InputError(
            f"{path}: the state of another set-up: expected the set-up that it was begun with, "
            "or a new --state"
        )
    assert body is not None
    return Monitor.read(setup, body["monitor"]), body["sources"]


def fingerprint(setup: Setup) -> str:
    """Digest of a set-up's numbers, to the last digit."""
    said = [_canonical(setup.rig), setup.mu_s_scatter]
    return _digest(json.dumps(said))


def _canonical(x) -> Any:
    """Return a law as its name and its numbers, laws within it likewise."""
    if dataclasses.is_dataclass(x):
        fields = [[f.name, _canonical(getattr(x, f.name))] for f in dataclasses.fields(x)]
        return [type(x).__name__, fields]
    if x is None or isinstance(x, bool | str):
        return x
    return repr(np.asarray(x, float).tolist())


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _keep_name(folder: Path) -> None:
    """Have the folder's entries, and so the file's name, on disk too, where the system can."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    except OSError:  # some file systems do not know how
        pass
    finally:
        os.close(handle)
