"""Writes cases.json: random pushes with exact answers and derivatives.

    python -m tests.reference.make_cases

`cases` are pushes with F_p, d, their first derivatives and, for some, the second ones in mu_s.
Those tagged near_edge lie within a relative 1e-3 of mu_s of a change of regime, stuck_first or
contacts; at all others, no answer has a kink within a relative 1e-3 of any parameter.
`too_many_contacts` are pushes whose only answer is that error.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from pathlib import Path

import numpy as np

from . import exact, ode

SEED = 20240613
DRAWS = 100_000
PER_CLASS = 6
NEAR_EDGE = 36
PER_EDGE = 4
TOO_MANY = 6
SECOND = 24
MAX_SEGMENTS = 250
CLEARANCES = (1e-3, 3e-4, 1e-4, 1e-5)
NAMES = {  # argument of push -> key in the file
    "m": "mass_kg",
    "mu_s": "mu_s",
    "ratio": "mu_k_over_mu_s",
    "k_v": "k_v_N_s_per_m",
    "k": "k_N_per_m",
    "b": "b_N_s_per_m",
    "v": "velocity_m_per_s",
    "stroke": "stroke_m",
}


def _log_uniform(rng, lo, hi):
    return float(np.exp(rng.uniform(np.log(lo), np.log(hi))))


def _rounded(x):
    return float(f"{x:.6g}")


def _chopped(x):
    """The nearest float, and zero where nothing but the rounding of 60 digits is left."""
    return float(x) if abs(x) > 1e-30 else 0.0


def draw(rng) -> dict:
    """A random rig and push; damping may be none, exactly critical or more."""
    m, k = _log_uniform(rng, 0.5, 50), _log_uniform(rng, 1e4, 1e7)
    kinds = [0.0, rng.uniform(0, 0.1), rng.uniform(0, 1), rng.uniform(1, 1.5)]
    zeta = rng.choice(kinds, p=[0.1, 0.3, 0.35, 0.25])
    k_v = rng.choice([0.0, 1e-9, _log_uniform(rng, 0.1, 200)], p=[0.15, 0.08, 0.77])
    special = rng.random()
    if special < 0.05:  # overdamped rebound
        m, k, k_v = rng.uniform(0.5, 0.8), rng.uniform(1e4, 1.2e4), rng.uniform(140, 200)
    m, k, k_v = _rounded(m), _rounded(k), _rounded(k_v)
    b = _rounded(2 * zeta * np.sqrt(k * m))
    if special > 0.9:  # exactly critical, in the contact or on the rebound
        root_m, root_k = int(rng.integers(6, 56)) / 8, int(rng.integers(100, 3000))
        m, k = root_m**2, float(root_k**2)
        k_v = int(rng.integers(0, min(800, 8 * root_m * root_k))) / 4  # so that b > 0
        b = 2 * root_m * root_k - k_v
        if special > 0.98:
            m, k, k_v = 0.5625, float(int(rng.integers(100, 130)) ** 2), 0.0
            k_v = 1.5 * k**0.5
            b = _rounded(zeta * k_v)
    v = _log_uniform(rng, 1e-3, 0.1)
    stroke = None
    if rng.random() < 0.6:
        periods = v * 2 * np.pi * np.sqrt(m / k) * _log_uniform(rng, 0.1, 20)
        stroke = rng.choice([_log_uniform(rng, 5e-5, 1e-2), np.clip(periods, 5e-5, 1e-2)])
    return {
        "m": m,
        "mu_s": _rounded(_log_uniform(rng, 0.03, 0.5)),
        "ratio": _rounded(rng.choice([1.0, rng.uniform(0.4, 1)], p=[0.05, 0.95])),
        "k_v": k_v,
        "k": k,
        "b": b,
        "v": _rounded(v),
        "stroke": None if stroke is None else _rounded(stroke),
    }


def quick(rig: dict) -> exact.Result | None:
    """The push in floats; None where it is too long or degenerate."""
    try:
        return exact.push(**rig, arithmetic=exact.FLOAT, max_segments=MAX_SEGMENTS)
    except ArithmeticError:
        return None


def damping(c, k, m) -> str:
    excess = c * c - 4 * k * m
    return "under" if excess < 0 else "over" if excess > 0 else "critical"


def class_of(rig: dict, answer: exact.Result) -> tuple:
    """What the cases are balanced over."""
    return (
        answer.regime,
        answer.stuck_first,
        min(answer.contacts, 9),
        damping(rig["b"] + rig["k_v"], rig["k"], rig["m"]),
        damping(rig["k_v"], rig["k"], rig["m"]),
        rig["stroke"] is None,
    )


def is_clear(rig: dict, answer: exact.Result) -> bool:
    """No kink within a relative 1e-3 of any parameter, as far as a few probes tell."""
    for argument in exact.PARAMETERS.values():
        for clearance in CLEARANCES:
            for side in (-1, 1):
                other = quick({**rig, argument: rig[argument] * (1 + side * clearance)})
                if other is None or other.signature != answer.signature:
                    return False
    return exact.nearest_change(rig, "signature", start=1e-5, stop=1.1e-3) is None


def record(rig: dict, near_edge: bool) -> dict | None:
    """The case in the file's words; None where it is degenerate to rounding."""
    margin = exact.margin(rig, start=1e-7 if near_edge else 1e-3)
    if near_edge and not 1e-6 <= margin <= 1e-3:
        return None
    try:
        answer = exact.push(**rig)
        slopes = exact.derivatives(rig)
    except ArithmeticError:
        return None
    if answer.signature != quick(rig).signature:
        return None
    d = answer.sliding_distance
    return {
        **{name: rig[argument] for argument, name in NAMES.items()},
        "F_p_N": float(answer.peak_force),
        "d_m": None if d is None else float(d),
        "regime": answer.regime,
        "stuck_first": answer.stuck_first,
        "contacts": answer.contacts,
        "segments": len(answer.segments),
        "peak_at": answer.segments[answer.peak_segment].peak_at,
        "margin": None if margin is None else _rounded(margin),
        "derivatives": {
            observable: values and {name: _chopped(x) for name, x in values.items()}
            for observable, values in slopes.items()
        },
        **({"near_edge": True} if near_edge else {}),
    }


