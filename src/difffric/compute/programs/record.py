"""What each compiled program cost: seconds to trace, compile, load and run it, and its size.

Calls are counted where the environment variable `FILE` names a file, to which each process adds a
line for each of its programs when it ends (`python -m benchmarks.programs` makes a table of them).
"""

from __future__ import annotations

import atexit
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

FILE = "DIFFFRIC_PROGRAM_LOG"
"""Environment variable: the file to which what programs cost is added; unset: to none."""

RECORDS: list[Record] = []
"""Of all programs that this process asked for, in the order in which it did."""

UNDER_WAY: list[tuple[Record, float]] = []
"""The programs that are being traced or compiled now, by whichever thread, and when each was begun,
by `time.perf_counter`."""


@dataclass
class Record:
    """What one program cost this process; times in seconds by the clock, sizes in bytes."""

    name: str
    key: str
    """how its file's name begins"""
    traced: float = 0.0
    compiled: float = 0.0
    size: int = 0
    loaded: float = 0.0
    runs: int = 0
    ran: float = 0.0

    @contextmanager
    def time(self, what: str) -> Iterator[None]:
        """Add the seconds of what is done within to `traced`, `compiled`, `loaded` or `ran`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            setattr(self, what, getattr(self, what) + time.perf_counter() - start)

    @contextmanager
    def announce(self) -> Iterator[None]:
        """Say, to whoever looks at `UNDER_WAY`, that the program is made within."""
        entry = (self, time.perf_counter())
        UNDER_WAY.append(entry)
        try:
            yield
        finally:
            UNDER_WAY.remove(entry)

    def watch(self, call: Callable) -> Callable:
        """The program; where a file is named, its calls are counted from now on."""
        RECORDS.append(self)
        if not os.environ.get(FILE):
            return call
        if len(RECORDS) == 1:
            atexit.register(_append)

        def run(arrays: list) -> Any:
            import jax

            with self.time("ran"):
                # A call comes back before its program has run.
                out = jax.block_until_ready(call(arrays))
            self.runs += 1
            return out

        return run


def _append() -> None:
    lines = [json.dumps(asdict(record)) + "\n" for record in RECORDS]
    with suppress(OSError), Path(os.environ[FILE]).open("a", encoding="utf-8") as file:
        file.write("".join(lines))


def read(path: Path) -> list[Record]:
    """The records in a file, in the order in which they were added."""
    with path.open(encoding="utf-8") as file:
        return [Record(**json.loads(line)) for line in file]
