"""`difffric check`: what measured pushes hold, as result.json has it, and the page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from difffric.commands import figures
from difffric.commands.reports.page import NO_STROKE, Picture, Report, Section, Table
from difffric.measurements.checks import check_data
from difffric.measurements.noise import Noise
from difffric.measurements.pushes import Pushes
from difffric.measurements.recorded_motion import describe_motion
from difffric.measurements.recordings import Recordings
from difffric.measurements.reduction.recorded_pusher import reduce_for
from difffric.measurements.reduction.reduce import Reduced
from difffric.name_text import shorten_name
from difffric.number_text import format_number, format_pair
from difffric.rig import parameters
from difffric.rig.setup import Setup, refuse_recorded_motion
from difffric.simulation.events import word_reason
from difffric.units import to_mm_min, to_um

if TYPE_CHECKING:
    from difffric.calibration.identifiability import Identifiability

_NAME = 40
"""Letters of a name that a table has room for."""


@dataclass(frozen=True)
class Examined:
    """Measured pushes as a fit would be given them; n of them can be used."""

    pushes: Pushes
    """(n) F_p and d, of recordings taken off their samples"""
    recordings: Recordings | None
    """(n) of recordings only"""
    details: tuple[Reduced, ...]
    """(n) of recordings only"""
    skipped: tuple[str, ...]


def examine(
    data: Pushes | Recordings, setup: Setup, *, use_data_mass: bool = False, skip_bad: bool = False
) -> Examined:
    """Hold the data against the set-up and reduce recordings to F_p and d.

    Raises `InputError` for pushes that cannot be used, unless `skip_bad`, and where none can.
    """
    either: Any = data  # one of two kinds, and stays so
    good: Pushes | Recordings = check_data(
        either, setup.rig, use_data_mass=use_data_mass, skip_bad=skip_bad
    )
    if isinstance(good, Pushes):
        refuse_recorded_motion(setup, good.no_pusher)
        return Examined(good, None, (), good.skipped)
    reduction = reduce_for(setup, good, skip_bad)
    recordings = reduction.recordings
    return Examined(reduction.pushes, recordings, reduction.details, recordings.skipped)


def describe_check(found: Examined, known: Identifiability) -> dict[str, Any]:
    """What was found as result.json holds it."""
    p = found.pushes
    rows = []
    for i in range(len(p)):
        row: dict[str, Any] = {
            "name": found.recordings[i].name if found.recordings else "",
            "velocity_m_per_s": float(_read_speeds(p)[i]),
            "condition": p.condition[i],
            "peak_force_N": float(p.peak_force[i]),
            "peak_force_standard_error_N": float(p.peak_force_se[i]),
            "sliding_distance_m": float(p.sliding_distance[i]),
            "sliding_distance_standard_error_m": float(p.sliding_distance_se[i]),
            "expected_peak_force_N": float(known.peak_force[i]),
            "expected_sliding_distance_m": float(known.sliding_distance[i]),
            "missing": _list_missing(found, i),
        }
        if found.details:
            one = found.details[i]
            row["peak_time_s"], row["release_time_s"] = one.peak_time, one.release_time
            row["rest_time_s"] = one.rest_time
        rows.append(row)
    return {
        "kind": "recordings" if found.recordings else "slides" if p.free_slides else "table",
        "pushes": rows,
        "noise": {key: _describe_noise(found, key) for key in ("force", "position")},
        "determines": known.as_dict(),
        "skipped": list(found.skipped),
    }


def report_check(found: Examined, known: Identifiability, setup: Setup, pictures: bool) -> Report:
    """The page: what the data are, what they can determine, and each push."""
    drawn = []
    if pictures:
        if found.recordings is not None:
            caption = (
                "Recordings from the slowest to the fastest, as they were read. The dotted lines "
                "are the peak of the force, the last loss of contact, and rest, found without a "
                "model."
            )
            drawn.append(
                Picture(
                    "traces",
                    caption,
                    figures.check.draw_recordings(found.recordings, found.details),
                )
            )
        caption = "What was measured; the crosses are what the set-up leads to before any fit."
        figure = figures.check.draw_measured(found.pushes, known)
        drawn.append(Picture("measured", caption, figure))
    sections = [
        Section(
            "What these data can determine",
            _explain(known, found.recordings is not None),
            [_tabulate_errors(known, setup)],
        ),
        Section("The pushes", (), [_tabulate_pushes(found, known)], drawn),
    ]
    if found.skipped:
        rows = [[line] for line in found.skipped]
        sections.append(
            Section("Skipped", (), [Table("What was left out, and why", ("what",), rows)])
        )
    return Report(
        "What would be fitted",
        _summarise(found, known, setup),
        sections,
        _advise(found, known, pictures),
    )


def _summarise(found: Examined, known: Identifiability, setup: Setup) -> list[str]:
    p, v = found.pushes, to_mm_min(_read_speeds(found.pushes))
    kind = "recordings" if found.recordings else "free slides" if p.free_slides else "pushes"
    speeds = len(set(np.round(v, 6)))
    names = [shorten_name(c, _NAME) for c in dict.fromkeys(p.condition) if c]
    of = f", conditions {', '.join(names)}" if names else ""
    lines = [f"{len(p)} {kind} at {speeds} speeds from {v.min():.5g} to {v.max():.5g} mm/min{of}."]
    for key, unit, scale in (("force", "N", 1.0), ("position", "µm", to_um(1.0))):
        noise = _find_noise(found, key)
        if noise is not None:
            channel = next(c for r in found.recordings or () if (c := getattr(r, key)) is not None)
            level = format_number(scale * noise.level, 3, unit)
            lines.append(
                f"The {key} is sampled at {1 / channel.dt:.6g} Hz; its noise is {level} a sample "
                f"(correlation of neighbours {noise.correlation:.2f})."
            )
    for name, what in (("peak_force", "F_p"), ("sliding_distance", "d")):
        missing = int(np.isnan(getattr(p, name)).sum())
        if missing and not (p.free_slides and name == "peak_force"):
            lines.append(f"{what} is missing in {missing} of {len(p)} {kind}.")
    lines += [f"{note[:1].upper()}{note[1:]}." for note in describe_motion(found.recordings or ())]
    open_ = [name for group in known.not_identifiable for name in group["parameters"]]
    if open_:
        lines.insert(0, f"Not determined by these data: {', '.join(open_)}.")
    else:
        lines.insert(0, "These data can determine every parameter that a fit frees by default.")
    if setup.rig.pusher.stroke is None and np.isnan(p.stroke).all() and not p.free_slides:
        lines.append(NO_STROKE)
    return [*lines, *(f"Note: {note}." for note in known.notes)]


def _advise(found: Examined, known: Identifiability, pictures: bool) -> list[str]:
    """Return what to do next with the data."""
    if not pictures:
        lines = ["Look at the table: are these the pushes that were made? --out DIR draws them."]
    elif found.recordings is None:
        lines = ["Look at the figure: are these the pushes that were made?"]
    else:
        lines = [
            "Look at the figures: are these the pushes that were made, and are the landmarks right?"
        ]
    if known.not_identifiable:
        lines.append(
            "Measure at other speeds, or hold what is not determined: difffric fit --free names "
            "what is free."
        )
    if found.skipped:
        lines.append("See below what was skipped, and mend the file where it should not have been.")
    return [*lines, "Then calibrate: difffric fit takes the same data and the same set-up."]


def _explain(known: Identifiability, recorded: bool) -> list[str]:
    text = [
        "These are the standard errors that a fit of these pushes can be expected to reach, with "
        "the parameters at the set-up's values. Nothing has been fitted yet."
    ]
    if recorded:
        text.append(
            "They are those of F_p and d alone. A fit of recordings takes every sample, and its "
            "errors are smaller."
        )
    text += [f"{', '.join(x['parameters'])}: {x['reason']}" for x in known.not_identifiable]
    return text


def _tabulate_errors(known: Identifiability, setup: Setup) -> Table:
    rows = []
    for label, error in known.standard_errors.items():
        name = label.partition("[")[0]
        value = float(parameters.values(setup.rig)[name])
        share = None if error is None or not value else 100 * error / abs(value)
        said = "not determined" if error is None else format_number(error, 3)
        rows.append([shorten_name(label, _NAME), format_number(value, 6), said, _percent(share)])
    columns = ("parameter [SI]", "value in the set-up", "expected error", "share of the value")
    return Table("How well a fit would know each parameter", columns, rows)


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{share:.2g} %"


def _tabulate_pushes(found: Examined, known: Identifiability) -> Table:
    p, v = found.pushes, to_mm_min(_read_speeds(found.pushes))
    rows = []
    for i in range(len(p)):
        name = shorten_name(found.recordings[i].name, _NAME) if found.recordings else str(i + 1)
        row = [name, format_number(v[i], 5), shorten_name(p.condition[i], _NAME) or "–"]
        forces, distances = (
            (p.peak_force[i], p.peak_force_se[i], known.peak_force[i]),
            (
                to_um(p.sliding_distance[i]),
                to_um(p.sliding_distance_se[i]),
                to_um(known.sliding_distance[i]),
            ),
        )
        for value, error, expected in [distances] if p.free_slides else [forces, distances]:
            number, plus = format_pair(float(value), float(error))
            row += [number if plus == "–" else f"{number} ± {plus}", format_number(expected, 4)]
        rows.append([*row, word_reason(_list_missing(found, i))])
    force = [] if p.free_slides else ["F_p [N]", "F_p by the set-up [N]"]
    columns = ["push", "speed [mm/min]", "condition", *force, "d [µm]", "d by the set-up [µm]"]
    columns.append("what is missing")
    return Table("What was measured, and what the set-up leads to", columns, rows)


def _list_missing(found: Examined, i: int) -> str:
    """Why something of a push is missing; empty where nothing is."""
    if found.details:
        return found.details[i].reason
    p = found.pushes
    said = [
        f"no {words}"
        for name, words in (("peak_force", "F_p"), ("sliding_distance", "d"))
        if np.isnan(getattr(p, name)[i]) and not (p.free_slides and name == "peak_force")
    ]
    return ", ".join(said)


def _find_noise(found: Examined, key: str) -> Noise | None:
    noises = [one for x in found.details if (one := getattr(x, f"noise_{key}")) is not None]
    return noises[0] if noises else None


def _describe_noise(found: Examined, key: str) -> dict[str, float] | None:
    noise = _find_noise(found, key)
    return None if noise is None else {"level": noise.level, "correlation": noise.correlation}


def _read_speeds(p: Pushes) -> NDArray:
    return p.release_velocity if p.free_slides else p.velocity
