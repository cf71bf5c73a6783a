"""How long work took the last time: kept in the user's cache folder, for what is told of the next.

Nothing here is needed: what cannot be read or written is as if it had not been kept.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from difffric.atomic_files import write_whole
from difffric.errors import InputError

CACHE = "DIFFFRIC_CACHE"
"""Environment variable: the folder for what is kept from one command to the next; unset: none."""
_FILE = "durations.json"
_MOST = 100
"""Kinds of work that are kept, the newest ones."""
_LEAST = 3.0
"""Work that is shorter [s] needs no estimate."""


@dataclass(frozen=True)
class PastRun:
    """How a piece of work went: when which share of it was done."""

    shares: tuple[float, ...]
    """of the work, growing, the last of them 1"""
    seconds: tuple[float, ...]
    """from its beginning, as many"""

    @property
    def whole(self) -> float:
        """What it took in all [s]."""
        return self.seconds[-1]


def name_work(words: Sequence[str]) -> str:
    """Name the kind of work that a command line asks for: its command, its options without their
    values, and how large its files are, to a factor of two."""
    size = sum(os.path.getsize(word) for word in words if os.path.isfile(word))
    options = sorted({word.partition("=")[0] for word in words if word.startswith("--")})
    command = next((word for word in words if not word.startswith("-")), "")
    return " ".join([command, *options, f"2^{round(math.log2(size + 1))}"])


def read_course(work: str, compiled: bool) -> PastRun | None:
    """Return how such work went the last time that programs were `compiled` for it, or none were;
    None where that is not known."""
    found = _read()["courses"].get(_name_course(work, compiled))
    if not isinstance(found, dict):
        return None
    try:
        course = PastRun(tuple(map(float, found["shares"])), tuple(map(float, found["seconds"])))
    except (KeyError, TypeError, ValueError):
        return None
    good = len(course.shares) == len(course.seconds) > 1 and course.shares[-1] == 1.0
    return course if good and course.whole > 0 else None


def read_compile_times() -> dict[str, float]:
    """Return how long [s] each program took to compile the last time, by its name."""
    times = _read()["programs"]
    return {name: x for name, x in times.items() if isinstance(x, (int, float)) and x > 0}


def keep_durations(work: str, compiled: bool, course: PastRun, programs: dict[str, float]) -> None:
    """Keep how a piece of work went, and how long [s] its programs took to compile."""
    folder = os.environ.get(CACHE)
    if not folder or (course.whole < _LEAST and not programs):
        return
    kept = _read()
    if course.whole >= _LEAST:
        name = _name_course(work, compiled)
        kept["courses"].pop(name, None)  # the newest stand last
        kept["courses"][name] = {"shares": course.shares, "seconds": course.seconds}
    kept["programs"] |= programs
    for part, entries in kept.items():
        kept[part] = dict(list(entries.items())[-_MOST:])
    with suppress(OSError, InputError):
        Path(folder).mkdir(mode=0o700, parents=True, exist_ok=True)
        text = json.dumps(kept, indent=1)
        write_whole(Path(folder) / _FILE, lambda file: file.write(text.encode()))


def _name_course(work: str, compiled: bool) -> str:
    return f"{work}{', compiling' if compiled else ''}"


def _read() -> dict[str, dict[str, Any]]:
    found: Any = {}
    folder = os.environ.get(CACHE)
    if folder:
        with suppress(OSError, ValueError):
            found = json.loads((Path(folder) / _FILE).read_text(encoding="utf-8"))
    parts = {name: found.get(name) if isinstance(found, dict) else None for name in _PARTS}
    return {name: part if isinstance(part, dict) else {} for name, part in parts.items()}


_PARTS = ("courses", "programs")
"""What the file holds."""
