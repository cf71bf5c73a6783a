"""Where a diagnosis looks for each effect: sizes, wavelengths and places on a coarse grid.

A strong effect defeats a linear prediction from its null, and some (a Stribeck speed, a
wavelength, a place) have none: there the search starts from a grid of values instead.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from difffric.rig.catalogue import CATALOGUE, numbers_of
from difffric.rig.scales import Scales
from difffric.units import GRAVITY

SMOOTH_AT_NULL = {
    "tilt", "normal_force", "friction_drift", "quadratic_drag", "static_dwell", "friction_ratio",
    "rebound_damping", "contact_hardening", "initial_gap", "pusher_speed", "pusher_ramp",
    "pusher_lag", "force_lowpass", "force_highpass", "force_gain", "force_offset", "probe_scale",
    "channel_skew", "sample_clipping", "release_threshold",
}  # fmt: skip
"""Effects whose first derivative at the null is there: they have a score test, and a search may
start from the null too."""

_EDGED = {"pusher_duration", "release_latch"}
"""Effects whose size each push crosses at an edge of its own, beyond which a fit is not led."""
_CLOSE = 24
"""Sizes of such an effect where they are close together."""


def list_starting_values(
    effect: str, scales: Scales, closely: bool = False
) -> list[dict[str, float]]:
    """Return the sizes [SI] from which an effect is looked for, each as `numbers_of` names them.

    The grids are coarse: they reach from where an effect begins to be seen in a push of these
    scales to where it is beyond doubt. `closely`: where each push has an edge of its own, as many
    sizes as find the right side of all of them.
    """
    names, sizes = numbers_of(effect), list(_grid_of(effect, scales))
    if closely and effect in _EDGED:
        every = np.array(sizes, float)
        sizes = [*np.geomspace(every.min(), every.max(), _CLOSE)]
    return [dict(zip(names, np.atleast_1d(x).tolist(), strict=True)) for x in sizes]


def find_contact_time(s: Scales) -> float:
    """How long the part and the tip touch for, about [s]: half a period of the contact."""
    return float(np.pi * np.sqrt(s.mass * s.compression / s.peak))


def _grid_of(effect: str, s: Scales) -> Iterable[ArrayLike]:
    """Return the values of an effect's numbers: a number, or one for each of them, an item."""
    signs = (-1.0, 1.0)
    weight = s.mass * GRAVITY
    match effect:
        case "tilt":
            return [a * x for a in signs for x in (0.003, 0.02)]
        case "normal_force":
            return [a * x * weight for a in signs for x in (0.03, 0.2)]
        case "friction_drift":
            return [a * x for a in signs for x in (0.03, 0.2)]
        case "friction_ratio":
            return [0.55, 0.67, 0.70, 0.72, 0.735, 0.765, 0.78, 0.80, 0.84, 0.95]
        case "stribeck":
            return np.geomspace(0.04 * s.slowest, 8 * s.fastest, 12)
        case "quadratic_drag":
            return [x * s.mu_s * weight / s.fastest**2 for x in (0.03, 0.3)]
        case "static_dwell":
            return np.geomspace(0.005, 0.2, 12)
        case "presliding":
            return [(x, 0.4 * np.sqrt(x * s.mass)) for x in (1e6, 3e6, 1e7, 3e7, 1e8, 3e8)]
        case "rebound_damping":
            return [x * np.sqrt(s.mass * s.peak / s.compression) for x in (0.06, 0.25, 0.8)]
        case "contact_hardening":
            return [1.08, 1.25, 1.5, 1.9]
        case "initial_gap":
            return np.geomspace(2e-6, 0.6 * s.travel, 7)
        case "pusher_speed":
            return [0.9, 0.97, 1.03, 1.1]
        case "pusher_ramp":
            return s.fastest / np.array([3e-4, 2e-3, 1e-2, 4e-2])
        case "pusher_lag":
            return [1e-4, 5e-4, 2e-3, 8e-3]
        case "pusher_duration":
            by_way = [x * s.travel / v for v in (s.slowest, s.fastest) for x in (0.3, 0.6, 0.9)]
            return [*by_way, *(x * find_contact_time(s) for x in (1.5, 2.2, 2.6, 3.2))]
        case "force_lowpass":
            return [3e-5, 2e-4, 1e-3, 4e-3]
        case "force_highpass":
            return [0.05, 0.3, 2.0]
        case "force_gain":
            return [0.9, 0.97, 1.03, 1.1]
        case "force_offset":
            return [a * x * s.peak for a in signs for x in (0.01, 0.05)]
        case "force_saturation":
            return [x * s.peak for x in (0.5, 0.75, 0.9, 0.97, 0.995)]
        case "sample_clipping":
            return [300.0, 1000.0, 4000.0]
        case "probe_scale":
            return [0.95, 0.99, 1.01, 1.05]
        case "release_threshold":
            return [x * s.peak for x in (0.01, 0.04, 0.12)]
        case "release_latch":
            return [x * s.peak for x in (0.005, 0.03, 0.1, 0.3, 0.8)]
        case "channel_skew":
            return [3e-5, 2e-4, 1e-3]
        case _:
            keys = CATALOGUE[effect].keys
            return [[key.typical for key in keys if not key.fixed]]
