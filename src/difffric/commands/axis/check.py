"""`difffric check` of an axis: what a fit would be given, as result.json has it, and the page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from difffric.axis.fit import choose_free, fit_axis
from difffric.axis.recordings import AxisRecordings, AxisStretch
from difffric.axis.result import AxisFit
from difffric.axis.setup import BREAKAWAY, AxisSetup
from difffric.commands.axis import figures
from difffric.commands.reports.page import Picture, Report, Section, Table
from difffric.name_text import shorten_name
from difffric.number_text import format_number
from difffric.units import to_mm, to_um

_NAME = 40
"""Letters of a name that a table has room for."""
_MOST_ROWS = 40
"""Stretches that a table has room for."""


@dataclass(frozen=True)
class ExaminedStretch:
    """A stretch as a fit is given it."""

    stretch: AxisStretch
    runs: tuple[int, int]
    """forwards, backwards"""
    used: float
    """share of its samples that lie in runs"""
    top_speed: float
    """[m/s] in its runs; 0 where it has none"""

    def as_dict(self) -> dict:
        """Return what `result.json` holds of it."""
        one = self.stretch
        return {
            "stretch": one.name,
            "condition": one.condition,
            "samples": len(one),
            "duration_s": float(one.time[-1] - one.time[0]),
            "runs": {"forwards": self.runs[0], "backwards": self.runs[1]},
            "share_in_runs": self.used,
            "travel_m": float(np.ptp(one.position)),
            "top_speed_m_per_s": self.top_speed,
            "largest_force_N": float(np.abs(one.force).max()),
        }


@dataclass(frozen=True)
class ExaminedRecording:
    """A recording as a fit is given it, and a first look at what it says."""

    recording: AxisRecordings
    """as it was read"""
    stretches: tuple[ExaminedStretch, ...]
    first: AxisFit
    """the look: its values are shown beside the set-up's, its errors are those to expect"""
    free: tuple[str, ...]
    """what a fit varies unless it is left open"""

    @property
    def rate(self) -> float:
        """Samples a second."""
        steps = np.concatenate([np.diff(x.stretch.time) for x in self.stretches])
        return 1.0 / float(np.median(steps))


def examine_recording(setup: AxisSetup, data: AxisRecordings) -> ExaminedRecording:
    """Cut a recording as a fit does, and look at what it determines.

    Raises `InputError` where it cannot be used.
    """
    first = fit_axis(setup, data)
    seen = []
    for k, stretch in enumerate(first.data.stretches):
        own = [run for run in first.runs if run.run.stretch == k]
        used = sum(run.run.last - run.run.first for run in own) / len(stretch)
        top = max((float(np.abs(run.point.speed).max()) for run in own), default=0.0)
        ways = (sum(run.run.sign > 0 for run in own), sum(run.run.sign < 0 for run in own))
        seen.append(ExaminedStretch(stretch, ways, used, top))
    said = setup.extras.get(BREAKAWAY)
    free = (*choose_free(setup, None), BREAKAWAY)
    free = free[:-1] if said is not None and said.free is False else tuple(dict.fromkeys(free))
    return ExaminedRecording(data, tuple(seen), first, free)


def describe_check(found: ExaminedRecording) -> dict:
    """Return what was found as result.json holds it."""
    first = found.first
    return {
        "kind": "axis",
        "stretches": [x.as_dict() for x in found.stretches],
        "stretches_are_given": found.recording.are_given,
        "rate_Hz": found.rate,
        "drive_unit": found.recording.unit,
        "motion": "imposed" if first.imposed else "driven",
        "noise": first.as_dict()["noise"],
        "determines": {
            "standard_errors": {x: first.standard_error(x) for x in found.free},
            "first_look": {x: _look(found, x) for x in found.free},
            "not_identifiable": [dict(x) for x in first.not_identifiable],
        },
        "notes": list(first.notes),
    }


def report_check(setup: AxisSetup, found: ExaminedRecording, pictures: bool) -> Report:
    """Return the page: what the data are, what they can determine, and each stretch."""
    drawn = []
    if pictures:
        caption = (
            "The recording as it was read. Coloured: runs, in which the axis moves one way, which "
            "a fit takes; grey: rests and turns, which it passes over but for the force that ends "
            "a rest."
        )
        drawn.append(Picture("traces", caption, figures.draw_traces(found.first)))
        caption = (
            "Friction over speed at first sight: what the drive gave less the force of inertia. "
            "Friction that is not a straight line each way is what diagnose looks for."
        )
        drawn.append(Picture("friction", caption, figures.draw_friction(found.first)))
    first = found.first
    text = [
        "The standard errors that a fit of this recording is to be expected to reach, by the noise "
        "that is in it. The first look needs no start, and is a fit without its checks.",
        *(f"{', '.join(x['parameters'])}: {x['reason']}; {x['next_stretch']} would settle it."
          for x in first.not_identifiable),
    ]  # fmt: skip
    return Report(
        "What would be fitted",
        _summarise(setup, found),
        [
            Section("What these data can determine", text, [_tabulate_errors(setup, found)]),
            Section("The recording", (), [_tabulate_stretches(found)], drawn),
        ],
    )


