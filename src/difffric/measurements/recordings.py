"""Recorded pushes: force and position over time, a recording a push, read when asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.errors import InputError


@dataclass(frozen=True)
class Channel:
    """Equally spaced samples of one quantity, read on demand so that none need be in memory.

    `unit` is `N`, `m`, or `V` for a force that the sensor's sensitivity has yet to scale.
    """

    n: int
    """number of samples"""
    dt: float
    """sampling interval [s]"""
    start: float
    """time of the first sample [s], relative to the start of the pusher's motion"""
    unit: str
    read: Callable[[int, int], NDArray]
    """samples lo <= i < hi, in `unit`"""

    @classmethod
    def of(cls, samples: ArrayLike, dt: float, start: float, unit: str) -> Channel:
        """A channel in memory."""
        whole = np.asarray(samples, float)
        return cls(len(whole), float(dt), float(start), unit, lambda lo, hi: whole[lo:hi])

    @property
    def time(self) -> NDArray:
        """Times of all samples [s]."""
        return self.start + self.dt * np.arange(self.n)

    @property
    def samples(self) -> NDArray:
        """All samples."""
        return self.read(0, self.n)

    def chunks(self, size: int = 1 << 20) -> Iterator[NDArray]:
        """All samples, at most `size` at a time."""
        for lo in range(0, self.n, size):
            yield self.read(lo, min(lo + size, self.n))

    def between(self, t_0: float, t_1: float) -> tuple[NDArray, NDArray]:
        """(times [s], samples) with t_0 <= time < t_1; nothing else is read."""
        lo, hi = (int(np.clip(np.ceil((t - self.start) / self.dt), 0, self.n)) for t in (t_0, t_1))
        return self.start + self.dt * np.arange(lo, hi), self.read(lo, max(lo, hi))

    def scale(self, factor: float, unit: str) -> Channel:
        """The same samples times a factor, in another unit."""
        read = self.read
        return replace(self, unit=unit, read=lambda lo, hi: factor * read(lo, hi))


@dataclass(frozen=True)
class Recording:
    """One recorded push, SI units; None or NaN: not said. At least one channel is there."""

    velocity: float
    """[m/s]"""
    force: Channel | None = None
    position: Channel | None = None
    pusher: Channel | None = None
    mass: float = np.nan
    stroke: float = np.nan
    condition: str = ""
    mu_s_gauge: float = np.nan
    order: float = np.nan
    rest_before: float = np.nan
    """rest before the push [s]"""
    name: str = ""
    """of the file's group"""
    started: float = np.nan
    """when it was recorded [s since 1970, UTC]"""
    motion: Any = None
    """the tip's motion (`recorded_motion.SmoothedMotion`) where it drives the push; None: the tip
    goes at `velocity` up to its stroke"""

    def in_newtons(self, sensitivity: float) -> Recording:
        """The recording with its force in newtons; a force in volts is divided by the force
        sensor's sensitivity [V/N]."""
        if self.force is None or self.force.unit == "N":
            return self
        return replace(self, force=self.force.scale(1.0 / sensitivity, "N"))


@dataclass(frozen=True)
class Recordings(Sequence[Recording]):
    """Recorded pushes in the order of their pushing. Raises `InputError` where there is none."""

    pushes: tuple[Recording, ...]
    source: str = ""
    """the file they come from"""
    skipped: tuple[str, ...] = ()
    """what of the file was left out, a line each: only where that was asked for"""
    notes: tuple[str, ...] = ()
    """what was converted on reading, or found otherwise than usual, a line each"""

    def __post_init__(self):
        if not self.pushes:
            raise InputError(f"{self.source}: no pushes: at least one is needed".lstrip(": "))

    def __len__(self) -> int:
        return len(self.pushes)

    @overload
    def __getitem__(self, index: int) -> Recording: ...
    @overload
    def __getitem__(self, index: slice) -> Recordings: ...
    def __getitem__(self, index):
        if isinstance(index, slice):
            return replace(self, pushes=self.pushes[index])
        return self.pushes[index]

    def select(self, keep: NDArray | Sequence[int] | slice) -> Recordings:
        """The pushes that `keep` names: a mask (n,) or indices."""
        chosen = np.arange(len(self))[keep]
        return replace(self, pushes=tuple(self.pushes[i] for i in chosen))

    def in_newtons(self, sensitivity: float) -> Recordings:
        """The recordings with all forces in newtons, by the force sensor's sensitivity [V/N]."""
        return replace(self, pushes=tuple(push.in_newtons(sensitivity) for push in self.pushes))
