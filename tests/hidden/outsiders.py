"""What the catalogue does not have, by component. SI units.

Those of the mechanics are laws of `forms`; those of the sensors work on what is read, noise apart:

- force_quadratic: f (1 + share |f| / at); force_resonance: a second-order low-pass, undamped
  frequency [Hz] and damping ratio;
- probe_quadratic: x (1 + share x / at); probe_backlash: the first `width` of the way is not seen;
  probe_ripple: x + amplitude sin(2 pi x / period), as an interpolating encoder reads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import cont2discrete, lfilter

from tests.hidden.sizes import Amplitude, around, signed

SHARE = Amplitude("share", 0.9)


@dataclass(frozen=True)
class Scene:
    """What sizes are drawn by."""

    peak: float
    """largest F_p [N]"""
    compression: float
    """typical largest z [m]"""
    travel: float
    """typical way of the part [m]"""
    contact_travel: float
    """typical way of the tip in contact [m]"""


@dataclass(frozen=True)
class Outsider:
    """One cause outside the catalogue."""

    component: str
    amplitude: Amplitude
    draw: Callable[[np.random.Generator, Scene], dict[str, float]]


def _near(rng, low, high, of=1.0):
    return float(rng.uniform(low, high)) * of


TABLE = {
    "friction_rise": Outsider(
        "friction",
        SHARE,
        lambda rng, at: {"share": around(rng, 0.1), "speed": around(rng, 0.02)},
    ),
    "friction_bump": Outsider(
        "friction",
        SHARE,
        lambda rng, at: {
            "share": signed(rng, 0.15),
            "speed": _near(rng, 0.015, 0.03),
            "width": _near(rng, 0.003, 0.008),
        },
    ),
    "friction_wave": Outsider(
        "friction",
        SHARE,
        lambda rng, at: {"share": signed(rng, 0.08), "speed": _near(rng, 0.015, 0.04)},
    ),
    "friction_decay": Outsider(
        "friction",
        SHARE,
        lambda rng, at: {"share": signed(rng, 0.15), "length": _near(rng, 0.1, 0.5, at.travel)},
    ),
    "soft_layer": Outsider(
        "contact",
        SHARE,
        lambda rng, at: {
            "share": _near(rng, 0.2, 0.7),
            "depth": _near(rng, 0.15, 0.6, at.compression),
        },
    ),
    "softening": Outsider(
        "contact", Amplitude("share", 0.6), lambda rng, at: {"share": _near(rng, 0.08, 0.4)}
    ),
    "hysteresis": Outsider(
        "contact", Amplitude("per_speed", 3.0), lambda rng, at: {"per_speed": around(rng, 0.8)}
    ),
    "speed_sag": Outsider(
        "pusher",
        Amplitude("share", 0.6),
        lambda rng, at: {"share": signed(rng, 0.05), "length": at.contact_travel},
    ),
    "speed_dip": Outsider(
        "pusher",
        SHARE,
        lambda rng, at: {
            "share": _near(rng, 0.05, 0.4),
            "at": _near(rng, 0.2, 0.7, at.contact_travel),
            "width": _near(rng, 0.05, 0.15, at.contact_travel),
        },
    ),
    "speed_ring": Outsider(
        "pusher",
        SHARE,
        lambda rng, at: {
            "share": _near(rng, 0.04, 0.3),
            "tau": around(rng, 5e-3),
            "frequency": _near(rng, 80, 400),
        },
    ),
    "force_quadratic": Outsider(
        "force_sensor",
        Amplitude("share", 0.4),
        lambda rng, at: {"share": signed(rng, 0.04), "at": at.peak},
    ),
    "force_resonance": Outsider(
        "force_sensor",
        Amplitude("frequency", 1 / 50, inverse=True),
        lambda rng, at: {"frequency": around(rng, 400.0), "zeta": _near(rng, 0.15, 0.6)},
    ),
    "probe_quadratic": Outsider(
        "probe",
        Amplitude("share", 0.4),
        lambda rng, at: {"share": signed(rng, 0.03), "at": at.travel},
    ),
    "probe_backlash": Outsider(
        "probe", Amplitude("width", 3e-4), lambda rng, at: {"width": around(rng, 4e-6)}
    ),
    "probe_ripple": Outsider(
        "probe",
        Amplitude("amplitude", 1e-4),
        lambda rng, at: {"amplitude": around(rng, 2e-6), "period": around(rng, 0.2e-3)},
    ),
}


def position_read(outsider: Mapping[str, Mapping[str, float]], x: np.ndarray) -> np.ndarray:
    """What the probe shows of the way x [m] since the push began."""
    x = np.asarray(x, float)
    if values := outsider.get("probe_quadratic"):
        x = x * (1 + values["share"] * x / values["at"])
    if values := outsider.get("probe_ripple"):
        x = x + values["amplitude"] * np.sin(2 * np.pi * x / values["period"])
    if values := outsider.get("probe_backlash"):
        x = np.maximum(x - values["width"], 0.0)
    return x


def force_read(outsider: Mapping[str, Mapping[str, float]], force: np.ndarray) -> np.ndarray:
    """What a crooked force sensor shows of a force [N]; its resonance is `resonant`."""
    force = np.asarray(force, float)
    if values := outsider.get("force_quadratic"):
        force = force * (1 + values["share"] * np.abs(force) / values["at"])
    return force


def resonant(values: Mapping[str, float], force: np.ndarray, dt: float) -> np.ndarray:
    """The reading of a force [N] sampled every dt [s] from the push's start, at rest before it."""
    turn = 2 * np.pi * values["frequency"]
    system = ([turn**2], [1.0, 2 * values["zeta"] * turn, turn**2])
    discrete: Any = cont2discrete(system, dt, method="foh")
    return np.asarray(lfilter(np.ravel(discrete[0]), discrete[1], force))
