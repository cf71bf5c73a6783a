"""What `difffric acquire` does with a card: pushes recorded and identified as they come; its answer
and report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from difffric.acquisition.card import METRES_PER_COUNT, VOLTS_PER_WORD, CardError, CardSession
from difffric.acquisition.push import Acquired, Command
from difffric.acquisition.recorder import acquire
from difffric.commands import figures
from difffric.commands.figures.live_view import LivePlot, LiveView, list_notes
from difffric.commands.reports.page import Picture, Report, Section, Table
from difffric.errors import InputError
from difffric.identification.live import LiveIdentifier, LivePush
from difffric.measurements.recordings import Recording
from difffric.number_text import format_number, format_pair
from difffric.rig.setup import Setup
from difffric.units import from_mm, from_mm_min, to_mm, to_mm_min, to_um

PAPER_SPEEDS_MM_MIN = (500.0, 1000.0, 2000.0, 3000.0, 4000.0, 5000.0)
"""Of the paper's Tables I-IV."""
STROKE = from_mm(2.0)
"""[m], where nothing gives one."""
NO_STROKE = "No stroke is given: 2 mm is commanded."
_WAYS = ("mu_s_force", "mu_s_distance", "mu_s_weighted", "mu_s_optimal")


def plan_commands(
    speeds_mm_min: Sequence[float], *, stroke: float | None = None, mass: float = np.nan
) -> list[Command]:
    """Return the pushes to make, in order: speeds [mm/min], stroke [m], mass [kg].

    Where no speeds are given they are those of the paper, twice; without a stroke it is `STROKE`.
    """
    speeds = speeds_mm_min or 2 * PAPER_SPEEDS_MM_MIN
    travel = STROKE if stroke is None else float(stroke)
    return [Command(from_mm_min(v), travel, float(mass)) for v in speeds]


@dataclass(frozen=True)
class Run:
    """What was recorded, push by push, and what it said."""

    acquired: Sequence[Acquired]
    found: Sequence[LivePush | None]
    """None: there is no set-up to identify with"""
    first: Sequence[Recording]
    """the first two recordings, in newtons where the sensor is known"""
    file: str
    resolution: float
    """of the encoder [m]"""
    sensitivity: float | None
    """[V/N]; None: not known"""


def record(
    session: CardSession,
    pushes: Sequence[Command],
    folder: Path,
    *,
    setup: Setup | None,
    quiet: bool = False,
    plot: bool = False,
) -> Run:
    """Make the pushes and stream them into `folder`/pushes.tdms, each identified on the rig of
    the set-up as soon as it has ended, and shown."""
    file = folder / "pushes.tdms"
    if file.exists():  # said before the programs are compiled
        raise InputError(f"{file}: exists, and recordings are not overwritten")
    found: list[LivePush | None] = []
    first: list[Recording] = []
    resolution = METRES_PER_COUNT if setup is None else float(setup.rig.probe.resolution)
    with ExitStack() as stack:
        view = stack.enter_context(LiveView(identified=setup is not None, quiet=quiet))
        drawn = LivePlot(folder) if plot else None
        identify = setup and LiveIdentifier(setup, pushes, tell=view.tell)

        def on_push(acquired: Acquired, recording: Recording) -> None:
            one = identify(acquired, recording) if identify else None
            found.append(one)
            view.add(acquired, one)
            if acquired.samples == 0:
                return
            shown = recording.in_newtons(setup.rig.force_sensor.sensitivity) if setup else recording
            if len(first) < 2:
                first.append(shown)
            if drawn:
                drawn.add(one, shown)

        acquired = acquire(
            session, pushes, file, on_push=on_push, tell=view.tell, resolution=resolution
        )
    sensitivity = None if setup is None else float(setup.rig.force_sensor.sensitivity)
    return Run(acquired, found, first, file.name, resolution, sensitivity)


def require_all_samples(run: Run) -> None:
    """Raise `CardError` where the card took samples that did not come.

    Lost samples are a failure, also where all else was recorded.
    """
    cut = [one for one in run.acquired if one.lost]
    if cut:
        why = "a FIFO was full" if any(x.hardware.overflow for x in cut) else "words are missing"
        raise CardError(
            f"{sum(one.lost for one in cut)} samples were lost ({why}), in "
            f"{', '.join(one.name for one in cut)}; {run.file} has those pushes up to there, and "
            "all others whole"
        )


def describe_run(
    run: Run, *, truth: Sequence[dict] = (), seed: int | None = None, stroke: str | None = None
) -> dict:
    """Return what was recorded as result.json holds it.

    `truth` has an entry for each push where the pushes were simulated; `stroke` is the note that
    none was given.
    """
    pushes = [
        {
            "name": one.name,
            "velocity_m_per_s": one.command.velocity,
            "stroke_m": one.command.stroke,
            "mass_kg": one.command.mass,
            "samples": one.samples,
            "lost_samples": one.lost,
            "duration_s": one.samples / one.rate,
            "fault": one.fault or None,
            "hardware": _describe_hardware(one, found, run),
            **_describe_friction(found),
            "simulated": truth[i] if truth else None,
        }
        for i, (one, found) in enumerate(zip(run.acquired, run.found, strict=True))
    ]
    return {
        "file": run.file,
        "simulated": bool(truth),
        "seed": seed,
        "rate_Hz": run.acquired[0].rate,
        "samples": sum(one.samples for one in run.acquired),
        "lost_samples": sum(one.lost for one in run.acquired),
        "stroke": stroke,
        "pushes": pushes,
    }


