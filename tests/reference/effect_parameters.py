"""Every number that a push with effects depends on: its name, its null value, what its step is.

A push is a vector of these in the order of TABLE, then a few that follow from them (`prepare`).
"""

from __future__ import annotations

import math

import numpy as np

from .jit import jit

GRAVITY = 9.80665
INF = math.inf
BASE = (
    "mass_kg",
    "mu_s",
    "mu_k_over_mu_s",
    "k_v_N_s_per_m",
    "k_N_per_m",
    "b_N_s_per_m",
    "velocity_m_per_s",
    "stroke_m",
)
NULLS = {  # effect -> its keys and their null values; friction_ratio is mu_k_over_mu_s of BASE
    "stribeck": {"v_s_m_per_s": 0.0, "delta": 2.0},
    "presliding": {"sigma_0_N_per_m": 0.0, "sigma_1_N_s_per_m": 0.0},
    "quadratic_drag": {"c_N_s2_per_m2": 0.0},
    "friction_waviness": {"amplitude": 0.0, "wavelength_m": 1.0, "phase_rad": 0.0},
    "friction_patch": {"amplitude": 0.0, "start_m": INF},
    "friction_drift": {"drift": 0.0, "place": 0.0},  # place: 0 first push, 1 last one
    "friction_ratio": {},
    "static_dwell": {"amplitude": 0.0, "tau_s": 1.0, "rest_s": 0.0},
    "tilt": {"alpha_rad": 0.0},
    "normal_force": {"extra_N": 0.0},
    "contact_hardening": {"exponent": 1.0},
    "rebound_damping": {"b_N_s_per_m": 0.0},
    "initial_gap": {"gap_m": 0.0},
    "pusher_ramp": {"acceleration_m_per_s2": INF},
    "pusher_lag": {"tau_s": 0.0},
    "pusher_ripple": {"amplitude": 0.0, "period_m": 1.0, "phase_rad": 0.0},
    "pusher_speed": {"factor": 1.0},
    "pusher_duration": {"duration_s": INF},
    "force_gain": {"factor": 1.0},
    "force_offset": {"offset_N": 0.0},
    "force_lowpass": {"tau_s": 0.0},
    "force_highpass": {"tau_s": INF},
    "force_saturation": {"level_N": INF},
    "sample_clipping": {"rate_Hz": INF},
    "probe_scale": {"factor": 1.0},
    "release_threshold": {"threshold_N": 0.0},
    "release_latch": {"threshold_N": INF},
    "channel_skew": {"delay_s": 0.0},
}
EFFECTS = tuple(NULLS)
TABLE = dict.fromkeys(BASE, math.nan) | {"stroke_m": INF}
TABLE |= {f"{e}.{key}": null for e, keys in NULLS.items() for key, null in keys.items()}
NAMES = tuple(TABLE)
FIXED = {"stribeck.delta", "static_dwell.tau_s"}  # keys that nobody varies

(MASS, MU_S, RATIO, K_V, K, B, VELOCITY, STROKE) = range(8)
V_S, DELTA, SIGMA_0, SIGMA_1, DRAG = range(8, 13)
WAVE, WAVELENGTH, WAVE_PHASE, PATCH, PATCH_START, DRIFT, PLACE = range(13, 20)
DWELL, DWELL_TAU, REST, TILT, EXTRA, EXPONENT, REBOUND, GAP = range(20, 28)
ACCELERATION, LAG, RIPPLE, PERIOD, RIPPLE_PHASE, SPEED_FACTOR, DURATION = range(28, 35)
GAIN, OFFSET, LOWPASS, HIGHPASS, LEVEL, RATE = range(35, 41)
PROBE, THRESHOLD, LATCH, DELAY = range(41, 45)
# What follows from them: m g sin(alpha), F_N, mu_s and mu_k of this push, v, dwell's factor, scales
ALONG, LOAD, STATIC, KINETIC, SPEED, RESTED, Z_SCALE, F_SCALE = range(45, 53)
SIZE = 53
assert len(NAMES) == ALONG


def effect_of(name: str) -> str | None:
    return name.split(".")[0] if "." in name else None


def own(effect: str) -> list[str]:
    """The continuous parameters that an effect adds."""
    if effect == "friction_ratio":
        return ["mu_k_over_mu_s"]
    names = [f"{effect}.{key}" for key in NULLS[effect]]
    return [name for name in names if name not in FIXED]


def vector(rig: dict) -> np.ndarray:
    """The push as a vector; names left out stand at their null values, None is no stroke."""
    unknown = set(rig) - set(TABLE)
    if unknown:
        raise KeyError(f"unknown parameters {sorted(unknown)}")
    values = TABLE | {name: x for name, x in rig.items() if x is not None}
    return np.array([values[name] for name in NAMES], float)


def null_effects(**plain) -> np.ndarray:
    """A push without effects, in the arguments of `ode.push`."""
    arguments = ("m", "mu_s", "ratio", "k_v", "k", "b", "v", "stroke")
    return vector({BASE[arguments.index(name)]: x for name, x in plain.items()})


@jit
def prepare(vector):
    """The vector with what follows from it behind."""
    p = np.zeros(SIZE)
    p[:ALONG] = vector
    weight = p[MASS] * GRAVITY
    p[ALONG] = weight * math.sin(p[TILT])
    p[LOAD] = weight * math.cos(p[TILT]) + p[EXTRA]
    p[STATIC] = p[MU_S] * (1 + p[DRIFT] * p[PLACE])
    p[KINETIC] = p[RATIO] * p[STATIC]
    p[SPEED] = p[SPEED_FACTOR] * p[VELOCITY]
    p[RESTED] = 1 + p[DWELL] * math.log1p(p[REST] / p[DWELL_TAU])
    p[F_SCALE] = p[STATIC] * p[LOAD] + p[SPEED] * math.sqrt(p[K] * p[MASS])
    p[Z_SCALE] = p[F_SCALE] / p[K]
    return p
