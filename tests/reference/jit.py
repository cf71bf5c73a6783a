"""`jit` compiles with numba where the environment says REFERENCE_JIT=1, else does nothing."""

from __future__ import annotations

import os

COMPILED = os.environ.get("REFERENCE_JIT") == "1"


def jit(function):
    if not COMPILED:
        return function
    import numba

    return numba.njit(function, error_model="numpy")


def law(function):
    """Like jit, of a function that makes no arrays: counting references would cost more than it."""
    if not COMPILED:
        return function
    import numba

    return numba.njit(function, error_model="numpy", _nrt=False)
