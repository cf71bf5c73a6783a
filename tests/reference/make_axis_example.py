"""Make `examples/axis`: a recording of a made axis with a force that repeats along it, and what is
true of it.

    REFERENCE_JIT=1 python -m tests.reference.make_axis_example
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from tests.reference.axis import Axis, record, write_csv

FOLDER = Path(__file__).parents[2] / "examples" / "axis"
GAIN = 35.15
"""Newtons that the drive gives for a volt."""
SETUP = """\
# An engineer's rough guess of a linear axis; what is free is fitted.
[axis]
mass_kg = 60.0

[friction]
coulomb_N = 40.0
k_v_N_s_per_m = 100.0

[drive]
gain_N_per_V = 35.15

[probe]
resolution_um = 1.0
"""
AXIS = Axis(
    mass=95.0, coulomb=20.0, breakaway=24.0, k_v=200.0, offset=3.0,
    effects={"amplitude": 1.0, "period": 0.016, "phase": 0.6},
)  # fmt: skip


def main() -> None:
    """Write the recording, the set-up and the truth."""
    made = record(
        AXIS, speeds=(0.03, 0.06, 0.1, 0.15, 0.2), travel=0.08, h=2e-3, noise=1e-6, scatter=0.01,
        disturbance=0.1, disturbance_colour=0.95, bandwidth=5.0, seed=11,
    )  # fmt: skip
    FOLDER.mkdir(parents=True, exist_ok=True)
    write_csv(FOLDER / "recording.csv", made, volts_per_newton=1 / GAIN)
    (FOLDER / "setup.toml").write_text(SETUP, encoding="utf-8")
    levels = [made.level[made.stretch == k][0] for k in range(5)]
    truth = asdict(AXIS) | {"coulomb_of_stretches_N": [AXIS.coulomb * x for x in levels]}
    truth |= {"scatter": 0.01, "encoder_noise_m": 1e-6, "force_disturbance_N": 0.1}
    (FOLDER / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
