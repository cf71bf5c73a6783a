"""`difffric simulate`: one push as result.json holds it, and its report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from difffric.commands import figures
from difffric.commands.reports.page import NO_STROKE, Picture, Report, Section, Table
from difffric.measurements.recorded_motion import describe_motion
from difffric.measurements.recordings import Recordings
from difffric.number_text import format_number
from difffric.progress import Tell
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.events import Regime, explain
from difffric.simulation.sensitivities import regime_margin, sensitivity
from difffric.units import from_mm_min, to_mm_min, to_um

_REGIMES = {
    "no_motion": "The part does not move.",
    "pushed_to_rest": "The part never leaves the tip, and rests in contact with it.",
    "released_by_rebound": "The part leaves the tip by its own rebound.",
    "released_at_stop": "The part leaves the tip because the tip stops.",
}
"""What happens in a push, as a person reads it."""


def describe_simulation(rig: Rig, velocity: float) -> dict:
    """Simulate a push at a speed [m/s] and return it as result.json holds it."""
    found = sensitivity(rig, velocity)
    seen = found.observables
    margin = regime_margin(rig, velocity)
    reason = explain(int(seen.reason))
    d = float(seen.sliding_distance)
    return {
        "peak_force_N": float(seen.peak_force),
        "peak_contact_force_N": float(seen.peak_force),
        "sliding_distance_m": None if reason else d,
        "reason": reason,
        "regime": Regime(int(seen.regime)).word,
        "stuck_first": bool(seen.stuck_first),
        "contacts": int(seen.contacts),
        "margin": margin.margin if np.isfinite(margin.margin) else None,
        "side": margin.side,
        "stroke": NO_STROKE if rig.pusher.stroke is None else None,
        "derivatives": {
            "peak_force_N": {k: float(v) for k, v in found.peak_force.items()},
            "sliding_distance_m": {k: float(v) for k, v in found.sliding_distance.items()},
        },
    }


def describe_motions(rig: Rig, recordings: Recordings, own_mass: bool, tell: Tell) -> dict:
    """Simulate the pushes that recorded motions drive, and return them as result.json holds them;
    `own_mass`: whether what a recording says of the mass counts."""
    rows = []
    for i, push in enumerate(recordings):
        tell("simulating", i / len(recordings))
        mass = push.mass if own_mass and np.isfinite(push.mass) else None
        at = parameters.override(rig, {"mass_kg": mass}, push.motion.law)
        answer = describe_simulation(at, push.velocity)
        for by in answer["derivatives"].values():
            by.pop("velocity_m_per_s", None)  # the motion is what it is
        motion = {
            "travel_m": push.motion.travel,
            "end_s": push.motion.end,
            "bandwidth_Hz": push.motion.bandwidth,
            "noise_m": push.motion.noise,
        }
        rows.append({"name": push.name, "motion": motion, **answer})
    return {"pushes": rows}


def report_motions(answer: dict, recordings: Recordings) -> Report:
    """Return the report of pushes that recorded motions drive."""
    rows = [
        [
            row["name"],
            format_number(to_mm_min(row["motion"]["travel_m"] / row["motion"]["end_s"]), 5),
            format_number(row["peak_force_N"], 6),
            row["reason"] or format_number(to_um(row["sliding_distance_m"]), 6),
            row["regime"].replace("_", " "),
        ]
        for row in answer["pushes"]
    ]
    head = ("push", "mean speed [mm/min]", "F_p [N]", "d [µm]", "regime")
    table = Table("Pushes", head, rows)
    title = f"{len(rows)} pushes driven by their recorded pushers"
    return Report(title, list(describe_motion(recordings)), [Section("Pushes", (), [table])])


def draw_simulation(rig: Rig, velocity: float) -> list[Picture]:
    """Simulate the push once more, and draw its position and force over time."""
    from difffric.simulation.trajectory import simulate  # here: JAX comes with it

    push = {"": simulate(rig, velocity)}
    return [
        Picture(
            "position",
            "The position of the part over time.",
            figures.paper.draw_response(push, "position"),
        ),
        Picture(
            "force", "The contact force over time.", figures.paper.draw_response(push, "force")
        ),
    ]


def report_simulation(
    answer: dict, velocity_mm_min: float, rig: Rig, pictures: Sequence[Picture]
) -> Report:
    """Return the report of one push."""
    d = answer["sliding_distance_m"]
    distance = (
        f"d = {format_number(to_um(d), 6)} µm"
        if d is not None
        else f"and there is no d: {answer['reason']}"
    )
    first = " It sticks before it slides." if answer["stuck_first"] else ""
    times = "once" if answer["contacts"] == 1 else f"{answer['contacts']} times"
    summary = [
        f"F_p = {format_number(answer['peak_force_N'], 6)} N, {distance}",
        f"{_REGIMES[answer['regime']]}{first} The tip touches it {times}.",
    ]
    if answer["margin"] is not None:
        change = format_number(100 * answer["margin"], 3)
        summary.append(f"A change of mu_s by {change} % would change what happens in the push.")
    if answer["side"] != "both":
        summary.append(f"The derivatives hold for changes to the {answer['side']} only.")
    if answer["stroke"]:
        summary.append(answer["stroke"])
    derivatives = answer["derivatives"]
    values = {**parameters.values(rig), "velocity_m_per_s": from_mm_min(velocity_mm_min)}
    dd = derivatives["sliding_distance_m"]
    rows = [
        [name, format_number(float(values[name]), 6), format_number(dF), format_number(dd[name])]
        for name, dF in derivatives["peak_force_N"].items()
    ]
    table = Table(
        "Exact derivatives of F_p and d with respect to each parameter [SI]",
        ("parameter", "value", "of F_p [N per unit]", "of d [m per unit]"),
        rows,
    )
    title = f"One push at {velocity_mm_min:g} mm/min"
    return Report(title, summary, [Section("Derivatives", (), [table], pictures)])
