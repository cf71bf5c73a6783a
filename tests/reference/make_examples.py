"""Writes examples/: a set-up of rough guesses, and measurements whose truth is known.

    python -m tests.reference.make_examples [DIR]

The same seed gives the same files.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.reference import files, rings
from tests.reference.data import (
    MM_MIN,
    Noise,
    Push,
    Rig,
    make_pushes,
    measure,
    measure_slides,
    record,
)

SEED = 20250301
EXAMPLES = Path(__file__).parents[2] / "examples"
DRY = Rig(m=18.9, mu_s=0.141, ratio=0.75, k_v=6.0, k=8.2e5, b=1600.0, scatter=0.02, stroke=1.2e-3)
RIGS = {"DRY": DRY, "OILY": replace(DRY, mu_s=0.106)}
SPEEDS = tuple(MM_MIN * v for v in (600, 1000, 1500, 2000, 3000, 4000, 5000))
NOISE = Noise(force=0.5, position=0.3e-6, force_step=2 * 446.0 / 2**15, position_step=20e-9)
FORCE_SE, DISTANCE_SE = 0.3, 0.2e-6  # of the table: read by hand from the recordings' curves
SLIDES = 20
SLIDE_VELOCITY_SE, SLIDE_DISTANCE_SE = 0.01, 20e-6

RING = {
    "offset_um": 412.7, "direction_deg": -58.3, "radius_mm": 60.0, "noise_um": 0.3,
    "lobes_um": {"2": [1.4, -0.6], "3": [0.3, 0.8], "5": [-0.2, 0.15]},
}  # fmt: skip
"""Of ring.csv: the offset is the whole first harmonic, the ring's own included."""

WATCHED = {"pushes": 60, "changed_from": 41, "factor": 1.06}
"""Of watched.csv: from that push on, mu_s is larger by the factor."""

SETUP = """\
# Rough guesses for the rig of pushes.csv and pushes.tdms: what an engineer knows before the first
# fit. truth.json holds the true numbers.

[part]
mass_kg = 18.9                # weighed

[friction]                    # equation (1)
mu_s = 0.12                   # a guess, for both conditions
mu_k_over_mu_s = 0.75
k_v_N_s_per_m = 5.0           # a guess

[contact]                     # equation (2)
k_N_per_m = 5.0e5             # a guess: the truth may be twice that
b_N_s_per_m = 900.0           # a guess: the truth may be twice that

[pusher]
stroke_mm = 1.2

[force_sensor]                # from its data sheet
sensitivity_mV_per_N = 11.2
range_N = 446.0
rate_Hz = 10000.0
noise_N = 0.5

[probe]
resolution_um = 0.02
noise_um = 0.3
"""

README = """\
# Examples

These files are made data. Their truth is known, so that you can compare a fit with it. The commands
below run in a clone of this repository.

| file | contents |
| --- | --- |
| `setup.toml` | an engineer's rough guesses of the rig |
| `pushes.csv` | {n} pushes, DRY and OILY: `F_p` and `d` with their standard errors |
| `pushes.tdms` | the same {n} pushes recorded: force and position at 10 kHz |
| `slides.csv` | {slides} free slides, DRY and OILY: release speed and distance |
| `ring.csv` | 360 probe readings of a ring over a rotation: 4 missing, 9 outliers |
| `watched.csv` | 60 pushes of the DRY part in a row; the friction rises by 6 % at push 41 |
| `hidden/` | 10 recordings of a rig whose friction falls with speed, its rough set-up, its truth |
| `axis/` | a recording of a servo axis whose drive cogs, its rough set-up, its truth |
| `pneumatic_cylinder/` | a measured piston (CC0): friction under an imposed motion |
| `truth.json` | the truth behind the data: the rig, each push's own `mu_s`, its `F_p` and `d` |

```sh
difffric fit examples/pushes.tdms --setup examples/setup.toml --out out/fit
difffric identify examples/pushes.csv --setup examples/setup.toml --out out/identify
difffric ring examples/ring.csv --out out/ring
difffric plan examples/setup.toml --ring examples/ring.csv --out out/plan
difffric centre examples/setup.toml --rings 10 --out out/centre
difffric monitor examples/watched.csv --setup out/fit/setup.toml --out out/monitor
difffric export out/fit/setup.toml --out out/controller
difffric diagnose examples/hidden/pushes.tdms --setup examples/hidden/setup.toml --out out/diagnose
```

## How they were made

The simulator of the tests made them. It solves equations (1) and (2) piece by piece, in closed
form, and shares no code with the library:

```sh
.venv/bin/python -m tests.reference.make_examples
```

Seed {seed}. In each push `mu_s` differs from its condition's value by a scatter of {scatter:g} %
(log `mu_s` is normal). The recordings begin 20 ms before the push and end 30 ms after the last
motion. Their noise is white, {force:g} N and {position:g} µm; the force is rounded to steps
of a 16-bit converter over ±446 N, the position to 20 nm, from a zero that differs from push to
push. The noise of the table is {force_se:g} N and {distance_se:g} µm; the noise of the slides is
{slide_velocity_se:g} % in speed and {slide_distance_se:g} µm.

`ring.csv` is made by meeting rays from the axis with the ring's surface by bisection; its offset,
direction and lobes are in `truth.json`.

The simulator of the tests of `diagnose` makes `hidden/`. Its effect changes `F_p` or `d` by 5 %:

```sh
.venv/bin/python -m tests.hidden.make_examples
```
"""


