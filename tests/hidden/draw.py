"""Random cases. All that is drawn follows from the seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tests.hidden import scaling, simulate, sizes
from tests.hidden.case import (
    RECORDINGS,
    TABLE,
    TABLE_ONLY,
    Case,
    Noise,
    draw_pushes,
    practice_speeds,
)
from tests.hidden.outsiders import TABLE as OUTSIDERS
from tests.hidden.outsiders import Scene
from tests.hidden.signal import Invisible
from tests.reference.effect_parameters import EFFECTS

TRIES = 30
LEAST_WITH_D = 0.7
"""share of the pushes that leave the pusher and slide"""
OILY = 0.75
"""mu_s of each further condition, relative to the one before"""
TINY = 0.002
"""the largest relative change of F_p and d by a nuisance"""
NO_NUISANCE = ("presliding",)
"""bristles have no small size: they replace the stuck mode"""
ONE_OF = ("release_threshold", "release_latch")
"""never at once: a latch leaves nothing for the threshold to say"""


def random_rig(rng: np.random.Generator) -> tuple[dict[str, float], float, float]:
    """(rig, mu_s, scatter), over the ranges of the reference's rigs for studies."""
    m, k = rng.uniform(5, 30), sizes.log_uniform(rng, 2e5, 3e6)
    kind = rng.random()
    low, high = (2, 15) if kind < 0.85 else (0, 2) if kind < 0.9 else (15, 30)
    rig = {
        "mass_kg": m,
        "mu_k_over_mu_s": 0.75,
        "k_v_N_s_per_m": rng.uniform(low, high),
        "k_N_per_m": k,
        "b_N_s_per_m": 2 * rng.uniform(0.1, 0.5) * math.sqrt(k * m),
    }
    rig = {key: float(f"{value:.4g}") for key, value in rig.items()}
    scatter = 0.0 if rng.random() < 0.1 else float(rng.uniform(0, 0.05))
    return rig, float(rng.uniform(0.08, 0.25)), scatter


def random_noise(rng: np.random.Generator, phi: float | None) -> Noise:
    """0.2-1 N and 0.1-0.6 um; white in half the cases, else phi over 0-0.9 in each channel."""
    white = rng.random() < 0.5
    drawn = [0.0, 0.0] if white else rng.uniform(0, 0.9, 2)
    phis = drawn if phi is None else [phi, phi]
    return Noise(
        force=float(f"{sizes.log_uniform(rng, 0.2, 1.0):.3g}"),
        position=float(f"{sizes.log_uniform(rng, 0.1e-6, 0.6e-6):.3g}"),
        force_phi=float(phis[0]),
        position_phi=float(phis[1]),
    )


def sound(case: Case) -> bool:
    """Every push has an answer, and most leave the pusher."""
    runs = simulate.answers(case)
    slides = [math.isfinite(run.sliding_distance) for run in runs if not run.reason]
    return len(slides) == len(runs) and float(np.mean(slides)) >= LEAST_WITH_D


def scene(case: Case) -> Scene:
    """What sizes are drawn by, of the plain pushes."""
    runs = simulate.answers(case.plain())
    peak = float(np.median([run.peak_force for run in runs]))
    contact = [run.left_at for run in runs if math.isfinite(run.left_at)]
    return Scene(
        peak=max(run.peak_force for run in runs),
        compression=peak / case.rig["k_N_per_m"],
        travel=float(np.median([run.rests_at for run in runs])),
        contact_travel=float(np.median(contact)),
    )


def values(case: Case, name: str, rng: np.random.Generator) -> dict[str, float]:
    """A random size around the typical one."""
    at = scene(case)
    if name in OUTSIDERS:
        return {key: float(f"{x:.6g}") for key, x in OUTSIDERS[name].draw(rng, at).items()}
    mu_s = min(case.mu_s.values())
    return sizes.draw(name, rng, case.rig, mu_s, at.travel, at.peak)


def random_case(
    seed: int,
    effect: str | Sequence[str] | None = None,
    strength: float | None = None,
    *,
    change: float | None = None,
    kind: str = RECORDINGS,
    nuisances: bool = False,
    n: int = 14,
    conditions: Sequence[str] = ("A",),
    masses: Sequence[float] = (1.0,),
    scatter: float | None = None,
    phi: float | None = None,
    delta: float = 2.0,
    **more,
) -> Case:
    """A case with nothing, one effect or outsider, or several hidden in it.

    Each is of a random size, or of the strength s, or changes F_p or d by the share `change`. With
    `nuisances` every other effect that the data can show is there too, too small to matter. `phi`
    is the noise's colour, `delta` the exponent of stribeck, `masses` are relative to the rig's;
    `more` are fields of `Case`, such as stroke, rate, s_curve, jitter. Raises ValueError where
    TRIES rigs lead nowhere.
    """
    names = [effect] if isinstance(effect, str) else list(effect or ())
    unknown = [name for name in names if name not in EFFECTS and name not in OUTSIDERS]
    if unknown:
        raise KeyError(f"neither effect nor outsider: {unknown}")
    for attempt in range(TRIES):
        rng = np.random.default_rng([seed, 0, attempt])
        rig, mu_s, drawn = random_rig(rng)
        own = {condition: mu_s * OILY**i for i, condition in enumerate(conditions)}
        spread = drawn if scatter is None else scatter
        kg = [float(f"{rig['mass_kg'] * factor:.6g}") for factor in masses]
        pushes = draw_pushes(rng, own, spread, list(practice_speeds(n)), kg)
        case = Case(seed, kind, rig, own, spread, pushes, noise=random_noise(rng, phi))
        case = replace(case, **more)
        if strength is not None and not all(scaling.visible(case, name) for name in names):
            raise ValueError(f"such data do not show {names}")
        if not sound(case):
            continue
        for name in names:
            case = case.with_effect(name, values(case, name, rng))
        if "stribeck" in case.effects and delta != 2.0:
            case = case.with_effect("stribeck", {**case.effects["stribeck"], "delta": delta})
        try:
            if strength is not None:
                case = scaling.with_strength(case, strength)
            if change is not None:
                for name in names:
                    case = scaling.with_change(case, name, change)
        except Invisible:
            continue
        if not sound(case):
            continue
        if nuisances:
            case = with_nuisances(case, rng)
            if not sound(case):
                continue
        return case
    raise ValueError(f"seed {seed}: no rig shows {names} as asked in {TRIES} tries")


def with_nuisances(case: Case, rng: np.random.Generator, share: float = TINY) -> Case:
    """With every other effect, each so small that alone it changes no push's F_p or d by more.

    One that changes neither at any size, as a delay that is hardly seen, is as large as drawn.
    """
    plain, found = case.plain(), {}
    taken = ONE_OF if set(ONE_OF) & set(case.effects) else (ONE_OF[case.seed % 2],)
    for name in EFFECTS:
        of_tables = name in TABLE_ONLY and case.kind != TABLE
        if name in case.effects or name in (*NO_NUISANCE, *taken) or of_tables:
            continue
        one = plain.with_effect(name, values(case, name, rng))
        if scaling.largest_change(one) > share:
            try:
                one = scaling.with_change(one, name, share, scaling.largest_change)
            except Invisible:  # a push on an edge: no size is small enough
                continue
        found[name] = one.effects[name]
    return replace(case, nuisances=found)
