"""The processor's cores that this process may use."""

from __future__ import annotations

import os


def count_cores() -> int:
    """How many there are, at least 1: those that the system lets it run on, where it says so."""
    if hasattr(os, "sched_getaffinity"):  # not on Windows, nor on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
