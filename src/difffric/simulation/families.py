"""Curve families of the model over speed and mu_s (Figures II.5 and II.6)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from difffric.compute import pytrees
from difffric.compute.xla_options import compile_soon
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation import columns
from difffric.simulation.observables import observe
from difffric.simulation.segments import Integrator
from difffric.units import from_mm_min

if TYPE_CHECKING:
    from jaxtyping import ArrayLike, Float, Int

SPEEDS_MM_MIN = np.linspace(500.0, 5000.0, 19)
"""The speeds of the paper's experiments."""
MU_S = np.linspace(0.05, 0.30, 26)
"""The range over which (7)'s ranges are taken."""


@dataclass(frozen=True)
class Family:
    """F_p and d on a grid, one row a speed, one column a mu_s."""

    velocity: Float[NDArray, " speeds"]
    """[m/s]"""
    mu_s: Float[NDArray, " frictions"]
    peak_force: Float[NDArray, "speeds frictions"]
    """F_p [N]"""
    sliding_distance: Float[NDArray, "speeds frictions"]
    """d [m]; NaN where it does not exist"""
    regime: Int[NDArray, "speeds frictions"]
    """codes of `events.Regime`"""

    @property
    def range_ratio(self) -> float:
        """Delta F / Delta d of equation (7) [N/m]: ratio of the ranges over the whole grid."""
        return float(np.ptp(self.peak_force) / self._range_d)

    @property
    def _range_d(self) -> float:
        return np.nanmax(self.sliding_distance) - np.nanmin(self.sliding_distance)


@compile_soon
def _grid(rig, velocity, mu_s, integrator):
    import jax

    def one(velocity, mu_s):
        seen = observe(parameters.with_values(rig, {"mu_s": mu_s}), velocity, integrator)
        return seen.peak_force, seen.sliding_distance, seen.regime

    over_mu = jax.vmap(one, in_axes=(None, 0))
    return jax.vmap(over_mu, in_axes=(0, None))(velocity, mu_s)


def family(
    rig: Rig,
    velocity: Float[ArrayLike, " speeds"] | None = None,
    mu_s: Float[ArrayLike, " frictions"] | None = None,
    integrator: Integrator | None = None,
) -> Family:
    """The family over `velocity` [m/s] and `mu_s`; by default the range of the paper's
    experiments, 500-5000 mm/min and mu_s 0.05-0.30.

    `identification.surrogates` fits equations (3) and (5) to it.
    """
    speeds = from_mm_min(SPEEDS_MM_MIN) if velocity is None else np.asarray(velocity, float)
    frictions = MU_S if mu_s is None else np.asarray(mu_s, float)
    if columns.serves(rig, integrator) and speeds.size * frictions.size <= columns.MANY:
        v, mu_s = (x.ravel() for x in np.meshgrid(speeds, frictions, indexing="ij"))
        seen = columns.observe_columns(parameters.with_values(rig, {"mu_s": mu_s}), v)
        found = seen.peak_force, seen.sliding_distance, seen.regime
    else:
        found = _grid(*pytrees.as_arrays((rig, speeds, frictions)), integrator)
    F, d, regime = (np.asarray(x).reshape(speeds.size, frictions.size) for x in found)
    return Family(speeds, frictions, F, d, regime)
