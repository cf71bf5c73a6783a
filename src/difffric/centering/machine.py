"""A machine that centres rings: what the loop asks of it, and one that is simulated."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from difffric.centering.landing import find_landings
from difffric.centering.ring import Ring, measure
from difffric.errors import NumericalError
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.segments import Integrator
from difffric.units import from_um, to_mm_min

READINGS = 72
"""Readings of the probe over a rotation: one every 5 degrees."""
_RADIUS = 0.1
"""Radius of the simulated ring [m]."""
_FORM = from_um(0.5)
"""Standard deviation of the simulated lobes' amplitudes [m]."""


class PushReadings(NamedTuple):
    """What is read of one push, each with its standard error, in SI units; NaN: there is none."""

    peak_force: float
    peak_force_se: float
    sliding_distance: float
    """NaN where the part rests in contact"""
    sliding_distance_se: float
    displacement: float
    """of the part, from its start to rest"""
    displacement_se: float
    duration: float
    """until tip and part stand"""


class Machine(Protocol):
    """A rotary table with a probe at the ring's surface, and a push tip at the same place."""

    def measure(self) -> Ring:
        """Turn the ring once and find its offset."""
        ...

    def push(self, velocity: float, stroke: float, direction: float) -> PushReadings:
        """Turn the ring until the encoder reads `direction` [rad] and push it towards the axis
        there, by the tip's `stroke` [m] at `velocity` [m/s]."""
        ...


class SimulatedMachine:
    """A rig before a push tip, its friction hidden: each push has a mu_s of its own about a mean
    that drifts. `offset` is the truth (2,) [m], `pushed_with` the mu_s of each push.

    The probe reads with normal noise [m], the force sensor likewise [N]. The ring's form has
    lobes of half a micrometre.
    """

    def __init__(
        self,
        rig: Rig,
        offset: NDArray,
        random: np.random.Generator,
        *,
        scatter: float = 0.015,
        drift: float = 0.0,
        noise_force: float = 0.5,
        noise_position: float = from_um(0.3),
        integrator: Integrator | None = None,
    ):
        self.rig, self.random, self.integrator = rig, random, integrator
        self.mean = float(parameters.values(rig)["mu_s"])
        self.offset = np.array(offset, float)
        self.scatter, self.drift = scatter, drift
        self.noise_force, self.noise_position = noise_force, noise_position
        self.form = random.normal(0.0, _FORM, (2, 3))
        self.pushed_with: list[float] = []

    def measure(self) -> Ring:
        """Turn the ring once and find its offset."""
        angle = 2 * np.pi * np.arange(READINGS) / READINGS
        e, phi = np.hypot(*self.offset), np.arctan2(self.offset[1], self.offset[0])
        own = angle + np.arcsin(e * np.sin(angle - phi) / _RADIUS)  # about the ring's centre
        lobes = sum(
            c * np.cos(n * own) + s * np.sin(n * own) for n, (c, s) in enumerate(self.form.T, 2)
        )
        true = e * np.cos(angle - phi)
        true = true + np.sqrt((_RADIUS + lobes) ** 2 - (e * np.sin(angle - phi)) ** 2)
        read = true + self.random.normal(0.0, self.noise_position, READINGS)
        return measure(angle, read, noise=self.noise_position)

    def push(self, velocity: float, stroke: float, direction: float) -> PushReadings:
        """Push the ring. Raises `NumericalError` for a push that cannot be followed."""
        mean = self.mean * np.exp(self.drift * len(self.pushed_with))
        mu_s = float(mean * np.exp(self.scatter * self.random.standard_normal()))
        found = find_landings(self.rig, velocity, stroke, mu_s, self.integrator)
        x, time, F, d = (float(a[0]) for a in found)
        if not np.isfinite(x):
            raise NumericalError(
                f"the simulated push at {to_mm_min(velocity):g} mm/min cannot be followed"
            )
        self.pushed_with.append(mu_s)
        self.offset = self.offset - x * np.array([np.cos(direction), np.sin(direction)])
        noise, twice = self.noise_position, np.sqrt(2) * self.noise_position
        moved = float(self.rig.probe.read(x)) - float(self.rig.probe.read(0.0))
        return PushReadings(
            peak_force=F + self.noise_force * self.random.standard_normal(),
            peak_force_se=self.noise_force,
            sliding_distance=d + noise * self.random.standard_normal(),
            sliding_distance_se=noise,
            displacement=moved + twice * self.random.standard_normal(),
            displacement_se=twice,
            duration=time,
        )
