"""How large effects are drawn, and what of them is scaled: zero where the effect vanishes. SI."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tests.reference.effect_parameters import GRAVITY

TINIEST = 1e-7
"""of an effect's largest size: nothing smaller is tried"""


@dataclass(frozen=True)
class Amplitude:
    """The key that makes an effect large or small, and its largest size."""

    key: str
    most: float
    null: float = 0.0
    inverse: bool = False
    """whether the effect grows as the key falls: the size is its inverse"""
    least: float = 0.0
    """no smaller: below, it has no meaning, or cannot be computed"""
    narrow: float = 0.003
    """relative width of a bracket at which the search for a size ends"""

    def size(self, values: Mapping[str, float]) -> float:
        value = values[self.key]
        return 1 / value if self.inverse else value - self.null

    def scaled(self, values: Mapping[str, float], factor: float) -> dict[str, float]:
        """The values with `factor` times the size, at most the largest."""
        size = factor * self.size(values)
        size = math.copysign(min(abs(size), self.most), size)
        changed = dict(values)
        changed[self.key] = 1 / size if self.inverse else self.null + size
        if "sigma_1_N_s_per_m" in changed:  # the bristles' damping ratio stays
            changed["sigma_1_N_s_per_m"] *= abs(values[self.key] * size) ** -0.5
        return changed

    def factors(self, values: Mapping[str, float]) -> tuple[float, float]:
        """The factors that lead to the smallest and to the largest size."""
        size = abs(self.size(values))
        return max(self.least, TINIEST * self.most) / size, self.most / size


AMPLITUDES = {
    "stribeck": Amplitude("v_s_m_per_s", 0.3, least=5e-4),
    "presliding": Amplitude("sigma_0_N_per_m", 1 / 3e5, inverse=True, least=1e-8),
    "quadratic_drag": Amplitude("c_N_s2_per_m2", 1e5),
    "friction_waviness": Amplitude("amplitude", 0.9),
    "friction_patch": Amplitude("amplitude", 0.9),
    "friction_drift": Amplitude("drift", 0.8),
    "friction_ratio": Amplitude("ratio", 0.24, null=0.75),
    "static_dwell": Amplitude("amplitude", 0.3),
    "tilt": Amplitude("alpha_rad", 0.04),
    "normal_force": Amplitude("extra_N", 0.8 * 5 * GRAVITY),
    "contact_hardening": Amplitude("exponent", 1.0, null=1.0),
    "rebound_damping": Amplitude("b_N_s_per_m", 20e3),
    "initial_gap": Amplitude("gap_m", 1e-3),
    "pusher_ramp": Amplitude("acceleration_m_per_s2", 1.0, inverse=True),
    "pusher_lag": Amplitude("tau_s", 20e-3, least=5e-6),
    "pusher_ripple": Amplitude("amplitude", 0.8),
    "pusher_speed": Amplitude("factor", 0.5, null=1.0),
    "pusher_duration": Amplitude("duration_s", 1 / 1e-3, inverse=True, least=1 / 10, narrow=1e-6),
    "force_gain": Amplitude("factor", 0.5, null=1.0),
    "force_offset": Amplitude("offset_N", 100.0),
    "force_lowpass": Amplitude("tau_s", 20e-3, least=5e-6),
    "force_highpass": Amplitude("tau_s", 200.0, inverse=True),
    "force_saturation": Amplitude("level_N", 1.0, inverse=True),
    "sample_clipping": Amplitude("rate_Hz", 1e-2, inverse=True),
    "probe_scale": Amplitude("factor", 0.5, null=1.0),
    "release_threshold": Amplitude("threshold_N", 100.0),
    "release_latch": Amplitude("threshold_N", 1 / 0.1, inverse=True),
    "channel_skew": Amplitude("delay_s", 10e-3),
}


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def around(rng: np.random.Generator, typical: float) -> float:
    """Within a factor of 3 of the typical size."""
    return typical * log_uniform(rng, 1 / 3, 3)


def signed(rng: np.random.Generator, typical: float) -> float:
    return float(rng.choice([-1, 1])) * around(rng, typical)


def draw(
    effect: str,
    rng: np.random.Generator,
    rig: Mapping[str, float],
    mu_s: float,
    travel: float,
    peak: float,
) -> dict[str, float]:
    """An effect's values; `travel` [m] is how far the part typically goes, `peak` [N] the largest
    force without the effect."""
    m = rig["mass_kg"]
    weight, phase = m * GRAVITY, float(rng.uniform(0, 2 * np.pi))
    bristles, zeta = around(rng, 1e7), rng.uniform(0.05, 0.5)
    draws: dict[str, Callable[[], dict[str, float]]] = {
        "stribeck": lambda: {"v_s_m_per_s": around(rng, 0.02)},
        "presliding": lambda: {
            "sigma_0_N_per_m": bristles,
            "sigma_1_N_s_per_m": float(2 * zeta * np.sqrt(bristles * m)),
        },
        "quadratic_drag": lambda: {"c_N_s2_per_m2": around(rng, 200.0)},
        "friction_waviness": lambda: {
            "amplitude": around(rng, 0.1),
            "wavelength_m": around(rng, 1e-3),
            "phase_rad": phase,
        },
        "friction_patch": lambda: {
            "amplitude": signed(rng, 0.15),
            "start_m": float(rng.uniform(0.1, 0.8)) * travel,
        },
        "friction_drift": lambda: {"drift": signed(rng, 0.1)},
        "friction_ratio": lambda: {"ratio": 0.75 + signed(rng, 0.07)},
        "static_dwell": lambda: {"amplitude": around(rng, 0.03)},
        "tilt": lambda: {
            "alpha_rad": float(rng.choice([-1, 1])) * min(around(rng, 0.01), 0.3 * mu_s)
        },
        "normal_force": lambda: {
            "extra_N": float(rng.choice([-1, 1])) * min(around(rng, 10.0), 0.3 * weight)
        },
        "contact_hardening": lambda: {"exponent": 1 + around(rng, 0.2)},
        "rebound_damping": lambda: {"b_N_s_per_m": around(rng, 500.0)},
        "initial_gap": lambda: {"gap_m": around(rng, 5e-5)},
        "pusher_ramp": lambda: {"acceleration_m_per_s2": around(rng, 10.0)},
        "pusher_lag": lambda: {"tau_s": around(rng, 1e-3)},
        "pusher_ripple": lambda: {
            "amplitude": around(rng, 0.05),
            "period_m": around(rng, 1e-3),
            "phase_rad": phase,
        },
        "pusher_speed": lambda: {"factor": 1 + signed(rng, 0.02)},
        "pusher_duration": lambda: {"duration_s": around(rng, 0.03)},
        "force_gain": lambda: {"factor": 1 + signed(rng, 0.02)},
        "force_offset": lambda: {"offset_N": signed(rng, 1.0)},
        "force_lowpass": lambda: {"tau_s": around(rng, 1e-4)},
        "force_highpass": lambda: {"tau_s": around(rng, 0.5)},
        "force_saturation": lambda: {"level_N": peak * float(rng.uniform(0.6, 0.97))},
        "sample_clipping": lambda: {"rate_Hz": around(rng, 2000.0)},
        "probe_scale": lambda: {"factor": 1 + signed(rng, 0.01)},
        "release_threshold": lambda: {"threshold_N": around(rng, 5.0)},
        "release_latch": lambda: {"threshold_N": around(rng, 5.0)},
        "channel_skew": lambda: {"delay_s": around(rng, 1e-4)},
    }
    return {key: float(f"{value:.6g}") for key, value in draws[effect]().items()}
