"""Writes effect_cases.npz: random pushes with effects, their answers and derivatives.

    REFERENCE_JIT=1 python -m tests.reference.make_effect_cases [--only GROUP ...]

For each effect, pushes with that effect alone; under `all`, with 3 to 6 of them at once, none of
LATER. With `--only` the other groups stay as they stand in the file. No case
lies near an edge: the course of events stays as it is under a relative change of 2e-3 of any
parameter. `effect_cases.load` reads the file.

It holds, a row a case: `group` (index into `groups`), `parameters` (columns `names`, every effect's
at its null value where it is off), `peak_force`, `sliding_distance` (nan where there is none),
`regime` (index into `regimes`), `contacts`, `sticks` (how often the part came to rest), `rebounds`,
`steps`, `peak_contact` and `peak_sample` (where the peak lies), `saturated`; `d_peak_force` and
`d_sliding_distance`, the derivatives in `derivative_names`, nan in what the case has not;
`derivative_error`, the largest estimated error of those of F_p and of d, relative to the largest of
the case, all of them logarithmic.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from pathlib import Path

import numpy as np

from . import effects
from .effect_derivatives import ENOUGH, answer, derivative, step_scale
from .effect_parameters import BASE, EFFECTS, INF, NAMES, TABLE, own, vector
from .jit import COMPILED

FILE = Path(__file__).with_name("effect_cases.npz")
SEED = 20250117
LATER = ("pusher_duration", "release_latch")  # whose cases came behind those of all others
GROUPS = (*EFFECTS, "all")
SEEDED = (*(group for group in GROUPS if group not in LATER), *LATER)
PER_EFFECT = 200
WITHOUT_D = 0.3  # at most this share of a group's cases ends in contact
STICKY = 0.15  # share of rigs that stick and slip: slow, heavy, hardly damped, with a stroke
CAUGHT = {"pusher_duration": 0.4, "release_latch": 0.85}  # share of rigs caught again, by intent
ACCEPTED = 2e-9  # error of a derivative, relative to the push's largest logarithmic one
MM_MIN = 1 / 60e3
DERIVATIVES = (
    *(name for name in BASE if name != "stroke_m"),
    *(name for effect in EFFECTS for name in own(effect) if "." in name),
)
KEPT = (
    *("peak_force", "sliding_distance", "regime", "contacts", "sticks", "rebounds", "steps"),
    *("peak_contact", "peak_sample", "saturated", "derivative_error"),
)


def _log_uniform(rng, lo, hi):
    return float(np.exp(rng.uniform(np.log(lo), np.log(hi))))


def _sign(rng):
    return float(rng.choice([-1, 1]))


def base(rng) -> dict:
    m, k = _log_uniform(rng, 2, 30), _log_uniform(rng, 1e5, 10**6.3)
    zeta = _log_uniform(rng, 0.03, 1.1)
    if rng.random() < STICKY:
        return {
            "mass_kg": rng.uniform(10, 30),
            "mu_s": rng.uniform(0.15, 0.3),
            "mu_k_over_mu_s": rng.uniform(0.6, 0.85),
            "k_v_N_s_per_m": rng.uniform(0, 20),
            "k_N_per_m": _log_uniform(rng, 1e5, 5e5),
            "b_N_s_per_m": _log_uniform(rng, 10, 150),
            "velocity_m_per_s": _log_uniform(rng, 500, 1000) * MM_MIN,
            "stroke_m": rng.uniform(0.5e-3, 2.5e-3),
        }
    return {
        "mass_kg": m,
        "mu_s": _log_uniform(rng, 0.05, 0.3),
        "mu_k_over_mu_s": rng.choice([0.75, rng.uniform(0.6, 0.95)]),
        "k_v_N_s_per_m": rng.choice([0.0, rng.uniform(0, 60)], p=[0.05, 0.95]),
        "k_N_per_m": k,
        "b_N_s_per_m": 2 * zeta * np.sqrt(k * m),
        "velocity_m_per_s": _log_uniform(rng, 500, 4000) * MM_MIN,
        "stroke_m": rng.choice([INF, _log_uniform(rng, 0.5e-3, 2.5e-3)]),
    }


def caught(group: str, rng) -> dict:
    """What makes a push go on after the first loss of contact: it is slow, and the tip goes on."""
    slow = {"velocity_m_per_s": _log_uniform(rng, 500, 1500) * MM_MIN}
    return slow | ({"stroke_m": rng.uniform(0.5e-3, 2.5e-3)} if group == "release_latch" else {})


def sizes(effect: str, rng, rig: dict, peak: float) -> dict:
    """The effect's parameters, from clearly visible to strong; peak is F_p without it."""
    phase = rng.uniform(0, 2 * np.pi)
    m, weight = rig["mass_kg"], rig["mass_kg"] * 9.80665
    bristles = _log_uniform(rng, 1e6, 2e7)
    dahl = rig["k_v_N_s_per_m"] / m > 1 and rng.random() < 0.1  # else it swings for minutes
    zeta = 0.0 if dahl else rng.uniform(0.05, 0.5)
    shortest = 20e-3 if rig["velocity_m_per_s"] < 1500 * MM_MIN else 2e-3  # that catches it again
    return {
        "stribeck": lambda: {"v_s_m_per_s": _log_uniform(rng, 2e-3, 0.05)},
        "presliding": lambda: {
            "sigma_0_N_per_m": bristles,
            "sigma_1_N_s_per_m": 2 * zeta * np.sqrt(bristles * m),
        },
        "quadratic_drag": lambda: {"c_N_s2_per_m2": _log_uniform(rng, 20, 2000)},
        "friction_waviness": lambda: {
            "amplitude": _log_uniform(rng, 0.02, 0.3),
            "wavelength_m": _log_uniform(rng, 0.3e-3, 5e-3),
            "phase_rad": phase,
        },
        "friction_patch": lambda: {
            "amplitude": _sign(rng) * _log_uniform(rng, 0.03, 0.4),
            "start_m": _log_uniform(rng, 0.02e-3, 2.5e-3),
        },
        "friction_drift": lambda: {
            "drift": _sign(rng) * _log_uniform(rng, 0.02, 0.3),
            "place": rng.uniform(0, 1),
        },
        "friction_ratio": lambda: {"mu_k_over_mu_s": rng.uniform(0.45, 0.98)},
        "static_dwell": lambda: {
            "amplitude": _log_uniform(rng, 0.01, 0.05),
            "rest_s": _log_uniform(rng, 1, 1e4),
        },
        "tilt": lambda: {"alpha_rad": _sign(rng) * rig["mu_s"] * rng.uniform(0.03, 0.4)},
        "normal_force": lambda: {"extra_N": weight * _sign(rng) * _log_uniform(rng, 0.03, 0.4)},
        "contact_hardening": lambda: {"exponent": rng.uniform(1.05, 1.8)},
        "rebound_damping": lambda: {
            "b_N_s_per_m": 2 * rng.uniform(0.02, 0.8) * np.sqrt(rig["k_N_per_m"] * m)
        },
        "initial_gap": lambda: {"gap_m": _log_uniform(rng, 5e-6, 300e-6)},
        "pusher_ramp": lambda: {"acceleration_m_per_s2": _log_uniform(rng, 1, 50)},
        "pusher_lag": lambda: {"tau_s": _log_uniform(rng, 1e-4, 5e-3)},
        "pusher_ripple": lambda: {
            "amplitude": _log_uniform(rng, 0.01, 0.1),
            "period_m": _log_uniform(rng, 0.2e-3, 2e-3),
            "phase_rad": phase,
        },
        "pusher_speed": lambda: {"factor": 1 + _sign(rng) * _log_uniform(rng, 0.01, 0.2)},
        "pusher_duration": lambda: {"duration_s": _log_uniform(rng, shortest, 60e-3)},
        "force_gain": lambda: {"factor": 1 + _sign(rng) * _log_uniform(rng, 0.01, 0.2)},
        "force_offset": lambda: {"offset_N": _sign(rng) * _log_uniform(rng, 0.3, 20)},
        "force_lowpass": lambda: {"tau_s": _log_uniform(rng, 20e-6, 2e-3)},
        "force_highpass": lambda: {"tau_s": _log_uniform(rng, 10e-3, 1)},
        "force_saturation": lambda: {
            "level_N": peak * rng.choice([rng.uniform(0.5, 0.99), rng.uniform(1.01, 1.5)])
        },
        "sample_clipping": lambda: {"rate_Hz": _log_uniform(rng, 200, 20e3)},
        "probe_scale": lambda: {"factor": 1 + _sign(rng) * _log_uniform(rng, 0.01, 0.2)},
        "release_threshold": lambda: {"threshold_N": _log_uniform(rng, 0.5, 20)},
        "release_latch": lambda: {"threshold_N": _log_uniform(rng, 0.5, 20)},
        "channel_skew": lambda: {"delay_s": _log_uniform(rng, 10e-6, 1e-3)},
    }[effect]()