def draw() -> tuple[list[Push], np.random.Generator]:
    """The pushes, and the generator for their noise."""
    rng = np.random.default_rng(SEED)
    pushes: list[Push] = []
    for condition, rig in RIGS.items():
        n, first = len(SPEEDS), len(pushes) + 1
        pushes += make_pushes(rig, rng, n, SPEEDS, condition=condition, first=first)
    return pushes, rng


def make_ring() -> str:
    """The text of ring.csv: a lobed ring off its axis, with missing samples and outliers."""
    rng = np.random.default_rng(SEED + 1)
    phi, offset = np.radians(RING["direction_deg"]), 1e-6 * RING["offset_um"]
    centre = offset * np.array([np.cos(phi), np.sin(phi)])
    lobes = {int(n): (1e-6 * a, 1e-6 * b) for n, (a, b) in RING["lobes_um"].items()}
    angle, radius, _ = rings.readings(
        rng, centre, 1e-3 * RING["radius_mm"], lobes=lobes, noise=1e-6 * RING["noise_um"]
    )
    some = rng.permutation(len(angle))
    radius[some[:9]] += 1e-6 * rng.uniform(5, 60, 9)  # chips under the probe
    cells = [f"{1e3 * r:.6f}" for r in radius]
    for i in some[9:13]:
        cells[i] = ""
    rows = (f"{a:.6g},{cell}" for a, cell in zip(np.degrees(angle), cells, strict=True))
    return "\n".join(["angle_deg,radius_mm", *rows, ""])


def watched() -> tuple[list[Push], np.random.Generator]:
    """The pushes of watched.csv, and the generator for their noise."""
    rng = np.random.default_rng(SEED + 2)
    first, speeds = WATCHED["changed_from"], [MM_MIN * v for v in (2000, 3000, 5000)]
    later = replace(DRY, mu_s=WATCHED["factor"] * DRY.mu_s)
    pushes = make_pushes(DRY, rng, first - 1, speeds, condition="DRY")
    rest = WATCHED["pushes"] + 1 - first
    return pushes + make_pushes(later, rng, rest, speeds, condition="DRY", first=first), rng


def write(directory: Path) -> None:
    """Write all files of examples/."""
    directory.mkdir(parents=True, exist_ok=True)
    pushes, rng = draw()
    table = measure(pushes, rng, force_se=FORCE_SE, distance_se=DISTANCE_SE)
    files.write_table(directory / "pushes.csv", table, digits=6)
    recorded = [record(push, rng, noise=NOISE) for push in pushes]
    files.write_recordings(directory / "pushes.tdms", recorded)
    slides = [
        measure_slides(
            rig,
            rng,
            SLIDES,
            condition=condition,
            velocity_se=SLIDE_VELOCITY_SE,
            distance_se=SLIDE_DISTANCE_SE,
        )
        for condition, rig in RIGS.items()
    ]
    both = {name: np.concatenate([s.columns[name] for s in slides]) for name in slides[0].columns}
    both["order"] = np.arange(1.0, len(both["order"]) + 1)
    files.write_table(directory / "slides.csv", both, digits=6)
    own = np.concatenate([s.mu_s for s in slides])
    files.write_json(
        directory / "truth.json",
        {
            "seed": SEED,
            **files.truth(RIGS, pushes),
            "ring": RING,
            "watched": WATCHED,
            "slides": {"mu_s": [files.in_unit(mu_s, 1.0, 10) for mu_s in own]},
        },
    )
    (directory / "setup.toml").write_text(SETUP)
    (directory / "ring.csv").write_text(make_ring())
    table = measure(*watched(), force_se=FORCE_SE, distance_se=DISTANCE_SE)
    files.write_table(directory / "watched.csv", table, digits=6)
    said = README.format(
        n=len(pushes),
        slides=len(own),
        seed=SEED,
        scatter=100 * DRY.scatter,
        force=NOISE.force,
        position=1e6 * NOISE.position,
        force_se=FORCE_SE,
        distance_se=1e6 * DISTANCE_SE,
        slide_velocity_se=100 * SLIDE_VELOCITY_SE,
        slide_distance_se=1e6 * SLIDE_DISTANCE_SE,
    )
    (directory / "README.md").write_text(said, encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else EXAMPLES)
