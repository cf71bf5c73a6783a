"""Measured pushes: what was commanded and what was read, one entry a push, in SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.compute.pytrees import pick
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
    "release_velocity",
    "release_velocity_se",
)


@dataclass(frozen=True)
class Pushes:
    """n measured pushes, or free slides where `release_velocity` stands for `velocity`. Every
    other field is optional; NaN: not measured.

    Raises `InputError` for lengths that differ and values that are not positive.
    """

    velocity: NDArray = _NOT_MEASURED
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
    release_velocity: NDArray = _NOT_MEASURED
    """the part's speed where it lost contact [m/s]"""
    release_velocity_se: NDArray = _NOT_MEASURED
    """its standard error [m/s]"""
    trial: NDArray = _NOT_MEASURED
    """number of the repetition"""
    order: NDArray = _NOT_MEASURED
    """place in the order of the pushes"""
    rest_before: NDArray = _NOT_MEASURED
    """rest before the push [s]"""
    motion: Any = None
    """the recorded motions that drive the tips (`rig.pusher.RecordedMotion`), stacked; None: they
    go at `velocity`"""
    source: str = ""
    """the file they come from"""
    skipped: tuple[str, ...] = ()
    """what of the file was left out, a line each: only where that was asked for"""
    notes: tuple[str, ...] = ()
    """what was converted on reading, or found otherwise than usual, a line each"""

    def __post_init__(self):
        first = self.release_velocity if self.velocity is None else self.velocity
        n = 0 if first is None else len(np.atleast_1d(first))
        if n == 0:
            raise InputError("no pushes: at least one is needed")
        for name in COLUMNS:
            value = getattr(self, name)
            if name == "condition":
                column = ("",) * n if value is None else tuple(value)
            elif value is None:
                column = np.full(n, np.nan)
            else:
                column = np.atleast_1d(np.asarray(value, float))
            if len(column) != n:
                raise InputError(f"{name} has {len(column)} entries, expected {n}")
            object.__setattr__(self, name, column)
        nothing = np.isnan(self.velocity) & np.isnan(self.release_velocity)
        if nothing.any() or np.isinf(self.velocity).any():
            row = int(np.argmax(nothing | np.isinf(self.velocity)))
            raise InputError(f"velocity is not a number in push {row}")
        for name in _POSITIVE:
            column = getattr(self, name)
            bad = (column <= 0) | np.isinf(column)
            if bad.any():
                row = int(np.argmax(bad))
                raise InputError(f"{name} of push {row} is {column[row]}: expected > 0")

    def __len__(self):
        return len(self.velocity)

    @property
    def no_pusher(self) -> str:
        """What a message says of a table where a recorded pusher is asked for."""
        return f"{self.source or 'the data'}: a table has no channel pusher"

    @property
    def free_slides(self) -> bool:
        """Whether only the slide from its release was measured, without a push."""
        return bool(np.isnan(self.velocity).all())

    def select(self, keep: NDArray | Sequence[int] | slice) -> Pushes:
        """The pushes that `keep` names: a mask (n,) or indices."""
        index = np.arange(len(self))[keep]
        changed = {name: getattr(self, name)[index] for name in COLUMNS if name != "condition"}
        motion = None if self.motion is None else pick(self.motion, index)
        chosen = tuple(self.condition[i] for i in index)
        return replace(self, **changed, condition=chosen, motion=motion)


_OF_ALL = ("motion", "source", "skipped", "notes")
COLUMNS = tuple(f.name for f in fields(Pushes) if f.name not in _OF_ALL)
"""The fields that have an entry a push."""