def draw(group: str, rng) -> dict:
    """A rig of the group, its numbers short."""
    rig = base(rng)
    if group in CAUGHT and rng.random() < CAUGHT[group]:
        rig |= caught(group, rng)
    if group == "all":
        pool = [effect for effect in EFFECTS if effect not in ("presliding", *LATER)]
        chosen = sorted(rng.choice(len(pool), rng.integers(3, 7), replace=False))
        chosen = [pool[i] for i in chosen]
    else:
        chosen = [group]
    peak = effects.answer(vector(rig))[0]
    for effect in chosen:
        for key, value in sizes(effect, rng, rig, 100.0 if np.isnan(peak) else peak).items():
            rig[key if effect == "friction_ratio" else f"{effect}.{key}"] = value
    return {name: float(f"{value:.6g}") for name, value in rig.items()}


def case(rig: dict):
    """The answers with their derivatives; None near an edge or where there is no answer."""
    numbers = vector(rig)
    middle = answer(numbers)
    counts = middle[2]
    if counts[effects.REASON] > 0 or counts[effects.PEAK_LATE] == 1:
        return None
    slopes = np.full((2, len(DERIVATIVES)), np.nan)
    errors, largest = np.zeros(2), np.zeros(2)
    active = [name for name in rig if np.isfinite(rig[name])]
    for name in active:
        if name in ("stroke_m", *DERIVATIVES):
            scale = step_scale(name, numbers)
            found = derivative(numbers, name, scale, middle)
            if found is None:
                return None
            if name == "stroke_m":
                continue
            nothing = abs(found[0]) * scale < ENOUGH * abs(np.array(middle[:2]))
            slopes[:, DERIVATIVES.index(name)] = np.where(nothing, 0.0, found[0])
            errors = np.fmax(errors, found[1] * scale)
            largest = np.fmax(largest, abs(found[0]) * abs(rig[name]))
    relative = errors / np.where(largest > 0, largest, 1)
    if np.isnan(middle[1]):
        relative[1], slopes[1] = 0.0, np.nan
    return middle, slopes, relative


