"""How long each part of a piece of work took, and how many pushes were followed in it.

Whoever wants to know opens `keep_timings`; what computes tells `count_followed`, which costs
nothing where nobody listens.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict, dataclass, field
from threading import Lock
from typing import Any

_PLACE = re.compile(r"\s*\d+( of \d+)?$")
"""Which one of many a part is: all of them are told together."""


@dataclass
class Phase:
    """What one part of the work took."""

    seconds: float = 0.0
    """by the clock"""
    calls: int = 0
    """of programs that follow pushes"""
    pushes: int = 0
    """that were asked for"""
    pushes_computed: int = 0
    """the same with what filled up the calls"""
    directions: int = 0
    """in which pushes were differentiated, over all pushes"""
    directions_computed: int = 0
    """the same with what filled up the calls"""


@dataclass
class Timings:
    """The parts of a piece of work, in the order in which they began."""

    parts: dict[str, Phase] = field(default_factory=dict)
    _now: Phase = field(default_factory=Phase)
    _since: float = field(default_factory=time.perf_counter)
    _lock: Lock = field(default_factory=Lock)

    def begin(self, what: str) -> None:
        """End the part that was going on, and begin, or go on with, the one of this name."""
        now = time.perf_counter()
        self._now.seconds += now - self._since
        self._since = now
        self._now = self.parts.setdefault(_PLACE.sub("", what), Phase())

    def count(self, calls: int, pushes: tuple[int, int], directions: tuple[int, int]) -> None:
        """Add to the part that is going on; `pushes` and `directions` as asked for and as
        computed."""
        with self._lock:  # descents run beside each other
            part = self._now
            part.calls += calls
            part.pushes += pushes[0]
            part.pushes_computed += pushes[1]
            part.directions += directions[0]
            part.directions_computed += directions[1]

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """As `result.json` holds it: the parts by name."""
        self.begin("")
        return {name: asdict(part) for name, part in self.parts.items() if name}


_KEPT: ContextVar[Timings | None] = ContextVar("timings", default=None)


@contextmanager
def keep_timings() -> Iterator[Timings]:
    """Yield the timings of what is done within."""
    timings = Timings()
    token = _KEPT.set(timings)
    try:
        yield timings
    finally:
        _KEPT.reset(token)


def count_followed(
    calls: int, pushes: tuple[int, int], directions: tuple[int, int] = (0, 0)
) -> None:
    """Tell whoever keeps timings of `calls` that followed pushes; `pushes` and `directions` (over
    all pushes) as they were asked for and as they were computed."""
    timings = _KEPT.get()
    if timings is not None:
        timings.count(calls, pushes, directions)
