"""How often simulations, fits and diagnoses of an axis are right, on made axes of known truth.

    REFERENCE_JIT=1 python -m studies.axis [--only motion] [--cases 100] [--block 0] [--page PAGE]

Random axes of some twenty seconds at 1 kHz, to and fro at eight speeds, 1 µm of white or coloured
encoder noise, 2 % scatter of the friction from stretch to stretch; set-ups off by a factor of
three. What is hidden moves the axis by ten times the encoder's noise, beside what the plain
parameters could take over. `--block` draws other axes: what was mended after one block is counted
on the next. What is there already is not done again; the figures are printed, and set between two
marks of the page.
"""

from __future__ import annotations

import argparse
import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from studies import runs

PAGE = runs.ROOT / "docs" / "axis.md"
NOISE = 1e-6
"""[m] of one sample of the encoder."""
MOVES = 10.0
"""Times the noise by which what is hidden moves the axis."""
MATTERS = 0.02
"""Share of Coulomb friction that a hidden force has at least: less is negligible by its size."""
PARAMETERS = {
    "mass_kg": "mass", "coulomb_N": "coulomb", "k_v_N_s_per_m": "k_v", "offset_N": "offset",
    "breakaway_N": "breakaway",
}  # fmt: skip
SIZES = {
    "friction_direction": "viscous_share", "cogging": "amplitude", "friction_waviness": "waviness",
    "friction_strengthening": "strength", "quadratic_drag": "drag", "stribeck": None,
    "drive_delay": None,
}  # fmt: skip
"""What is hidden, and the number that is drawn by how far it moves the axis."""
PAIRS = list(combinations(SIZES, 2))
CASES = {"motion": 200, "fit": 300, "clean": 200, "hidden": 140, "pairs": 105}


def draw_axis(generator: np.random.Generator):
    """A random axis."""
    from tests.reference import axis as reference

    coulomb = generator.uniform(3, 30)
    return reference.Axis(
        mass=float(np.exp(generator.uniform(np.log(2), np.log(100)))),
        coulomb=coulomb,
        breakaway=coulomb * generator.uniform(1.05, 1.4),
        k_v=generator.uniform(5, 300),
        offset=generator.uniform(-3, 3),
    )


def draw_speeds(generator: np.random.Generator) -> NDArray:
    """The speeds of eight rounds [m/s]."""
    return np.exp(generator.uniform(np.log(0.02), np.log(0.3), 8))


def record_axis(axis, speeds: NDArray, generator: np.random.Generator, colour: float):
    """A recording of it as the library takes it, and a set-up that is far off."""
    from difffric.axis import AxisRecordings, AxisSetup, AxisStretch
    from tests.reference import axis as reference

    made = reference.record(
        axis, seed=int(generator.integers(2**31)), speeds=speeds, travel=0.08, noise=NOISE,
        colour=colour,
    )  # fmt: skip
    groups = [made.stretch == k for k in np.unique(made.stretch)]
    stretches = [
        AxisStretch(str(k), made.t[g], made.force[g], made.measured[g])
        for k, g in enumerate(groups)
    ]
    off = 3.0 ** generator.choice([-1, 1], 3)
    setup = AxisSetup(axis.mass * off[0], axis.coulomb * off[1], k_v=axis.k_v * off[2])
    return AxisRecordings(stretches), setup


def hide(kind: str, axis, speeds: NDArray, generator: np.random.Generator):
    """The axis with one effect more, of a size that moves it by `MOVES` times the noise."""
    size = SIZES[kind]
    if kind == "drive_delay":
        return replace(axis, delay=float(generator.integers(1, 4)) * 1e-3)
    if kind == "stribeck":
        return replace(axis, effects=axis.effects | {"v_s": generator.uniform(0.01, 0.04)})
    length, phase = generator.uniform(0.005, 0.04), generator.uniform(-3, 3)
    shape = {
        "cogging": {"period": length, "phase": phase},
        "friction_waviness": {"wavelength": length, "wave_phase": phase},
        "friction_strengthening": {"strength_speed": generator.uniform(0.001, 0.005)},
    }.get(kind, {})
    way = generator.choice([-1, 1]) if kind == "friction_direction" else 1.0
    unit = {"friction_direction": 0.01, "cogging": 0.01, "quadratic_drag": 1.0}.get(kind, 0.001)
    moves, force = measure_shift(replace(axis, effects=shape | {size: unit}), speeds)
    sized = max(MOVES * NOISE / moves, MATTERS * axis.coulomb / force) * unit
    return replace(axis, effects=axis.effects | shape | {size: way * sized})