def group_cases(group: str, number: int, rng):
    """The group's cases, and why the others were turned down."""
    found, turned_down = [], Counter()
    while len(found) < number:
        rig = draw(group, rng)
        made = case(rig)
        if made is None:
            turned_down["edge or no answer"] += 1
            continue
        middle, slopes, relative = made
        if max(relative) > ACCEPTED:
            turned_down["derivatives"] += 1
            continue
        if np.isnan(middle[1]):
            if turned_down["kept without d"] >= WITHOUT_D * number:
                continue
            turned_down["kept without d"] += 1
        found.append((rig, middle, slopes, relative))
    return found, turned_down


def columns(cases) -> dict[str, np.ndarray]:
    """What the file holds of the cases of a group, but for which group it is."""
    counts = np.array([middle[2] for _, middle, _, _ in cases])
    return {
        "parameters": np.array([vector(rig) for rig, *_ in cases]),
        "peak_force": np.array([middle[0] for _, middle, *_ in cases]),
        "sliding_distance": np.array([middle[1] for _, middle, *_ in cases]),
        "regime": counts[:, effects.REGIME].astype(np.int8),
        "contacts": counts[:, effects.CONTACTS].astype(np.int8),
        "sticks": counts[:, effects.STICKS].astype(np.int16),
        "rebounds": counts[:, effects.REBOUNDS].astype(np.int16),
        "steps": counts[:, effects.STEPS].astype(np.int32),
        "peak_contact": counts[:, effects.PEAK_CONTACT].astype(np.int8),
        "peak_sample": counts[:, effects.PEAK_SAMPLE].astype(np.int32),
        "saturated": np.array([middle[3] for _, middle, *_ in cases]),
        "d_peak_force": np.array([slopes[0] for *_, slopes, _ in cases]),
        "d_sliding_distance": np.array([slopes[1] for *_, slopes, _ in cases]),
        "derivative_error": np.array([relative for *_, relative in cases], np.float32),
    }


def kept(stored: dict, group: str) -> dict[str, np.ndarray]:
    """The same of a group as it stands in a file: parameters that the file has not are at null."""
    rows = stored["group"] == list(stored["groups"]).index(group)
    found = {key: stored[key][rows] for key in KEPT}
    found["parameters"] = np.tile([TABLE[name] for name in NAMES], (rows.sum(), 1))
    found["parameters"][:, [NAMES.index(name) for name in stored["names"]]] = stored["parameters"][
        rows
    ]
    for key in ("d_peak_force", "d_sliding_distance"):
        found[key] = np.full((rows.sum(), len(DERIVATIVES)), np.nan)
        at = [DERIVATIVES.index(name) for name in stored["derivative_names"]]
        found[key][:, at] = stored[key][rows]
    return found


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--number", type=int, default=PER_EFFECT)
    options.add_argument("--out", default=str(FILE))
    options.add_argument("--only", nargs="+", choices=GROUPS, default=GROUPS, metavar="GROUP")
    options = options.parse_args()
    if not COMPILED:
        raise SystemExit("set REFERENCE_JIT=1, or this takes hours")
    began, parts = time.perf_counter(), []
    stored = dict(np.load(FILE)) if set(options.only) != set(GROUPS) else {}
    for group in GROUPS:
        if group not in options.only:
            parts.append(kept(stored, group))
            continue
        rng = np.random.default_rng([SEED, SEEDED.index(group)])
        found, turned_down = group_cases(group, options.number, rng)
        worst = np.max([relative for *_, relative in found], axis=0)
        took = time.perf_counter() - began
        print(f"{group}: {dict(turned_down)}, {worst}, {took:.0f} s", flush=True)
        parts.append(columns(found))
    np.savez_compressed(
        options.out,
        names=np.array(NAMES),
        groups=np.array(GROUPS),
        regimes=np.array(effects.REGIMES),
        derivative_names=np.array(DERIVATIVES),
        group=np.repeat(np.arange(len(GROUPS), dtype=np.int8), [len(x["steps"]) for x in parts]),
        **{key: np.concatenate([part[key] for part in parts]) for key in parts[0]},
    )
    number = sum(len(part["steps"]) for part in parts)
    print(number, "cases,", Path(options.out).stat().st_size, "bytes", end=", ")
    print(f"{time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
