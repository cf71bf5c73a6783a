"""mu_s from F_p and d at once, for a push that is known beforehand: the model over mu_s is ready.

`invert` looks for the crossings anew for each push, which takes longer than a push may.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import numpy as np
from numpy.typing import NDArray

from difffric.compute.xla_options import soon_compiled
from difffric.identification.crossing import find_crossing
from difffric.identification.inversion import BRACKET, Inversion, Quantity, answer_of
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.observables import observe

_POINTS = 1024
_CHUNK = 512  # points solved at once: always so many, so that one program is compiled
_MOST = 8  # crossings that are solved: always so many, so that one program is compiled


@dataclass(frozen=True)
class Curve:
    """F_p [N] and d [m] of a push over mu_s, on a grid of it."""

    rig: Rig
    """each number a NumPy array ()"""
    velocity: float
    integrator: object
    mu_s: NDArray
    both: NDArray
    """(2, n); NaN where a push has none"""

    @classmethod
    def of(cls, rig: Rig, velocity: float, integrator=None) -> Curve:
        """The curve of one push."""
        own = jax.tree.map(lambda leaf: np.asarray(leaf, float), rig)
        mu_s = np.geomspace(*BRACKET, _POINTS)
        both = _model(own, np.full(_POINTS, velocity), mu_s, integrator)
        return cls(own, velocity, integrator, mu_s, both)

    @property
    def spread(self) -> Rig:
        """The rig as one of several: each number an array (1,)."""
        return jax.tree.map(np.atleast_1d, self.rig)

    def at(self, mu_s: float) -> tuple[float, float]:
        """(F_p, d) at the grid's point next to this mu_s."""
        F, d = self.both[:, int(np.searchsorted(self.mu_s, mu_s))]
        return float(F), float(d)

    def invert(self, target: float, quantity: Quantity) -> Inversion:
        """mu_s from the measured quantity [N or m], NaN: not measured. As `invert`, but for two
        crossings closer to each other than 0.7 % of mu_s."""
        by_force = quantity == "peak_force"
        value = self.both[0 if by_force else 1]
        if not np.isfinite(target):
            name = "peak force" if by_force else "sliding distance"
            return Inversion(None, reason=f"no {name} was measured")
        below = value < target
        exists = np.isfinite(value)
        # An end on a jump of the model is a crossing too, which the solver then finds to be none.
        at = np.flatnonzero((below[1:] != below[:-1]) & (exists[1:] | exists[:-1]))[:_MOST]
        roots = self._roots(target, by_force, at, below[at]) if len(at) else []
        least = np.nanmin(value) if exists.any() else np.nan
        most = np.nanmax(value) if exists.any() else np.nan
        return answer_of(roots, target, quantity, BRACKET, (least, most))

    def _roots(self, target, by_force, at, rising) -> list[tuple[float, float]]:
        """(mu_s, slope) of the crossings in these cells of the grid."""
        cells = np.resize(at, _MOST)
        brackets = np.stack([self.mu_s[cells], self.mu_s[cells + 1]], axis=1)
        given = (np.asarray(x) for x in (self.velocity, float(target), by_force))
        found = _solved(self.rig, *given, brackets, np.resize(rising, _MOST), self.integrator)
        solved = zip(*(np.asarray(x)[: len(at)] for x in found), strict=True)
        return [(float(mu_s), float(slope)) for mu_s, slope, good in solved if good]

    def supported(self, distance: Inversion, peak_force: float) -> Inversion:
        """Among several mu_s for one distance, the one that the measured force supports."""
        if not distance.alternatives or np.isnan(peak_force):
            return distance
        force = np.interp(distance.alternatives, self.mu_s, self.both[0])
        return distance.at(int(np.argmin(np.abs(force - peak_force))))


def range_ratio(rig: Rig, velocity: NDArray, mu_s: NDArray, integrator=None) -> float:
    """Delta F / Delta d of equation (7) [N/m] over the grid of both."""
    v, mu = (x.ravel() for x in np.meshgrid(velocity, mu_s, indexing="ij"))
    own = jax.tree.map(lambda leaf: np.asarray(leaf, float), rig)
    F, d = _model(own, v, mu, integrator)
    return float(np.ptp(F) / (np.nanmax(d) - np.nanmin(d)))


def _model(rig: Rig, velocity: NDArray, mu_s: NDArray, integrator) -> NDArray:
    """F_p and d (2, n) of one rig at n speeds and mu_s."""
    found = []
    for lo in range(0, len(mu_s), _CHUNK):
        at = np.minimum(np.arange(lo, lo + _CHUNK), len(mu_s) - 1)
        found.append(np.stack(_observed(rig, velocity[at], mu_s[at], integrator)))
    return np.concatenate(found, axis=1)[:, : len(mu_s)]


@soon_compiled
def _observed(rig, velocity, mu_s, integrator):
    def one(velocity, mu_s):
        seen = observe(parameters.with_values(rig, {"mu_s": mu_s}), velocity, integrator)
        return seen.peak_force, seen.sliding_distance

    return jax.vmap(one)(velocity, mu_s)


@soon_compiled
def _solved(rig, velocity, target, by_force, brackets, rising, integrator):
    def one(bracket, rising):
        return find_crossing(rig, velocity, target, by_force, bracket, rising, integrator)

    return jax.vmap(one)(brackets, rising)