def measure_shift(axis, speeds: NDArray) -> tuple[float, float]:
    """By how much (rms) the axis' effects move it [m], and with what force [N], beside what a free
    start of each move, mass, friction and offset could take over."""
    from tests.reference import axis as reference

    h = 1e-3
    x, _ = reference.make_reference(speeds, 0.08, h)
    u = np.gradient(x, h)
    numbers, plain = axis.numbers(), replace(axis, effects={}).numbers()
    moves, pushes, columns = [], [], []
    moving = np.abs(u) > 1e-3
    edges = np.flatnonzero(np.diff(np.concatenate(([0], np.sign(u) * moving, [0]))))
    for a, b in pairwise(edges):
        if not moving[a] or b - a < 50:
            continue
        s, here, speed = float(np.sign(u[a])), x[a:b], u[a:b]
        f = np.array([
            reference.drive(p, 0.0, numbers) - s * reference.resist(p, v, s, 1.0, numbers)
            - reference.drive(p, 0.0, plain) + s * reference.resist(p, v, s, 1.0, plain)
            for p, v in zip(here, speed, strict=True)
        ])  # fmt: skip
        tau = np.arange(b - a) * h
        own = np.column_stack([np.ones(b - a), tau])
        every = np.column_stack([f, np.full(b - a, 1.0), np.full(b - a, s), speed])
        shifts = np.column_stack([np.cumsum(np.cumsum(every, 0), 0) * h**2 / axis.mass, here])
        shifts -= own @ np.linalg.lstsq(own, shifts, rcond=None)[0]
        moves.append(shifts[:, 0])
        pushes.append(np.column_stack([f, every[:, 1:]]))
        columns.append(shifts[:, 1:])
    return _measure_rest(np.concatenate(moves), np.concatenate(columns)), _measure_rest(
        np.concatenate(pushes)[:, 0], np.concatenate(pushes)[:, 1:]
    )


def _measure_rest(y: NDArray, X: NDArray) -> float:
    """What is left of y beside the columns of X, rms."""
    scale = np.linalg.norm(X, axis=0) + 1e-300
    left = y - X / scale @ np.linalg.lstsq(X / scale, y, rcond=1e-9)[0]
    return float(np.sqrt(np.mean(left**2)))


