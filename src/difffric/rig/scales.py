"""The scales of some pushes: how fast, how far and how hard, on which effects of a rig show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_FIRST_PLACE = 0.04
"""The first place on the rails that counts as one, as a share of the shortest way."""


@dataclass(frozen=True)
class Scales:
    """What pushes are like: the scales on which effects would show."""

    mass: float
    mu_s: float
    fastest: float
    """[m/s]"""
    slowest: float
    peak: float
    """largest force [N]"""
    reach: float
    """how far the part gets [m]"""
    travel: float
    """how far the tip does, about [m]"""
    compression: float
    """of the contact at the peak [m]"""
    ways: NDArray
    """(n,) how far the part gets in each push, about [m]"""
    tips: NDArray
    """(n,) how far the tip goes in each until contact is lost, about [m]"""

    @property
    def first_place(self) -> float:
        """The first place [m] where friction may change: if it did so where the part hardly moves
        yet, nearly all that slides would be beyond it, which is another mu_s."""
        return _FIRST_PLACE * float(np.min(self.ways))
