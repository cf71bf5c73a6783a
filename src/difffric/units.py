"""Units at the edges: SI inside the library, everywhere. The only place that converts."""

from __future__ import annotations

from typing import Any

GRAVITY = 9.80665
"""Standard gravity g [m/s^2] (ISO 80000-3)."""

MM = 1e-3  # 1 mm in m
UM = 1e-6  # 1 µm in m
MV = 1e-3  # 1 mV in V
MM_PER_MIN = 1e-3 / 60.0  # 1 mm/min in m/s


def from_mm_min(velocity_mm_min: Any) -> Any:
    """mm/min to m/s, of a float or of an array, as all of these."""
    return velocity_mm_min * MM_PER_MIN


def to_mm_min(velocity: Any) -> Any:
    """m/s to mm/min."""
    return velocity / MM_PER_MIN


def from_um(length_um: Any) -> Any:
    """µm to m."""
    return length_um * UM


def to_um(length: Any) -> Any:
    """m to µm."""
    return length / UM


def from_mm(length_mm: Any) -> Any:
    """mm to m."""
    return length_mm * MM


def to_mm(length: Any) -> Any:
    """m to mm."""
    return length / MM
