"""Measured pushes: what was commanded and what was read, one entry a push, in SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.errors import InputError

_NOT_MEASURED: Any = None  # what may be left out; an instance holds NaN there

_POSITIVE = (
    "velocity",
    "sliding_distance",
    "mass",
    "stroke",
    "peak_force",
    "mu_s_gauge",
    "peak_force_se",
    "sliding_distance_se",
)


@dataclass(frozen=True)
class Pushes:
    """n measured pushes. Every field but `velocity` is optional; NaN: not measured.

    Raises `InputError` for lengths that differ and values that are not positive.
    """

    velocity: NDArray
    """[m/s]"""
    peak_force: NDArray = _NOT_MEASURED
    """F_p [N]"""
    sliding_distance: NDArray = _NOT_MEASURED
    """d [m]"""
    mu_s_gauge: NDArray = _NOT_MEASURED
    """mu_s known from elsewhere"""
    mass: NDArray = _NOT_MEASURED
    """[kg], where it differs from the rig's"""
    stroke: NDArray = _NOT_MEASURED
    """[m], where it differs from the rig's"""
    condition: Sequence[str] = _NOT_MEASURED
    peak_force_se: NDArray = _NOT_MEASURED
    """standard error of F_p [N]"""
    sliding_distance_se: NDArray = _NOT_MEASURED
    """standard error of d [m]"""

    def __post_init__(self):
        n = len(np.atleast_1d(self.velocity))
        if n == 0:
            raise InputError("no pushes: at least one is needed")
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name == "condition":
                column = ("",) * n if value is None else tuple(value)
            elif value is None:
                column = np.full(n, np.nan)
            else:
                column = np.atleast_1d(np.asarray(value, float))
            if len(column) != n:
                raise InputError(f"{f.name} has {len(column)} entries, velocity has {n}")
            object.__setattr__(self, f.name, column)
        if not np.isfinite(self.velocity).all():
            raise InputError(f"velocity is not a number in push {_first(self.velocity, _bad)}")
        for name in _POSITIVE:
            column = getattr(self, name)
            if (column <= 0).any() or np.isinf(column).any():
                row = _first(column, lambda c: (c <= 0) | np.isinf(c))
                raise InputError(f"{name} of push {row} is {column[row]}: expected > 0")

    def __len__(self):
        return len(self.velocity)

    def select(self, keep) -> Pushes:
        """The pushes where `keep` (a mask or indices) says so."""
        index = np.arange(len(self))[keep]
        changed = {
            f.name: tuple(self.condition[i] for i in index)
            if f.name == "condition"
            else getattr(self, f.name)[index]
            for f in fields(self)
        }
        return replace(self, **changed)


def _bad(column):
    return ~np.isfinite(column)


def _first(column, bad):
    return int(np.argmax(bad(column)))
