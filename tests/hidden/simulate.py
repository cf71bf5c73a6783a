"""A case's pushes as the sensors read them, and the files that a user would have of them.

case = random_case(7, "stribeck", strength=10)
write(case, folder)                      # pushes.tdms or pushes.csv, setup.toml, truth.json
write(heldout(case, 6), other_folder)    # further pushes of the same rig
"""

from __future__ import annotations

import csv
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

from tests.hidden import forms, outsiders, stepper
from tests.hidden.case import MM_MIN, TABLE, Case, Push, draw_pushes
from tests.hidden.noise import coloured
from tests.hidden.tip import follow_tip
from tests.reference.effect_parameters import NAMES, vector

LONGEST = 0.8
"""[s]: no push is recorded for longer"""
FINE = 16
"""steps in a sample's interval where a resonance is followed"""
ZERO = 0.5e-3
"""[m]: the position's zero lies within +- this"""
LEAST_D = 5.0
"""standard errors: below, nobody would note d down"""
OFFSET = NAMES.index("force_offset.offset_N")


def numbers(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Each push's vector for the stepper, a row a push, and the numbers of `forms`."""
    orders = [push.order for push in case.pushes]
    first, span = min(orders), max(max(orders) - min(orders), 1)
    rig: dict[str, float | None] = dict(case.rig)
    for effect, values in case.present.items():
        if effect == "friction_ratio":
            rig["mu_k_over_mu_s"] = values["ratio"]
        else:
            rig |= {f"{effect}.{key}": value for key, value in values.items()}
    rows = [
        vector(
            {
                **rig,
                "mass_kg": case.mass_of(push),
                "stroke_m": case.stroke,
                "mu_s": push.mu_s,
                "velocity_m_per_s": push.velocity,
                "friction_drift.place": (push.order - first) / span,
                "static_dwell.rest_s": push.rest_before,
            }
        )
        for push in case.pushes
    ]
    others = np.zeros(len(forms.NAMES))
    for name, values in case.outsider.items():
        for key, value in values.items():
            if f"{name}.{key}" in forms.NAMES:
                others[forms.NAMES.index(f"{name}.{key}")] = value
    others[forms.NAMES.index("s_curve")] = float(case.s_curve)
    return np.array(rows), others


def friction_of(case: Case) -> np.ndarray:
    """The static friction that each push had: drift and rest before it included."""
    orders = np.array([push.order for push in case.pushes], float)
    place = (orders - orders.min()) / max(np.ptp(orders), 1.0)
    drift = case.present.get("friction_drift", {}).get("drift", 0.0)
    dwell = case.present.get("static_dwell", {})
    rest = np.array([push.rest_before for push in case.pushes], float) / dwell.get("tau_s", 1.0)
    grown = 1 + dwell.get("amplitude", 0.0) * np.log1p(np.maximum(rest, 0.0))
    return np.array([push.mu_s for push in case.pushes]) * (1 + drift * place) * grown


def sensed(case: Case, row: np.ndarray, others: np.ndarray, times: np.ndarray) -> stepper.Run:
    """One push with what outsiders make of its readings; the times [s] are evenly spaced."""
    run = stepper.follow(row, others, times)
    if not case.outsider:
        return run
    force, peak = run.force, run.peak_force
    if values := case.outsider.get("force_resonance"):
        force, peak = _resonant(case, row, others, times, run, values)
    left, rests = outsiders.position_read(case.outsider, np.array([run.left_at, run.rests_at]))
    return replace(
        run,
        peak_force=float(outsiders.force_read(case.outsider, np.array(peak))),
        force=outsiders.force_read(case.outsider, force),
        position=outsiders.position_read(case.outsider, run.position),
        left_at=float(left),
        rests_at=float(rests),
    )


def _resonant(case, row, others, times, run, values):
    """Force at the times and its peak, from finer samples from the start of the push."""
    step = 1 / case.rate / FINE
    after = times[times >= 0]
    first = after[0] % step if len(after) else 0.0
    end = after[-1] if len(after) else run.end
    grid = first + step * np.arange(round((end - first) / step) + 1)
    idle = row[OFFSET]  # what the sensor has shown for long
    fine = idle + outsiders.resonant(values, stepper.follow(row, others, grid).force - idle, step)
    force = run.force.copy()
    force[times >= 0] = fine[np.round((after - first) / step).astype(int)]
    return force, fine[grid <= run.end].max()


def answers(case: Case) -> list[stepper.Run]:
    """Each push's F_p, d, regime, without samples."""
    rows, others = numbers(case)
    return [sensed(case, row, others, np.zeros(0)) for row in rows]


def readings(case: Case) -> np.ndarray:
    """F_p [N] and d [m] of each push, noise apart; NaN where there is no answer or no d."""
    found = [(run.peak_force, run.sliding_distance, run.reason) for run in answers(case)]
    return np.array([(F, d) if not reason else (math.nan,) * 2 for F, d, reason in found])


def sample_times(case: Case, end: float) -> np.ndarray:
    """When a push that ends at `end` is sampled [s]: some time before it begins and after."""
    before = round(case.before * case.rate)
    start = (case.phase - before) / case.rate
    last = min(end if math.isfinite(end) else LONGEST, LONGEST) + case.after
    return start + np.arange(math.floor((last - start) * case.rate) + 1) / case.rate


@dataclass(frozen=True)
class Recording:
    """One push as recorded; position from an arbitrary zero."""

    push: Push
    times: np.ndarray
    """[s], on the recorder's clock"""
    force: np.ndarray
    position: np.ndarray
    run: stepper.Run
    """without noise and zero"""


def draw_lateness(case: Case, rng: np.random.Generator) -> float:
    """How much later than the recorder's t = 0 a push begins [s], by its own generator."""
    return case.jitter * rng.standard_normal()


def lateness(case: Case) -> np.ndarray:
    """The same of all pushes (n,)."""
    seeds = ([case.seed, 1, i, 0] for i in range(len(case.pushes)))
    return np.array([draw_lateness(case, np.random.default_rng(seed)) for seed in seeds])


def record(case: Case, noisy: bool = True) -> list[Recording]:
    """All pushes; without noise the position's zero is where the push starts."""
    rows, others = numbers(case)
    found = []
    for i, (push, row) in enumerate(zip(case.pushes, rows, strict=True)):
        # A generator for each channel: a recording that ends earlier has the same noise till then.
        rng, of_force, of_position = (np.random.default_rng([case.seed, 1, i, j]) for j in range(3))
        late = draw_lateness(case, rng)
        origin = rng.uniform(-ZERO, ZERO)
        times = sample_times(case, stepper.follow(row, others, np.zeros(0)).end)
        run = sensed(case, row, others, times - late)
        force, position, noise = run.force, run.position, case.noise
        if noisy:
            n = len(times)
            force = force + coloured(n, noise.force, noise.force_phi, of_force)
            position = (
                origin + position + coloured(n, noise.position, noise.position_phi, of_position)
            )
            if case.resolution:
                position = case.resolution * np.round(position / case.resolution)
        found.append(Recording(push, times, force, position, run))
    return found


def table(case: Case) -> list[dict]:
    """A row a push, as in the .csv; None where nothing was noted down."""
    rng = np.random.default_rng([case.seed, 2])
    rows = []
    for push, (F_p, d) in zip(case.pushes, readings(case), strict=True):
        F_read = F_p + case.noise.force * rng.standard_normal()
        d_read = d + case.noise.position * rng.standard_normal()
        seen = d >= LEAST_D * case.noise.position  # by the truth: no bias by what is read
        rows.append(
            {
                "velocity_mm_min": round(push.velocity / MM_MIN, 9),
                "peak_force_N": round(F_read, 6),
                "sliding_distance_um": round(d_read * 1e6, 6) if seen else None,
                "mass_kg": case.mass_of(push),
                "stroke_mm": None if case.stroke is None else round(case.stroke * 1e3, 9),
                "condition": push.condition,
                "order": push.order,
                "rest_before_s": push.rest_before,
                "peak_force_se_N": case.noise.force,
                "sliding_distance_se_um": round(case.noise.position * 1e6, 9),
            }
        )
    return rows


def write(case: Case, folder: Path, tip_noise: float | None = None) -> Path:
    """Writes the data, a rough set-up and the truth; returns the data's path.

    With `tip_noise` [m] recordings have a channel of the tip, with so much noise a sample.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "setup.toml").write_text(rough_setup(case), encoding="utf-8")
    (folder / "truth.json").write_text(json.dumps(case.truth(), indent=1) + "\n", encoding="utf-8")
    if case.kind == TABLE:
        path, rows = folder / "pushes.csv", table(case)
        columns = [key for key in rows[0] if any(row[key] is not None for row in rows)]
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        return path
    path = folder / "pushes.tdms"
    with TdmsWriter(path) as file:
        file.write_segment([RootObject({"description": "push recordings"})])
        for i, one in enumerate(record(case)):
            tip = None
            if tip_noise is not None:
                rng = np.random.default_rng([case.seed, 1, i, 3])
                tip = follow_tip(case, one.push, one.times)
                tip = tip + tip_noise * rng.standard_normal(len(tip))
            file.write_segment(_group(case, f"push {i + 1:04d}", one, tip))
    return path


def _group(case: Case, name: str, one: Recording, tip: np.ndarray | None = None) -> list:
    said = {
        "velocity_mm_min": round(one.push.velocity / MM_MIN, 9),
        "mass_kg": case.mass_of(one.push),
        "condition": one.push.condition,
        "order": one.push.order,
        "rest_before_s": one.push.rest_before,
    }
    if case.stroke is not None:
        said["stroke_mm"] = round(case.stroke * 1e3, 9)

    def channel(which, unit, samples):
        waveform = {
            "unit_string": unit,
            "wf_increment": 1 / case.rate,
            "wf_start_offset": float(f"{one.times[0]:.12g}"),
            "wf_samples": len(samples),
        }
        return ChannelObject(name, which, samples, waveform)

    position = np.round(one.position * 1e6, 6)
    tips = [] if tip is None else [channel("pusher", "um", np.round(tip * 1e6, 6))]
    return [
        GroupObject(name, said),
        channel("force", "N", one.force),
        channel("position", "um", position),
        *tips,
    ]


def rough_setup(case: Case) -> str:
    """A setup.toml of the plain rig: k and b off by up to 30 %, k_v by 50 %, mu_s by 10 %."""
    rng = np.random.default_rng([case.seed, 3])

    def off(value, most):
        return float(f"{value * (1 + rng.uniform(-most, most)):.4g}")

    mu_s = float(np.mean(list(case.mu_s.values())))
    lines = [
        "[part]",
        f"mass_kg = {case.rig['mass_kg']!r}",
        "\n[friction]",
        f"mu_s = {off(mu_s, 0.1)!r}",
        "mu_k_over_mu_s = 0.75",
        f"k_v_N_s_per_m = {off(case.rig['k_v_N_s_per_m'], 0.5)!r}",
        "\n[contact]",
        f"k_N_per_m = {off(case.rig['k_N_per_m'], 0.3)!r}",
        f"b_N_s_per_m = {off(case.rig['b_N_s_per_m'], 0.3)!r}",
    ]
    if case.stroke is not None:
        lines += ["\n[pusher]", f"stroke_mm = {round(case.stroke * 1e3, 9)!r}"]
    lines += ["\n[force_sensor]", "range_N = 5000.0", f"rate_Hz = {case.rate!r}"]
    lines += [f"noise_N = {case.noise.force!r}", "\n[probe]"]
    lines += [f"resolution_um = {round(case.resolution * 1e6, 9)!r}"] if case.resolution else []
    lines += [f"noise_um = {round(case.noise.position * 1e6, 9)!r}"]
    return "\n".join(lines) + "\n"


def heldout(case: Case, n: int = 6, seed: int = 1) -> Case:
    """Further pushes of the same rig: other speeds, each with its own mu_s and noise.

    Their order begins anew, so that a drift runs over them as it did over the first ones.
    """
    own = int(np.random.SeedSequence([case.seed, 4, seed]).generate_state(1)[0])
    rng = np.random.default_rng([own, 0])
    for _ in range(100):
        speeds = list(MM_MIN * np.round(rng.uniform(500, 5000, n)))
        pushes = draw_pushes(rng, case.mu_s, case.scatter, speeds, case.masses)
        further = replace(case, seed=own, pushes=pushes)
        if not any(run.reason for run in answers(further)):
            return further
    raise ValueError("no further pushes have an answer")