def _describe_hardware(one: Acquired, found: LivePush | None, run: Run) -> dict:
    """What the card itself saw, and whether the recording says the same."""
    seen, problems = one.hardware, [*one.hardware.problems, *(found.problems if found else ())]
    step = run.sensitivity and VOLTS_PER_WORD / run.sensitivity
    return {
        "peak_word": seen.peak_word,
        "peak_force_N": step and step * seen.peak_word,
        "released": seen.released,
        "release_sample": seen.release_sample if seen.released else None,
        "release_position_m": run.resolution * seen.release_count if seen.released else None,
        "saturated_samples": seen.saturated_samples,
        "encoder_error": seen.encoder_error,
        "overflow": seen.overflow,
        "agrees": False if problems else seen.agrees,
        "problems": problems,
    }


def _describe_friction(found: LivePush | None) -> dict:
    """What a push said of mu_s, as `identify` names it; null without a set-up."""
    friction, seen = (None, None) if found is None else (found.friction, found.reduced)
    ways = {way: friction and getattr(friction, way).as_dict() for way in _WAYS}

    def read(quantity):
        value = np.nan if seen is None else getattr(seen, quantity)
        se = np.nan if seen is None else getattr(seen, f"{quantity}_se")
        return None if np.isnan(value) else {"value": value, "standard_error": se}

    return {
        "peak_force_N": read("peak_force"),
        "sliding_distance_m": read("sliding_distance"),
        "regime": friction and friction.regime,
        **ways,
        "weights": friction and friction.weights,
        "alternatives": list(friction.alternatives) if friction else [],
        "reason": "no set-up to identify with" if found is None else found.reason,
        "answered_after_s": found and found.seconds,
    }


def report_run(answer: dict, run: Run, pictures: bool = False) -> Report:
    """Return the report of what was recorded; with figures where there are to be pictures."""
    lost = answer["lost_samples"]
    source = "of a simulated card" if answer["simulated"] else "of the card"
    summary = [
        f"{len(answer['pushes'])} pushes {source} were recorded at {answer['rate_Hz']:g} Hz, with "
        f"{answer['samples']} samples, into {answer['file']}.",
        f"{lost} samples were lost: those recordings end early." if lost else "No sample was lost.",
    ]
    if answer["stroke"]:
        summary.append(answer["stroke"])
    told = [
        [one.name, words]
        for one, found in zip(run.acquired, run.found, strict=True)
        for words in list_notes(one, found)
    ]
    wrong = sum(
        bool(x.troubles or (y and y.problems)) for x, y in zip(run.acquired, run.found, strict=True)
    )
    if wrong:
        summary.append(f"Something is wrong with {wrong} of the pushes; the notes say what.")
    tables = [_tabulate_recorded(answer)]
    if any(run.found):
        tables.append(_tabulate_friction(answer))
    if told:
        tables.append(Table("Notes", ("push", "note"), told))
    drawn = []
    if pictures and len(run.first) == 2:
        drawn.append(
            Picture(
                "strokes",
                "The force over two strokes in a row. At the dotted line the time between them is "
                "left out.",
                figures.acquire.draw_strokes(run.first),
            )
        )
    advice = ["Give the file to difffric fit to calibrate, or to difffric identify for mu_s."]
    if wrong or lost:
        advice.insert(0, "Mend what the notes name, and record those pushes again.")
    return Report("Recorded pushes", summary, [Section("Pushes", (), tables, drawn)], advice)


def _tabulate_recorded(answer: dict) -> Table:
    columns = ["push", "speed [mm/min]", "stroke [mm]", "samples", "lost samples"]
    if answer["simulated"]:
        columns += ["true mu_s", "true F_p [N]", "true d [µm]"]
    rows = []
    for push in answer["pushes"]:
        row = [
            push["name"],
            format_number(to_mm_min(push["velocity_m_per_s"]), 6),
            format_number(to_mm(push["stroke_m"])),
            str(push["samples"]),
            str(push["lost_samples"]),
        ]
        if answer["simulated"]:
            true = push["simulated"]
            d = true["sliding_distance_m"]
            row += [format_number(true["mu_s"]), format_number(true["peak_force_N"], 5)]
            row.append(format_number(None if d is None else to_um(d), 5))
        rows.append(row)
    caption = "What was recorded" + (", and the truth behind it" if answer["simulated"] else "")
    return Table(caption, columns, rows)


def _tabulate_friction(answer: dict) -> Table:
    rows = []
    for push in answer["pushes"]:
        F_p, d = push["peak_force_N"], push["sliding_distance_m"]
        row = [
            push["name"],
            _format_estimate(F_p),
            _format_estimate(d and {k: to_um(x) for k, x in d.items()}),
        ]
        row += [_format_estimate(push[way]) for way in _WAYS]
        rows.append([*row, format_number(1e3 * push["answered_after_s"], 3)])
    columns = (
        "push",
        "F_p [N]",
        "d [µm]",
        "mu_s from force",
        "from distance",
        "by equation (7)",
        "optimal",
        "known after [ms]",
    )
    return Table("mu_s of each push, as soon as it had ended", columns, rows)


def _format_estimate(estimate: Mapping | None) -> str:
    value, error = format_pair(*(estimate or {"value": None, "standard_error": None}).values())
    return value if error == "–" else f"{value} ± {error}"