def _summarise(setup: AxisSetup, found: ExaminedRecording) -> list[str]:
    first, data = found.first, found.recording
    every = [x.stretch for x in found.stretches]
    duration = sum(float(x.time[-1] - x.time[0]) for x in every)
    position = np.concatenate([x.position for x in every])
    cut = "as the file says" if data.are_given else "cut at rests and turns"
    forwards, backwards = (sum(x.runs[i] for x in found.stretches) for i in (0, 1))
    lowest, highest = (f(x.top_speed for x in found.stretches if x.top_speed) for f in (min, max))
    names = [shorten_name(c, _NAME) for c in dict.fromkeys(x.condition for x in every) if c]
    of = f", conditions {', '.join(names)}" if names else ""
    speeds = format_number(highest, 3)
    if highest > 1.01 * lowest:
        speeds = f"from {format_number(lowest, 3)} to {speeds}"
    lines = [
        f"{len(every)} stretches ({cut}), {sum(map(len, every))} samples at {found.rate:.5g} Hz "
        f"over {duration:.4g} s{of}.",
        f"{forwards} runs forwards and {backwards} backwards, top speed {speeds} m/s, over "
        f"{to_mm(float(np.ptp(position))):.4g} mm.",
        _describe_drive(setup, found),
        _describe_encoder(setup, found),
    ]
    if first.imposed:
        lines.append("The motion is imposed: the force is what answers, and is fitted as it is.")
    if first.breakaway is not None:
        lines.append(f"{first.breakaway.events} ends of rests tell the break-away force.")
    elif not first.imposed:
        lines.append("Nothing tells the break-away force: no rest ends with a growing force.")
    left = [one["parameters"][0] for one in first.not_identifiable]
    lines.append(
        f"Not determined by these data: {', '.join(dict.fromkeys(left))}."
        if left
        else "Every parameter that a fit frees by default can be determined."
    )
    return [*lines, *(f"Note: {note}." for note in first.notes)]


def _describe_drive(setup: AxisSetup, found: ExaminedRecording) -> str:
    force = np.concatenate([x.stretch.force for x in found.stretches])
    span = f"from {force.min():.4g} to {force.max():.4g} N"
    if setup.gain is not None and found.recording.unit == "V":
        return f"The drive gives {span}, with {setup.gain:.6g} N/V of the set-up."
    return f"The drive gives {span}."


def _describe_encoder(setup: AxisSetup, found: ExaminedRecording) -> str:
    steps = [_find_step(x.stretch.position) for x in found.stretches]
    known = [x for x in steps if x is not None]
    text = ""
    if known:
        step = to_um(min(known))
        text = f", read in steps of {step:.3g} µm"
        if setup.resolution is not None and not 0.5 < step / to_um(setup.resolution) < 2:
            text += f" (the set-up says {to_um(setup.resolution):.3g} µm)"
    if found.first.imposed:
        return f"The encoder{text or ' has no steps that show'}."
    noise = found.first.noise
    level = format_number(to_um(noise.encoder), 3, "µm")
    return (
        f"The encoder's noise is {level} a sample{text}; forces that nothing explains are of "
        f"{format_number(noise.force, 3)} N (rms)."
    )


def _find_step(position: np.ndarray) -> float | None:
    """The step that positions are read in [m]; None where they are as good as continuous."""
    values = np.unique(position)
    gaps = np.diff(values)
    if len(gaps) < 3 or len(values) > 0.9 * len(position):
        return None
    step = float(np.median(gaps[gaps < 1.5 * np.quantile(gaps, 0.2)]))
    return step if np.mean(np.abs(gaps / step - np.round(gaps / step)) < 0.1) > 0.9 else None


def _look(found: ExaminedRecording, name: str) -> float | None:
    """The value at first sight; None where the data do not tell it."""
    error = found.first.standard_error(name)
    return None if error is None else found.first.value(name)


def _tabulate_errors(setup: AxisSetup, found: ExaminedRecording) -> Table:
    rows = []
    for name in found.free:
        error, look = found.first.standard_error(name), _look(found, name)
        own = setup.values[name]
        said = "not determined" if error is None else format_number(error, 3)
        share = f"{100 * error / abs(look):.2g} %" if error and look else "–"
        own_text = "–" if name == BREAKAWAY and setup.breakaway is None else format_number(own, 4)
        rows.append([name, own_text, format_number(look, 4), said, share])
    columns = ("parameter", "set-up's value", "first look", "± expected", "share")
    return Table("What a fit would tell", columns, rows)


def _tabulate_stretches(found: ExaminedRecording) -> Table:
    rows = []
    for x in found.stretches[:_MOST_ROWS]:
        one = x.as_dict()
        rows.append([
            shorten_name(one["stretch"], _NAME), shorten_name(one["condition"] or "–", _NAME),
            f"{one['samples']}", f"{one['duration_s']:.4g}", f"{x.runs[0]} / {x.runs[1]}",
            f"{100 * x.used:.0f} %", f"{to_mm(one['travel_m']):.4g}",
            f"{1e3 * x.top_speed:.4g}" if x.top_speed else "–", f"{one['largest_force_N']:.4g}",
        ])  # fmt: skip
    left = len(found.stretches) - len(rows)
    more = f" (the first {len(rows)} of {len(found.stretches)})" if left else ""
    columns = ("stretch", "condition", "samples", "s", "runs → / ←", "used", "travel [mm]",
               "top [mm/s]", "force [N]")  # fmt: skip
    return Table(f"Stretches{more}", columns, rows)
