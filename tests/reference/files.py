"""Writes made data as the files that users have: recordings, tables, set-ups, the truth."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import polars as pl
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

from tests.reference.data import MM_MIN, Push, Recorded, Rig, rough_guess

LENGTHS = {"um": 1e-6, "mm": 1e-3, "m": 1.0}
COLUMNS = {  # name in memory -> name in the table, its unit
    "velocity": ("velocity_mm_min", MM_MIN),
    "release_velocity": ("release_velocity_mm_min", MM_MIN),
    "peak_force": ("peak_force_N", 1.0),
    "sliding_distance": ("sliding_distance_um", 1e-6),
    "mass": ("mass_kg", 1.0),
    "stroke": ("stroke_mm", 1e-3),
    "condition": ("condition", None),
    "mu_s_gauge": ("mu_s_gauge", 1.0),
    "trial": ("trial", 1.0),
    "order": ("order", 1.0),
    "rest_before": ("rest_before_s", 1.0),
    "peak_force_se": ("peak_force_se_N", 1.0),
    "sliding_distance_se": ("sliding_distance_se_um", 1e-6),
    "release_velocity_se": ("release_velocity_se_mm_min", MM_MIN),
}
INTEGERS = ("trial", "order")


def in_unit(value: float, unit: float, digits: int = 12) -> float:
    """The value in the unit, to so many digits, so that 500 mm/min reads 500.0."""
    return float(f"{value / unit:.{digits}g}")


def write_recordings(
    path: str | os.PathLike,
    recorded: Sequence[Recorded],
    *,
    position_unit: str = "um",
    sensitivity: float | None = None,
    omit: Sequence[str] = (),
) -> None:
    """A .tdms: a group a push. With a sensitivity [V/N] the force is in volts. `omit` names
    properties of the groups that are left out, such as stroke_mm."""

    def channel(group, name, samples, unit, one):
        waveform = {
            "unit_string": unit,
            "wf_increment": one.dt,
            "wf_start_offset": in_unit(one.start, 1.0),
            "wf_samples": len(samples),
        }
        return ChannelObject(group, name, np.asarray(samples, float), waveform)

    length = LENGTHS[position_unit]
    with TdmsWriter(path) as file:
        for i, one in enumerate(recorded):
            name, push = f"push {i + 1:04d}", one.push
            said = {
                "velocity_mm_min": in_unit(push.velocity, MM_MIN),
                "mass_kg": push.rig.m,
                "stroke_mm": None if push.stroke is None else in_unit(push.stroke, 1e-3),
                "order": push.order,
                "condition": push.condition,
            }
            said = {k: v for k, v in said.items() if v is not None and k not in omit}
            volts = sensitivity is not None
            force = one.force * sensitivity if volts else one.force
            objects = [
                GroupObject(name, said),
                channel(name, "force", force, "V" if volts else "N", one),
                channel(name, "position", to_unit(one.position, length), position_unit, one),
            ]
            if one.pusher is not None:
                pusher = to_unit(one.pusher, length)
                objects.append(channel(name, "pusher", pusher, position_unit, one))
            root = [RootObject({"description": "push recordings"})] if i == 0 else []
            file.write_segment(root + objects)


def to_unit(x: np.ndarray, unit: float) -> np.ndarray:
    """To whole picometres, so that 0.02 um reads 0.02."""
    return np.round(x / unit, 12 + round(math.log10(unit)))


def write_table(
    path: str | os.PathLike,
    columns: Mapping[str, np.ndarray],
    *,
    standard_errors: bool = True,
    omit: Sequence[str] = (),
    digits: int = 12,
) -> None:
    """A .csv: a row a push or slide, numbers to `digits`, an empty cell for NaN. `omit` names
    columns of the file that are left out; a column of nothing but NaN is left out too."""
    table = {}
    for ours, (theirs, unit) in COLUMNS.items():
        left_out = ours not in columns or theirs in omit
        if left_out or (ours.endswith("_se") and not standard_errors):
            continue
        if unit is None:
            table[theirs] = list(columns[ours])
            continue
        values = [None if np.isnan(x) else in_unit(x, unit, digits) for x in columns[ours]]
        if all(x is None for x in values):
            continue
        whole = ours in INTEGERS
        table[theirs] = [int(x) if whole and x is not None else x for x in values]
    pl.DataFrame(table).write_csv(path)


def write_setup(
    path: str | os.PathLike,
    rig: Rig,
    *,
    rate: float = 10e3,
    force_range: float | None = None,
    force_noise: float | None = 0.5,
    position_noise: float | None = 0.3e-6,
    digits: int = 4,
) -> None:
    """A setup.toml of the rig, k, b, k_v and mu_s to so many digits; no scatter is said."""

    def rough(x):
        return repr(float(f"{x:.{digits}g}"))

    lines = ["[part]", f"mass_kg = {rig.m!r}", ""]
    lines += ["[friction]", f"mu_s = {rough(rig.mu_s)}", f"mu_k_over_mu_s = {rig.ratio!r}"]
    lines += [f"k_v_N_s_per_m = {rough(rig.k_v)}", ""]
    lines += ["[contact]", f"k_N_per_m = {rough(rig.k)}", f"b_N_s_per_m = {rough(rig.b)}", ""]
    if rig.stroke is not None and not rig.push_time:
        lines += ["[pusher]", f"stroke_mm = {in_unit(rig.stroke, 1e-3)!r}", ""]
    lines += ["[force_sensor]", "sensitivity_mV_per_N = 11.2", f"rate_Hz = {rate!r}"]
    lines += [] if force_range is None else [f"range_N = {force_range!r}"]
    lines += [] if force_noise is None else [f"noise_N = {force_noise!r}"]
    lines += ["", "[probe]", "resolution_um = 0.02"]
    if position_noise is not None:
        lines.append(f"noise_um = {in_unit(position_noise, 1e-6)!r}")
    Path(path).write_text("\n".join(lines) + "\n")


def rough_setup(
    path: str | os.PathLike,
    rig: Rig,
    rng: np.random.Generator,
    factors: Mapping[str, float] | None = None,
    **options,
) -> Rig:
    """Write a set-up of rough guesses (`rough_guess` takes the factors, `write_setup` the
    options); returns the guess."""
    guess = rough_guess(rig, rng, **(factors or {}))
    write_setup(path, guess, **options)
    return guess


def truth(rigs: Mapping[str, Rig], pushes: Sequence[Push]) -> dict:
    """What a truth.json holds: each condition's rig, each push's own mu_s, F_p and d."""

    def one(rig):
        return {
            "mass_kg": rig.m,
            "mu_s": rig.mu_s,
            "mu_s_scatter": rig.scatter,
            "mu_k_over_mu_s": rig.ratio,
            "k_v_N_s_per_m": rig.k_v,
            "k_N_per_m": rig.k,
            "b_N_s_per_m": rig.b,
        }

    def told(push):
        d = push.course.sliding_distance
        return {
            "velocity_mm_min": in_unit(push.velocity, MM_MIN),
            "condition": push.condition,
            "mu_s": in_unit(push.mu_s, 1.0, 10),
            "peak_contact_force_N": in_unit(push.peak_force, 1.0, 10),
            "sliding_distance_um": None if d is None else in_unit(d, 1e-6, 10),
            "regime": push.course.regime,
            "contacts": push.course.contacts,
            "rests_in_contact": d is None,
        }

    return {
        "rigs": {condition: one(rig) for condition, rig in rigs.items()},
        "pushes": [told(push) for push in pushes],
    }


def write_json(path: str | os.PathLike, what) -> None:
    Path(path).write_text(json.dumps(what, indent=1, allow_nan=False) + "\n")
