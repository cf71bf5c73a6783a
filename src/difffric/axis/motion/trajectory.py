"""What a simulation of an axis gives: its motion over time, with derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

START, SPEED = "position_m", "speed_m_per_s"
"""Derivatives by the first position and speed go by these names."""


@dataclass(frozen=True)
class AxisTrajectory:
    """Where an axis is at the samples (n,) of its force."""

    time: NDArray
    position: NDArray
    speed: NDArray
    derivatives: Mapping[str, NDArray]
    """parameter -> (n,) of the position"""
    speed_derivatives: Mapping[str, NDArray]
    events: tuple[tuple[str, float], ...]
    """(`stick`, `break-away` or `reversal`, time [s])"""

    @property
    def peak_speed(self) -> float:
        """The largest speed [m/s]."""
        return float(np.max(np.abs(self.speed)))
