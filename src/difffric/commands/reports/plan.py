"""`difffric plan`: the next push as result.json holds it, and the report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from difffric.centering.planning import SCATTER, Known, Plan, PlannedPush
from difffric.centering.ring import Ring, measure
from difffric.centering.ring_csv import load_ring
from difffric.commands import figures
from difffric.commands.reports.page import Picture, Report, Section, Table
from difffric.errors import InputError
from difffric.number_text import format_number
from difffric.rig import parameters
from difffric.rig.setup import Extras, Setup
from difffric.units import from_mm, from_um, to_mm, to_mm_min, to_um

SOURCES = {
    "mu_s": "mu_s: scatter from push to push, and its mean",
    "offset": "where the part stands",
}


def replace_mu_s(setup: Setup, mu_s: float | None, error: float | None) -> Setup:
    """Return the set-up with another mu_s, or another standard error of it, where given."""
    rig = setup.rig if mu_s is None else parameters.with_values(setup.rig, {"mu_s": mu_s})
    extras = dict(setup.extras)
    if mu_s is not None or error is not None:
        extras["mu_s"] = Extras(standard_error=error)
    return replace(setup, rig=rig, extras=extras)


def find_offset(
    offset_um: float | None, error_um: float, ring: Path | None, radius_mm: float | None
) -> tuple[float, float, Ring | None]:
    """(offset [m], its standard error [m], the ring that it was found from). Raises `InputError`
    unless one of both says it."""
    if (offset_um is None) == (ring is None):
        raise InputError("the offset: expected --offset-um or --ring, one of them")
    if ring is None:
        return from_um(offset_um), from_um(error_um), None
    try:
        found = measure(*load_ring(ring, None if radius_mm is None else from_mm(radius_mm)))
    except InputError as error:
        raise InputError(str(error) if str(ring) in str(error) else f"{ring}: {error}") from None
    return found.offset, found.offset_se, found


def list_notes(setup: Setup) -> list[str]:
    """Return a line for each thing that the set-up does not say, and what is taken instead."""
    said = setup.extras.get("mu_s", Extras()).standard_error
    notes = []
    if setup.mu_s_scatter is None:
        notes.append(f"mu_s_scatter is not given: {100 * SCATTER:g} % is taken.")
    if not said:
        notes.append("mu_s has no standard error: its mean is taken to be exact.")
    if not any(e.standard_error for name, e in setup.extras.items() if name != "mu_s"):
        notes.append("The calibration has no standard errors: it is taken to be exact.")
    return notes


def describe_push(step: PlannedPush) -> dict:
    """Return a planned push as result.json holds it."""
    return {
        "velocity_m_per_s": step.velocity,
        "stroke_m": step.stroke,
        "duration_s": step.duration,
        "aim_m": step.aim,
        "probability": step.probability,
        "landing_standard_deviation_m": step.deviations["all"],
        "by_source_m": {k: v for k, v in step.deviations.items() if k != "all"},
        "limited_by": step.limited_by,
        "released": step.released,
    }


def describe_plan(found: Plan, known: Known, ring: Ring | None, notes: list[str]) -> dict:
    """Return a plan as result.json holds it."""
    mean, error = known.mu_s.mean
    first = found.options
    return {
        "offset_m": found.target,
        "offset_standard_error_m": found.target_error,
        "direction_rad": None if ring is None else ring.direction,
        "within_m": known.within,
        "mu_s": mean,
        "mu_s_relative_standard_error": error,
        "mu_s_scatter": known.mu_s.scatter,
        "probability": found.probability,
        "pushes": [describe_push(step) for step in found.steps],
        "speeds": [
            {
                "velocity_m_per_s": float(v),
                "stroke_m": _drop_nan(first.stroke[0, i]),
                "duration_s": _drop_nan(first.duration[0, i]),
                "probability": _drop_nan(first.probability[0, i]),
            }
            for i, v in enumerate(first.velocity)
        ],
        "ring": None if ring is None else ring.as_dict(),
        "notes": notes,
    }


def _drop_nan(x) -> float | None:
    return float(x) if np.isfinite(x) else None


def report_plan(
    found: Plan, known: Known, answer: dict, ring: Ring | None, pictures: bool
) -> Report:
    """Return the report of a plan; with figures where there are to be pictures."""
    step = found.next
    turn = [] if ring is None else [f"turn the ring to {np.degrees(ring.direction):.3f} degrees"]
    line = ", ".join(
        [
            *turn,
            f"push by {to_um(step.stroke):.2f} µm at {to_mm_min(step.velocity):.0f} mm/min",
        ]
    )
    within = f"{to_um(known.within):g} µm"
    summary = [
        f"{line[0].upper()}{line[1:]}.",
        f"The part ends within {within} of the target with a probability of {step.probability:.4f}"
        + (
            f"; after {len(found.steps)} pushes the probability is {found.probability:.4f}."
            if len(found.steps) > 1
            else "."
        ),
        *answer["notes"],
    ]
    if not step.released:
        summary.append("The part is likely to rest in contact with the tip: there will be no d.")
    if step.probability < 0.99:
        summary.append(f"What limits the probability: {_name_source(step.limited_by)}.")
    rows = [
        [
            str(i),
            format_number(to_mm_min(s.velocity), 4),
            format_number(to_um(s.stroke), 6),
            format_number(to_um(s.aim), 5),
            format_number(to_um(s.deviations["all"]), 3),
            f"{s.probability:.4f}",
            format_number(s.duration, 3),
        ]
        for i, s in enumerate(found.steps, 1)
    ]
    columns = (
        "push",
        "speed [mm/min]",
        "stroke [µm]",
        "aim [µm]",
        "spread [µm]",
        "probability to land",
        "time [s]",
    )
    spread = [
        [_name_source(k), format_number(to_um(v), 3)]
        for k, v in step.deviations.items()
        if k != "all"
    ]
    tables = [
        Table("The planned pushes; those after the first are what is likely then", columns, rows),
        Table(
            "What spreads the first push's landing", ("source", "standard deviation [µm]"), spread
        ),
    ]
    drawn = []
    if pictures:
        drawn = [
            Picture(
                "speeds",
                "For each speed the push that ends at the target: how likely the part lands within "
                "the tolerance, how its landing spreads, and the stroke. A line marks the push "
                "that was taken.",
                figures.plan.draw_speeds(found, known),
            )
        ]
    text = (
        f"The target is {to_mm(found.target):.6g} mm away. The stroke is solved on the whole push "
        "(contact, rebound, further contacts, slide); the part may also end in contact with the "
        "tip, which then goes back and leaves it there.",
    )
    advice = [
        "Make the push, and measure what it gives: its F_p and d tell mu_s better for the next "
        "plan (--mu-s, --mu-s-se)."
    ]
    return Report("The next push", summary, [Section("Plan", text, tables, drawn)], advice)


def _name_source(name: str) -> str:
    return SOURCES.get(name, f"{name}, as calibrated")