def add_second_derivatives(case: dict, rig: dict) -> None:
    curves = exact.second_derivatives(rig)
    case["d2_dmu_s2"] = {name: None if x is None else _chopped(x) for name, x in curves.items()}


def regular_cases(rng):
    """Rigs and records, at most PER_CLASS of a class; and rigs with too many contacts."""
    counts, rigs, cases, too_many = Counter(), [], [], []
    for _ in range(DRAWS):
        rig = draw(rng)
        answer = quick(rig)
        if answer is None:
            continue
        if answer.too_many_contacts:
            if len(too_many) < TOO_MANY and exact.push(**rig).too_many_contacts:
                too_many.append(rig)
            continue
        label = class_of(rig, answer)
        if counts[label] >= PER_CLASS or not is_clear(rig, answer):
            continue
        case = record(rig, near_edge=False)
        if case is not None:
            counts[label] += 1
            rigs.append(rig)
            cases.append(case)
    return counts, rigs, cases, too_many


def edge_cases(rng, rigs):
    """Rigs moved along mu_s to a random small distance from their nearest edge."""
    counts, moved, cases = Counter(), [], []
    for i in rng.permutation(len(rigs)):
        if len(cases) >= NEAR_EDGE:
            break
        rig = rigs[i]
        edge = exact.nearest_change(rig, "outcome", start=1e-3)
        if edge is None or (rig["k_v"] == 0 and rig["b"] == 0):
            continue
        distance = rng.choice([-1, 1]) * _log_uniform(rng, 2e-6, 9e-4)
        near = {**rig, "mu_s": float(rig["mu_s"] * (1 + edge) * (1 + distance))}
        far = {**rig, "mu_s": near["mu_s"] * (1 - 2 * distance)}
        answers = quick(near), quick(far)
        if None in answers or answers[0].too_many_contacts:
            continue
        label = tuple((a.regime, a.stuck_first) for a in answers)
        case = record(near, near_edge=True) if counts[label] < PER_EDGE else None
        if case is not None:
            counts[label] += 1
            moved.append(near)
            cases.append(case)
    return counts, moved, cases


def compare_with_ode(rigs, cases) -> str:
    """Largest relative deviations of `ode` over the given cases."""
    worst_force = worst_distance = 0.0
    for rig, case in zip(rigs, cases, strict=True):
        answer = ode.push(**rig)
        same = (answer.regime, answer.stuck_first, answer.contacts) == (
            case["regime"],
            case["stuck_first"],
            case["contacts"],
        )
        if not same:
            raise AssertionError(f"the two simulators disagree: {rig}, {answer}, {case}")
        worst_force = max(worst_force, abs(answer.peak_force / case["F_p_N"] - 1))
        if case["d_m"] is not None:
            deviation = abs(answer.sliding_distance / case["d_m"] - 1)
            worst_distance = max(worst_distance, deviation)
    return f"F_p {worst_force:.1e}, d {worst_distance:.1e} over {len(rigs)} pushes"


def main() -> None:
    began = time.perf_counter()
    rng = np.random.default_rng(SEED)
    counts, rigs, cases, too_many = regular_cases(rng)
    smooth = [i for i, case in enumerate(cases) if case["d_m"] is not None]
    for i in rng.choice(smooth, SECOND, replace=False):
        add_second_derivatives(cases[i], rigs[i])
    edges, edge_rigs, near_edge = edge_cases(rng, rigs)
    errors = [{name: rig[a] for a, name in NAMES.items()} for rig in too_many]

    lines = [json.dumps(case, separators=(",", ":")) for case in cases + near_edge]
    more = [json.dumps(rig, separators=(",", ":")) for rig in errors]
    text = '{"cases":[\n' + ",\n".join(lines) + '\n],"too_many_contacts":[\n'
    path = Path(__file__).with_name("cases.json")
    path.write_text(text + ",\n".join(more) + "\n]}\n", encoding="utf-8")

    for label, number in sorted(counts.items(), key=str):
        print(number, *label)
    for label, number in sorted(edges.items(), key=str):
        print("near edge:", number, *label)
    print(len(cases), "cases,", len(near_edge), "near an edge,", len(errors), "errors;", end=" ")
    print(f"{path.stat().st_size} bytes, {time.perf_counter() - began:.0f} s")
    print("exact against ode:", compare_with_ode(rigs[::3], cases[::3]))
    print("near an edge:", compare_with_ode(edge_rigs, near_edge))


if __name__ == "__main__":
    main()
