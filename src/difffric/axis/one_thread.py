"""Small matrices on one thread: OpenBLAS's threads wait for each other by spinning.

On a machine whose cores are busy, factors of 100 x 100 took seconds on two threads and less than a
millisecond on one. NumPy and SciPy bring a copy of OpenBLAS each; another BLAS is left as it is.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy
import scipy

_NAMES = ("scipy_openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads")


@contextmanager
def hold_one_thread() -> Iterator[None]:
    """Let OpenBLAS work on one thread inside, and as before afterwards."""
    found = _find_switches()
    before = [get() for get, _ in found]
    for _, set_threads in found:
        set_threads(1)
    try:
        yield
    finally:
        for (_, set_threads), threads in zip(found, before, strict=True):
            set_threads(threads)


@cache
def _find_switches() -> tuple[tuple[Any, Any], ...]:
    """The functions (get, set) of the OpenBLAS copies that are loaded; empty where there are none
    of this kind."""
    found = []
    for package in (numpy, scipy):
        folder = Path(str(package.__file__)).parent
        for library in [*folder.parent.glob(f"{folder.name}.libs/*openblas*")]:
            try:
                loaded = ctypes.CDLL(str(library))
            except OSError:
                continue
            for name in _NAMES:
                get = getattr(loaded, name.format("get"), None)
                set_threads = getattr(loaded, name.format("set"), None)
                if get is not None and set_threads is not None:
                    found.append((get, set_threads))
                    break
    return tuple(found)
