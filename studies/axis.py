"""How often a fit and a diagnosis of an axis are right, on made axes with known truth.

    REFERENCE_JIT=1 python -m studies.axis [--cases 100] [--only fit|clean|hidden]

Random axes of some twenty seconds at 1 kHz, to and fro at eight speeds, 1 µm of white or coloured
encoder noise, 2 % scatter of the friction from stretch to stretch; set-ups off by a factor of
three.
"""

from __future__ import annotations

import argparse
from collections import Counter
from time import perf_counter

import numpy as np

from difffric.axis import AxisRecordings, AxisSetup, AxisStretch, diagnose_axis, fit_axis
from tests.reference import axis as reference

NAMES = ("mass_kg", "coulomb_N", "k_v_N_s_per_m", "offset_N", "breakaway_N")


def draw_axis(generator: np.random.Generator, effects: dict | None = None, delay: float = 0.0):
    """A random axis."""
    coulomb = generator.uniform(3, 30)
    return reference.Axis(
        mass=float(np.exp(generator.uniform(np.log(2), np.log(100)))),
        coulomb=coulomb,
        breakaway=coulomb * generator.uniform(1.05, 1.4),
        k_v=generator.uniform(5, 300),
        offset=generator.uniform(-3, 3),
        delay=delay,
        effects=effects or {},
    )


def record_axis(axis: reference.Axis, seed: int, **options):
    """A recording of it as the library takes it, and a set-up that is far off."""
    generator = np.random.default_rng([seed, 7])
    speeds = np.exp(generator.uniform(np.log(0.02), np.log(0.3), 8))
    made = reference.record(axis, seed=seed, speeds=speeds, travel=0.08, **options)
    groups = [made.stretch == k for k in np.unique(made.stretch)]
    stretches = [
        AxisStretch(str(k), made.t[g], made.force[g], made.measured[g])
        for k, g in enumerate(groups)
    ]
    off = 3.0 ** generator.choice([-1, 1], 3)
    setup = AxisSetup(axis.mass * off[0], axis.coulomb * off[1], k_v=axis.k_v * off[2])
    return AxisRecordings(stretches), setup


def draw_effect(kind: str, generator: np.random.Generator) -> tuple[dict, float]:
    """An effect of a size that moves the axis by some ten times the noise, and a delay [s]."""
    length = generator.uniform(0.005, 0.04)
    phase = generator.uniform(-3, 3)
    effects = {
        "friction_direction": {"viscous_share": generator.uniform(0.03, 0.2)},
        "cogging": {
            "amplitude": generator.uniform(0.1, 1.0), "period": length, "phase": phase,
        },
        "friction_waviness": {
            "waviness": generator.uniform(0.02, 0.1), "wavelength": length, "wave_phase": phase,
        },
        "stribeck": {"v_s": generator.uniform(0.01, 0.04)},
        "friction_strengthening": {
            "strength": generator.uniform(0.04, 0.15),
            "strength_speed": generator.uniform(0.001, 0.005),
        },
        "quadratic_drag": {"drag": generator.uniform(30, 150)},
        "drive_delay": {},
    }  # fmt: skip
    return effects[kind], float(generator.integers(1, 4)) * 1e-3 if kind == "drive_delay" else 0.0


def study_fits(cases: int) -> None:
    """Print how far parameters lie from the truth in units of their errors."""
    rows, times = [], []
    for seed in range(cases):
        generator = np.random.default_rng([seed, 1])
        axis = draw_axis(generator)
        data, setup = record_axis(axis, seed, colour=(0.0, 0.9)[seed % 2])
        begin = perf_counter()
        fit = fit_axis(setup, data)
        times.append(perf_counter() - begin)
        truth = (axis.mass, axis.coulomb, axis.k_v, axis.offset, axis.breakaway)
        rows.append([
            (fit.value(name) - x) / error if (error := fit.standard_error(name)) else np.nan
            for name, x in zip(NAMES, truth, strict=True)
        ])  # fmt: skip
    z = np.array(rows)
    print(f"{cases} fits, {np.median(times):.2f} s each (median)")
    for name, own in zip(NAMES, z.T, strict=True):
        own = own[np.isfinite(own)]
        print(
            f"  {name:<14} n {len(own):4d}  in 95 %: {np.mean(np.abs(own) < 1.96):.3f}  "
            f"in 3 s.e.: {np.mean(np.abs(own) < 3):.3f}  rms {np.sqrt(np.mean(own**2)):.2f}"
        )


def study_clean(cases: int) -> None:
    """Print the verdicts on axes that hide nothing."""
    verdicts: Counter[str] = Counter()
    for seed in range(cases):
        axis = draw_axis(np.random.default_rng([seed, 2]))
        data, setup = record_axis(axis, seed + 10_000, colour=(0.0, 0.9)[seed % 2])
        found = diagnose_axis(setup, data)
        verdicts[found.verdict + "".join(f" {x.id}" for x in found.causes)] += 1
    print(f"clean, {cases}:", dict(verdicts))


def study_hidden(cases: int) -> None:
    """Print how often the effect that is hidden is the first that is named."""
    kinds = ("friction_direction", "cogging", "friction_waviness", "stribeck",
             "friction_strengthening", "quadratic_drag", "drive_delay")  # fmt: skip
    for kind in kinds:
        said: Counter[str] = Counter()
        for seed in range(cases):
            generator = np.random.default_rng([seed, 3, kinds.index(kind)])
            effects, delay = draw_effect(kind, generator)
            axis = draw_axis(generator, effects, delay)
            data, setup = record_axis(axis, seed + 20_000, colour=(0.0, 0.9)[seed % 2])
            found = diagnose_axis(setup, data)
            first = found.causes[0].id if found.causes else "none"
            said["right" if first == kind else f"{first} ({found.verdict})"] += 1
        print(f"{kind}, {cases}:", dict(said), flush=True)


def main() -> None:
    """Print all parts, or one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--only", choices=("fit", "clean", "hidden"))
    asked = parser.parse_args()
    parts = {"fit": study_fits, "clean": study_clean, "hidden": study_hidden}
    for name, part in parts.items():
        if asked.only in (None, name):
            part(asked.cases)


if __name__ == "__main__":
    main()
