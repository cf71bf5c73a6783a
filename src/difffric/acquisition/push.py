"""A push as it is commanded, and as it was recorded."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from difffric.acquisition.hardware_check import Hardware
from difffric.errors import InputError


@dataclass(frozen=True)
class Command:
    """One push to make. Raises `InputError` for what the card's registers cannot hold."""

    velocity: float
    """[m/s]"""
    stroke: float
    """[m]"""
    mass: float = math.nan
    """[kg]; NaN: not said"""
    condition: str = ""

    def __post_init__(self):
        for name, unit in (("velocity", "m/s"), ("stroke", "m")):
            value = getattr(self, name)
            if not 1 <= value * 1e9 < 2**32:
                raise InputError(f"{name}: expected 1e-9 to 4.29 {unit}, got {value:g}")


@dataclass(frozen=True)
class Acquired:
    """What was recorded of one push."""

    name: str
    """of the file's group"""
    command: Command
    rate: float
    """[Hz]"""
    samples: int
    """in the file: all up to the first one lost"""
    lost: int
    """taken by the card and not in the file"""
    hardware: Hardware
    """what the card itself saw"""
    fault: str = ""
    """why the samples are not to be trusted; empty where they are"""
    began: float = field(default=math.nan, compare=False)
    """when the push was started, by the host's clock [s]"""
    ended: float = field(default=math.nan, compare=False)
    """when its last sample was taken"""

    @property
    def troubles(self) -> list[str]:
        """What is wrong with the recorded push, a line each."""
        found = [f"{self.lost} samples lost" if self.lost else "", self.fault]
        return [*filter(None, found), *self.hardware.problems]
