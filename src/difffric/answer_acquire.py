"""`difffric acquire`: the pushes to make, the simulated rig in front of the card, what was
recorded as result.json holds it, and its report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from difffric import parameters
from difffric.acquire import Acquired, Command
from difffric.errors import NumericalError
from difffric.push import REASONS
from difffric.report import Report, Section, Table, number
from difffric.setup_file import Setup
from difffric.simulated_card import SimulatedCard
from difffric.trajectory import simulate
from difffric.units import from_mm, from_mm_min, to_mm, to_mm_min, to_um

PAPER_SPEEDS_MM_MIN = (500.0, 1000.0, 2000.0, 3000.0, 4000.0, 5000.0)
"""Of the paper's Tables I-IV."""
STROKE = from_mm(2.0)
"""[m], where nothing gives one."""
NO_STROKE = "No stroke is given: 2 mm is commanded."
_NOISE_FORCE, _NOISE_POSITION = 0.5, 0.3e-6  # [N], [m], where the set-up says none


def commands(speeds_mm_min: Sequence[float], *, stroke=None, mass=np.nan) -> list[Command]:
    """The pushes to make, in order; the paper's speeds twice where none are given. SI units but
    for the speeds [mm/min]."""
    speeds = speeds_mm_min or 2 * PAPER_SPEEDS_MM_MIN
    travel = STROKE if stroke is None else float(stroke)
    return [Command(from_mm_min(v), travel, float(mass)) for v in speeds]


class SimulatedRig:
    """A set-up's rig under the push tip, each push with a mu_s of its own under `mu_s_scatter`
    (log-normal, by `seed`): the trace of a `SimulatedCard`, and in `truth` what was pushed.

    Raises `NumericalError` for a push that never comes to rest or cannot be followed.
    """

    def __init__(self, setup: Setup, seed: int = 0):
        self.rig, self.scatter = setup.rig, setup.mu_s_scatter or 0.0
        self.random = np.random.default_rng(seed)
        self.truth: list[dict] = []

    def __call__(self, velocity: float, stroke: float):
        """The push at any time, and when all of it is at rest [s]."""
        mean = float(parameters.values(self.rig)["mu_s"])
        mu_s = mean * float(np.exp(self.scatter * self.random.standard_normal()))
        push = simulate(self.rig, velocity, stroke=stroke, mu_s=mu_s)
        if push.reason not in (None, REASONS[1]):
            raise NumericalError(
                f"{to_mm_min(velocity):g} mm/min cannot be recorded: {push.reason}"
            )
        d = None if push.reason else float(push.sliding_distance)
        self.truth.append(
            {
                "mu_s": mu_s,
                "peak_force_N": float(push.peak_force),
                "sliding_distance_m": d,
                "reason": push.reason,
                "regime": push.regime,
            }
        )

        def evaluate(t):
            force, position, _ = push.evaluate(t)
            return np.asarray(force), np.asarray(position)

        return evaluate, max(float(push.stop_time), stroke / velocity)


def simulated_card(setup: Setup, rate: float | None, seed: int) -> tuple[SimulatedCard, list[dict]]:
    """A card before the set-up's rig, and the list that its pushes' truth goes to."""
    rig, pushed = setup.rig, SimulatedRig(setup, seed)
    sensor, probe = rig.force_sensor, rig.probe
    card = SimulatedCard(
        pushed,
        rate=float(sensor.rate) if rate is None else rate,
        sensitivity=float(sensor.sensitivity),
        range=float(sensor.range),
        noise_force=_NOISE_FORCE if sensor.noise is None else float(sensor.noise),
        resolution=float(probe.resolution),
        noise_position=_NOISE_POSITION if probe.noise is None else float(probe.noise),
        seed=seed,
    )
    return card, pushed.truth


def acquire_answer(
    acquired: Sequence[Acquired], file: str, *, truth: Sequence[dict] = (), seed=None, stroke=None
) -> dict:
    """What was recorded, as `difffric acquire` writes it. `truth` has an entry a push where the
    pushes were simulated; `stroke` says so where none was given."""
    pushes = [
        {
            "name": one.name,
            "velocity_m_per_s": one.command.velocity,
            "stroke_m": one.command.stroke,
            "mass_kg": one.command.mass,
            "samples": one.samples,
            "lost_samples": one.lost,
            "duration_s": one.samples / one.rate,
            "simulated": truth[i] if truth else None,
        }
        for i, one in enumerate(acquired)
    ]
    return {
        "file": file,
        "simulated": bool(truth),
        "seed": seed,
        "rate_Hz": acquired[0].rate,
        "samples": sum(one.samples for one in acquired),
        "lost_samples": sum(one.lost for one in acquired),
        "stroke": stroke,
        "pushes": pushes,
    }


def acquire_report(answer: dict) -> Report:
    """What was recorded, for a person."""
    lost = answer["lost_samples"]
    source = "simulated" if answer["simulated"] else "of the card"
    summary = [
        f"{len(answer['pushes'])} pushes {source} at {answer['rate_Hz']:g} Hz, {answer['samples']} "
        f"samples, in {answer['file']}",
        f"{lost} samples were lost: those recordings end early." if lost else "No sample was lost.",
    ]
    if answer["stroke"]:
        summary.append(answer["stroke"])
    columns = ["push", "mm/min", "stroke [mm]", "samples", "lost"]
    if answer["simulated"]:
        columns += ["mu_s", "F_p [N]", "d [µm]"]
    rows = []
    for push in answer["pushes"]:
        row = [
            push["name"],
            number(to_mm_min(push["velocity_m_per_s"]), 6),
            number(to_mm(push["stroke_m"])),
            str(push["samples"]),
            str(push["lost_samples"]),
        ]
        if answer["simulated"]:
            true = push["simulated"]
            d = true["sliding_distance_m"]
            row += [number(true["mu_s"]), number(true["peak_force_N"], 5)]
            row.append(number(None if d is None else to_um(d), 5))
        rows.append(row)
    caption = "What was recorded" + (", and the truth behind it" if answer["simulated"] else "")
    return Report(
        "Recorded pushes", summary, [Section("Pushes", (), [Table(caption, columns, rows)])]
    )
