"""Measurements that no value of the plain model's parameters can give."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.measurements.pushes import Pushes
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.units import GRAVITY

LEAST_RATIO = 0.6
"""mu_k / mu_s from which the bound holds: below, breakaway itself throws the part."""
_BEYOND = 3.0
"""Standard errors by which a measurement has to be out of reach."""


@dataclass(frozen=True)
class Certificate:
    """A measured distance that proves the plain model wrong: no k, b and k_v let a part get so
    far."""

    push: int
    """its place in the data, from 0"""
    velocity_m_per_s: float
    sliding_distance_m: float
    bound_m: float

    def as_dict(self) -> dict[str, Any]:
        """As `result.json` holds it."""
        return asdict(self)


def compute_lossless_bound(velocity: NDArray, mu_k: NDArray | float) -> NDArray:
    """Return the most that a rebound can give, d <= (2 v)^2 / (2 mu_k g) [m], for any k, b and k_v.

    A contact without loss throws the part at twice the pusher's `velocity` [m/s], and drag alone
    stops it. The bound holds for mu_k / mu_s >= 0.6.
    """
    return 4 * velocity**2 / (2 * mu_k * GRAVITY)


def find_unreachable(measured: Pushes, rig: Rig) -> tuple[Certificate, ...]:
    """Find the pushes of a known mu_s whose d is above the lossless bound.

    Where mu_s is not known, a small one explains any distance.
    """
    ratio = float(parameters.values(rig)["mu_k_over_mu_s"])
    if ratio < LEAST_RATIO or measured.free_slides:
        return ()
    bound = compute_lossless_bound(measured.velocity, ratio * measured.mu_s_gauge)
    over = measured.sliding_distance - _BEYOND * np.nan_to_num(measured.sliding_distance_se)
    return tuple(
        Certificate(
            int(i),
            float(measured.velocity[i]),
            float(measured.sliding_distance[i]),
            float(bound[i]),
        )
        for i in np.flatnonzero(over > bound)
    )
