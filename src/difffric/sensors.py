"""Sensors as plain data: what the force sensor and the probe can resolve."""

from __future__ import annotations

import equinox as eqx


class ForceSensor(eqx.Module):
    """The piezoelectric sensor in the push tip; defaults are the paper's."""

    sensitivity: float = 11.2e-3
    """[V/N]"""
    range: float = 446.0
    """[N], either sign"""
    rate: float = 200e3
    """[Hz]"""
    noise: float | None = None
    """Standard deviation of one sample [N]; None: not known"""


class Probe(eqx.Module):
    """The digital linear probe on the part; defaults are the paper's."""

    resolution: float = 20e-9
    """[m]"""
    noise: float | None = None
    """Standard deviation of one reading [m]; None: not known"""