def run_motion(block: int, case: int) -> dict:
    """F(t) in: how far positions and derivatives are from those of brute force."""
    from difffric.axis import AxisSetup, simulate_axis
    from tests.reference import axis as reference

    generator = np.random.default_rng([block, case, 0])
    axis = draw_axis(generator)
    axis = replace(axis, k_v=0.0 if case % 10 == 9 else axis.k_v)
    made = reference.record(axis, speeds=(0.1, 0.3), travel=0.05, scatter=0.0, seed=case)
    # A force of steps and waves, not a controller's: it reverses and sticks as it likes.
    n, h = 3000, 1e-3
    steps = np.repeat(generator.uniform(-3, 3, 30), n // 30) * axis.breakaway
    waves = np.sin(2 * np.pi * generator.uniform(1, 9) * np.arange(n) * h) * axis.breakaway
    force = np.concatenate((made.force, steps + waves * generator.uniform(0, 2)))
    t, ones = np.arange(len(force)) * h, np.ones(len(force))
    setup = AxisSetup(axis.mass, axis.coulomb, axis.breakaway, axis.k_v, offset=axis.offset)
    moved = simulate_axis(setup, force, t)

    def solve(other) -> NDArray:
        return reference.follow(force, ones, h, 0.0, 0.0, other.numbers())[0]

    off = {}
    for name in ("mass_kg", "coulomb_N", "k_v_N_s_per_m", "offset_N"):
        field = PARAMETERS[name]
        value = getattr(axis, field)
        # A difference over a step that crosses an event (a break-away falls on another sample) is
        # no derivative: that over a shorter one counts then.
        found = []
        for step in (1e-5 * max(abs(value), 1.0), 1e-6 * max(abs(value), 1.0)):
            sides = [solve(replace(axis, **{field: value + k * step})) for k in (-2, -1, 1, 2)]
            expected = (sides[0] - 8 * sides[1] + 8 * sides[2] - sides[3]) / (12 * step)
            error = np.abs(moved.derivatives[name] - expected).max()
            found.append(float(error / np.abs(expected).max()))
        off[name] = min(found)
    kinds = Counter(kind for kind, _ in moved.events)
    return {
        "case": case, "position_m": float(np.abs(moved.position - solve(axis)).max()),
        "derivatives": off, "events": dict(kinds),
    }  # fmt: skip


def run_fit(block: int, case: int) -> dict:
    """A fit: how far each parameter lies from the truth, in its standard errors."""
    from difffric.axis import fit_axis

    generator = np.random.default_rng([block, case, 1])
    axis = draw_axis(generator)
    speeds = draw_speeds(generator)
    data, setup = record_axis(axis, speeds, generator, colour=(0.0, 0.9)[case % 2])
    fit = fit_axis(setup, data)
    line: dict = {"case": case, "converged": fit.converged}
    for name, field in PARAMETERS.items():
        error = fit.standard_error(name)
        line[name] = (fit.value(name) - getattr(axis, field)) / error if error else None
    return line


def run_diagnosis(part: str, block: int, case: int) -> dict:
    """A diagnosis: what was hidden, and what is said."""
    from difffric.axis import diagnose_axis

    generator = np.random.default_rng([block, case, {"clean": 2, "hidden": 3, "pairs": 4}[part]])
    kinds: tuple[str, ...] = ()
    if part == "hidden":
        kinds = ([*SIZES][case % len(SIZES)],)
    elif part == "pairs":
        kinds = PAIRS[case % len(PAIRS)]
    axis = draw_axis(generator)
    speeds = draw_speeds(generator)
    for kind in kinds:
        axis = hide(kind, axis, speeds, generator)
    colour = (0.0, 0.9)[case // len(SIZES) % 2]
    data, setup = record_axis(axis, speeds, generator, colour)
    found = diagnose_axis(setup, data)
    left = found.remaining
    return {
        "case": case, "hidden": kinds, "verdict": found.verdict,
        "found": [x.id for x in found.causes], "negligible": [x.id for x in found.negligible],
        "confusable": list(found.causes[0].confusable_with) if found.causes else [],
        "remaining_N": None if left is None else left.force,
        "coulomb_N": axis.coulomb, "effects": axis.effects, "delay_s": axis.delay,
    }  # fmt: skip


def tabulate(found: dict[str, list[dict]]) -> str:
    """The figures as a page has them."""
    out = ["| made axes | asked | found |", "| --- | --- | --- |"]
    lines = found["motion"]
    if lines:
        position = max(x["position_m"] for x in lines)
        slopes = [max(x["derivatives"].values()) for x in lines]
        stops = sum(x["events"].get("stick", 0) for x in lines)
        turns = sum(x["events"].get("reversal", 0) for x in lines)
        out.append(
            f"| {len(lines)} motions, {stops} times to rest, {turns} reversals | positions to "
            f"1e-9 m, derivatives to 1e-6 | {position:.1g} m, {max(slopes):.1g} at worst, "
            f"{sum(x < 1e-6 for x in slopes)} of {len(lines)} within |"
        )
    lines = found["fit"]
    for name in PARAMETERS if lines else ():
        z = np.abs([x[name] for x in lines if x[name] is not None])
        out.append(
            f"| {len(z)} fits, {name} | 95 % intervals hold in 93–97 %, three standard errors in "
            f"99 % | {100 * np.mean(z < 1.96):.1f} %, {100 * np.mean(z < 3):.1f} % |"
        )
    lines = found["clean"]
    if lines:
        right = sum(x["verdict"] == "adequate" for x in lines)
        out.append(f"| {len(lines)} with nothing hidden | `adequate` in 99 % | {right} |")
    lines = found["hidden"]
    for kind in [x for x in SIZES if any(line["hidden"] == [x] for line in lines)]:
        own = [x for x in lines if x["hidden"] == [kind]]
        right = sum(x["found"][:1] == [kind] for x in own)
        out.append(f"| {len(own)} with `{kind}` | named first in 95 % | {right} |")
    lines = found["pairs"]
    if lines:
        first = sum(x["found"][:1] != [] and x["found"][0] in x["hidden"] for x in lines)
        both = sum(set(x["found"]) == set(x["hidden"]) for x in lines)
        out.append(
            f"| {len(lines)} with two of these | one of them first in 95 % | {first}; both, and "
            f"nothing else, in {both} |"
        )
    return "\n".join(out)


def list_wrong(found: dict[str, list[dict]]) -> list[str]:
    """A line for each diagnosis that is wrong."""
    out = []
    for part in ("clean", "hidden", "pairs"):
        for x in found[part]:
            if set(x["found"]) != set(x["hidden"]) or (
                part == "clean" and x["verdict"] != "adequate"
            ):
                out.append(
                    f"{part} {x['case']}: hidden {x['hidden']}, {x['verdict']} {x['found']}, "
                    f"negligible {x['negligible']}, left {x['remaining_N']}"
                )
    return out


def get_code() -> str:
    """Ten digits that stand for what these figures depend on: the axis, and its reference."""
    digest = hashlib.sha256()
    paths = [*sorted((runs.ROOT / "src/difffric/axis").rglob("*.py")),
             runs.ROOT / "tests/reference/axis.py"]  # fmt: skip
    for path in paths:
        digest.update(str(path.relative_to(runs.ROOT)).encode() + path.read_bytes())
    return digest.hexdigest()[:10]


def main(words: Sequence[str] | None = None) -> int:
    """Run what is missing, print the figures, write the page."""
    parser = argparse.ArgumentParser(prog="python -m studies.axis", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--only", choices=tuple(CASES), action="append")
    parser.add_argument("--cases", type=int, help="how many of each part (default: all)")
    parser.add_argument("--block", type=int, default=0, help="which axes are drawn")
    parser.add_argument("--results", type=Path, default=runs.RESULTS)
    parser.add_argument("--page", type=Path, default=PAGE)
    asked = parser.parse_args(words)
    folder = asked.results / "axis" / f"{get_code()}_{asked.block}"
    parts: dict[str, Callable[[int, int], dict]] = {"motion": run_motion, "fit": run_fit}
    parts |= {x: partial(run_diagnosis, x) for x in ("clean", "hidden", "pairs")}
    for name in asked.only or CASES:
        count = CASES[name] if asked.cases is None else asked.cases
        runs.run(name, folder, count, partial(parts[name], asked.block))
    found = {name: runs.load(folder, name) for name in CASES}
    text = tabulate(found)
    print(text, *list_wrong(found), sep="\n")
    runs.write_into(asked.page, text, "axis")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
