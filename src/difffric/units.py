"""Units at the edges: SI inside the library, everywhere. The only place that converts."""

from __future__ import annotations

GRAVITY = 9.80665
"""Standard gravity g [m/s^2] (ISO 80000-3)."""

MM = 1e-3
UM = 1e-6
MV = 1e-3
MM_PER_MIN = 1e-3 / 60.0


def from_mm_min(velocity_mm_min):
    """mm/min to m/s."""
    return velocity_mm_min * MM_PER_MIN


def to_mm_min(velocity):
    """m/s to mm/min."""
    return velocity / MM_PER_MIN


def from_um(length_um):
    """µm to m."""
    return length_um * UM


def to_um(length):
    """m to µm."""
    return length / UM


def from_mm(length_mm):
    """mm to m."""
    return length_mm * MM


def to_mm(length):
    """m to mm."""
    return length / MM
