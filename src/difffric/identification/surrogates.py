"""The paper's way: closed-form surrogates of F_p and d, equations (3) to (6), and their inverses.

Speeds in m/s, forces in N, distances in m outside; the coefficients are the paper's, in N,
mm/min and µm, because that is how they are printed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.errors import NumericalError
from difffric.simulation.families import Family
from difffric.units import from_um, to_mm_min, to_um


@dataclass(frozen=True)
class ForceSurrogate:
    """Equation (3): `F_p = C_v v + C_mu mu_s`; its inverse is equation (4)."""

    C_v: float
    """[N / (mm/min)]"""
    C_mu: float
    """[N]"""

    def peak_force(self, velocity: NDArray | float, mu_s: NDArray | float) -> Any:
        """F_p [N]."""
        return self.C_v * to_mm_min(velocity) + self.C_mu * mu_s

    def mu_s(self, velocity: NDArray | float, peak_force: NDArray | float) -> Any:
        """Equation (4)."""
        return (peak_force - self.C_v * to_mm_min(velocity)) / self.C_mu

    def slope(self, velocity: NDArray | float, mu_s: NDArray | float) -> Any:
        """dF_p/dmu_s [N]."""
        return self.C_mu * np.ones_like(velocity * mu_s)

    @classmethod
    def fit(
        cls, velocity: NDArray | float, mu_s: NDArray | float, peak_force: NDArray | float
    ) -> ForceSurrogate:
        """Least squares over all points given (NaN left out)."""
        v, mu, F = _finite(to_mm_min(velocity), mu_s, peak_force)
        (C_v, C_mu), *_ = np.linalg.lstsq(np.stack([v, mu], axis=1), F, rcond=None)
        return cls(float(C_v), float(C_mu))


@dataclass(frozen=True)
class DistanceSurrogate:
    """Equation (5): `d - d_0 = A (mu_s - mu_0)^2`, `d_0 = C_1 v^k1`, `A = C_2 v^k2`; its
    inverse is equation (6), on the branch mu_s < mu_0."""

    mu_0: float
    C_1: float
    k1: float
    C_2: float
    k2: float

    def sliding_distance(self, velocity: NDArray | float, mu_s: NDArray | float) -> Any:
        """d [m]."""
        d_0, A = self._coefficients(velocity)
        return from_um(d_0 + A * (mu_s - self.mu_0) ** 2)

    def mu_s(self, velocity: NDArray | float, sliding_distance: NDArray | float) -> Any:
        """Equation (6); NaN where d is below d_0, the least that (5) gives."""
        d_0, A = self._coefficients(velocity)
        square = np.asarray((to_um(sliding_distance) - d_0) / A)
        return self.mu_0 - np.sqrt(np.where(square >= 0, square, np.nan))

    def slope(self, velocity: NDArray | float, mu_s: NDArray | float) -> Any:
        """dd/dmu_s [m]."""
        return from_um(2 * self._coefficients(velocity)[1] * (mu_s - self.mu_0))

    def _coefficients(self, velocity):
        v = to_mm_min(velocity)
        return self.C_1 * v**self.k1, self.C_2 * v**self.k2

    @classmethod
    def fit(
        cls, velocity: NDArray | float, mu_s: NDArray | float, sliding_distance: NDArray | float
    ) -> DistanceSurrogate:
        """Least squares over all points given (NaN left out), from the published values.

        Raises `NumericalError` with fewer points than coefficients.
        """
        v, mu, d = _finite(velocity, mu_s, sliding_distance)
        if len(d) < 5:
            raise NumericalError(
                f"equation (5): {len(d)} pushes that slide cannot determine its 5 coefficients"
            )

        def surrogate(p):
            return cls(p[0], float(np.exp(p[1])), p[2], float(np.exp(p[3])), p[4])

        def misfit(p):
            return to_um(surrogate(p).sliding_distance(v, mu) - d)

        P = PUBLISHED_DISTANCE
        start = [P.mu_0, np.log(P.C_1), P.k1, np.log(P.C_2), P.k2]
        scales = [0.1, 1.0, 0.1, 1.0, 0.1]
        p = scipy.optimize.least_squares(misfit, start, x_scale=scales, max_nfev=2000).x
        return surrogate([float(x) for x in p])


def weigh_by_ranges(
    mu_force: NDArray | float,
    mu_dist: NDArray | float,
    dF: NDArray | float,
    dd: NDArray | float,
    ratio: NDArray | float,
) -> tuple[Any, Any, Any]:
    """Equation (7): mu_s* and its weights (force, distance), which sum to one.

    `dF` [N] and `dd` [m] are the derivatives by mu_s, of which magnitudes are meant (dd is
    negative); `ratio` is the ratio of the ranges of F_p and d [N/m].
    """
    w_F, w_d = np.abs(dF), np.abs(dd) * ratio
    force = w_F / (w_F + w_d)
    return force * mu_force + (1 - force) * mu_dist, force, 1 - force


def _finite(*columns):
    arrays = np.broadcast_arrays(*(np.asarray(c, float) for c in columns))
    flat = np.stack([a.ravel() for a in arrays])
    return flat[:, np.isfinite(flat).all(axis=0)]


def fit_force(family: Family) -> ForceSurrogate:
    """Equation (3) fitted to a family of curves."""
    v, mu = np.meshgrid(family.velocity, family.mu_s, indexing="ij")
    return ForceSurrogate.fit(v, mu, family.peak_force)


def fit_distance(family: Family) -> DistanceSurrogate:
    """Equation (5) fitted to a family of curves.

    Raises `NumericalError` with fewer pushes that slide than it has coefficients.
    """
    v, mu = np.meshgrid(family.velocity, family.mu_s, indexing="ij")
    return DistanceSurrogate.fit(v, mu, family.sliding_distance)


PUBLISHED_FORCE = ForceSurrogate(C_v=0.0529, C_mu=146.2)
"""Equation (4) as printed."""

PUBLISHED_DISTANCE = DistanceSurrogate(mu_0=0.3415, C_1=0.00041, k1=1.8997, C_2=0.07379, k2=1.6428)
"""Equation (6) as printed."""
