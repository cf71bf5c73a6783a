"""The scales of some pushes: how fast, how far and how hard, on which effects of a rig show."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import NDArray


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
