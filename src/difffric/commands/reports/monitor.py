"""The answer and report of `difffric monitor`, and the line that tells an alarm at once."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import NamedTuple

from difffric.commands import figures
from difffric.commands.layout.json_output import is_json_asked
from difffric.commands.reports.page import NO_STROKE, Picture, Report, Section, Table
from difffric.errors import InputError
from difffric.monitoring.alarms import Alarm
from difffric.monitoring.change_cause import ChangeCause, conclude
from difffric.monitoring.feed import Feed
from difffric.monitoring.monitor import Monitor
from difffric.monitoring.records import PushRecord
from difffric.monitoring.shiryaev_roberts import CHANNELS, DIRECTIONS
from difffric.number_text import format_number, format_pair
from difffric.units import to_mm_min

ALARM = 3
"""Exit status where there was an alarm in this run."""
_SHOWN = 20
"""Last pushes in the printed table: as many as a terminal shows at once."""


class ExplainedAlarm(NamedTuple):
    """An alarm with what may have changed."""

    alarm: Alarm
    causes: list[ChangeCause]
    parameter: str | None
    words: str


def explain_alarms(monitor: Monitor) -> list[ExplainedAlarm]:
    """Return all alarms with what may have changed, by all pushes that there are by now."""
    out = []
    for alarm in monitor.alarms:
        causes = alarm.causes(monitor.reader)
        out.append(ExplainedAlarm(alarm, causes, *conclude(causes)))
    return out


def find_new_alarms(feed: Feed) -> list[Alarm]:
    """Return the alarms of this run, without those that the state file knew before."""
    return [a for a in feed.monitor.alarms if a.push > feed.before]


def format_alarm(monitor: Monitor, alarm: Alarm, words: str) -> str:
    """Return the line that tells an alarm: where, what may have changed, and since when."""
    places = {x.number: x for x in monitor.kept}
    at, since = _format_place(places, alarm.push), _format_place(places, alarm.change)
    return f"ALARM at {at}: {words}; the change began at {since} ({alarm.kind})"


def make_teller(feed: Feed) -> Callable[[PushRecord], None]:
    """Return a function that prints the alarm of a push, if it has one; `Feed` calls it."""

    def tell_alarm(seen: PushRecord) -> None:
        if seen.alarm:
            alarm = feed.monitor.alarms[-1]
            words = conclude(alarm.causes(feed.monitor.reader))[1]
            where = sys.stderr if is_json_asked() else sys.stdout
            print(format_alarm(feed.monitor, alarm, words), flush=True, file=where)

    return tell_alarm


def _format_place(pushes: dict[int, PushRecord], which: int) -> str:
    seen = pushes.get(which)
    said = ", ".join(filter(None, [seen.source, seen.name])) if seen else ""
    return f"push {which}" + (f" ({said})" if said else "")


def describe_monitor(feed: Feed, alarms: list[ExplainedAlarm]) -> dict:
    """Return what was seen as result.json holds it.

    Raises `InputError` where there was no push at all.
    """
    monitor = feed.monitor
    if monitor.count == 0:
        raise InputError("no pushes: at least one is needed")
    return {
        "arl": monitor.arl,
        "threshold": math.exp(monitor.log_threshold),
        "counted": monitor.count,
        "counted_before": feed.before,
        "recognised": feed.seen_again,
        "identified": monitor.identified,
        "judged": monitor.judged,
        "alarms": [_describe_alarm(x, x.alarm.push > feed.before) for x in alarms],
        "parts": _describe_parts(monitor),
        "pushes": [_describe_push(x) for x in monitor.kept],
        "stroke": NO_STROKE if monitor.setup.rig.pusher.stroke is None else None,
        "notes": _list_notes(monitor),
        "skipped": feed.skipped,
    }


def _describe_alarm(x: ExplainedAlarm, new: bool) -> dict:
    return {
        "push": x.alarm.push,
        "new": new,
        "change_point": x.alarm.change,
        "kind": x.alarm.kind,
        "direction": x.alarm.direction,
        "pushes_since": len(x.alarm.after),
        "parameter": x.parameter,
        "text": x.words,
        "candidates": [c.as_dict() for c in x.causes],
    }


def _describe_push(x: PushRecord) -> dict:
    def pair_up(value, error):
        return None if value is None else {"value": value, "standard_error": error}

    def find_evidence(log):
        return None if log is None else math.exp(min(log, 700.0))

    return {
        "number": x.number,
        "source": x.source or None,
        "name": x.name or None,
        "order": x.order,
        "velocity_m_per_s": x.velocity,
        "condition": x.condition,
        "mass_kg": x.mass,
        "stroke_m": x.stroke,
        "peak_force_N": x.peak_force,
        "sliding_distance_m": x.sliding_distance,
        "mu_s": pair_up(x.mu_s, x.standard_error),
        "state": pair_up(x.state, x.state_se),
        "contrast": x.contrast,
        "z": dict(zip(CHANNELS, x.z, strict=True)),
        "evidence": find_evidence(x.log_evidence),
        "evidence_by": dict(zip(DIRECTIONS, map(find_evidence, x.log_evidence_by), strict=False)),
        "alarm": x.alarm,
        "reason": x.reason,
    }


def _describe_parts(monitor: Monitor) -> list[dict]:
    """Return the state of each part, with the mean of each speed since the last alarm."""
    out = []
    for key, (condition, mass) in monitor.parts.items():
        level = monitor.levels.get(key)
        if level is None:
            continue
        x, error = level.log_mu_s
        speeds = []
        for name, cell in monitor.cells.items():
            mean = monitor.friction.means.get(name)
            if cell.part != key or mean is None or mean.weight == 0:
                continue
            phi = monitor.friction.get_spread(name).phi
            speeds.append(
                {
                    "velocity_m_per_s": cell.velocity,
                    "stroke_m": cell.stroke,
                    "measured": cell.measured,
                    "mu_s": math.exp(mean.value),
                    "spread": None if phi is None else math.sqrt(phi) * monitor.scatter,
                }
            )
        out.append(
            {
                "condition": condition,
                "mass_kg": mass,
                "mu_s": {"value": math.exp(x), "standard_error": math.exp(x) * error},
                "speeds": speeds,
            }
        )
    return out


def _list_notes(monitor: Monitor) -> list[str]:
    notes = []
    lost = monitor.count - monitor.identified
    if lost:
        notes.append(f"{lost} of {monitor.count} pushes could not be identified.")
    row = 0
    for x in reversed(monitor.kept):
        if x.mu_s is not None:
            break
        row += 1
    if row >= 3 and monitor.identified:
        notes.append(f"None of the last {row} pushes could be identified: look at the machine.")
    first = monitor.identified - monitor.judged
    if first > 0.5 * monitor.identified and monitor.identified >= 10:
        notes.append(
            f"{first} of {monitor.identified} pushes were the first of their part and speed, and "
            "say nothing of a change: repeat the speeds, and let condition name parts, not pushes."
        )
    return notes


def report_monitor(
    feed: Feed, answer: dict, alarms: list[ExplainedAlarm], pictures: bool
) -> Report:
    """Return the report of a watched machine; with figures where there are to be pictures."""
    monitor = feed.monitor
    new = monitor.count - feed.before
    lines = [format_alarm(monitor, x.alarm, x.words) for x in alarms if x.alarm.push > feed.before]
    if not lines:
        lines = [f"There is no alarm in {new} pushes."]
    again = f", {feed.seen_again} recognised and not counted again" if feed.seen_again else ""
    lines.append(
        f"{new} new pushes, {monitor.count} in all{again}. While nothing changes, a false alarm "
        f"comes once in {monitor.arl:g} pushes in the mean."
    )
    lines += answer["notes"]
    if answer["stroke"]:
        lines.append(answer["stroke"])
    drawn = []
    if pictures:
        drawn.append(
            Picture(
                "monitor",
                "Above: mu_s of each push, and the state of its part at the part's first speed. "
                "Middle: what mu_s cannot explain, compared with the pushes before. Below: the "
                "evidence of a change. A line is an alarm, a dotted line an estimated change.",
                figures.monitor.draw_charts(monitor),
            )
        )
    text = (
        "Each push is compared with those before of the same part, speed and stroke. The state is "
        "the level of mu_s that the last ten pushes or so show; its standard error leaves out that "
        "of the calibration.",
    )
    causes = [_tabulate_causes(alarms)] if alarms else []
    tables = [_tabulate_last(answer)]
    lost = [x for x in answer["pushes"] if x["reason"]]
    if lost:
        rows = [[str(x["number"]), x["name"] or "–", x["reason"]] for x in lost[-_SHOWN:]]
        tables.append(Table("Pushes that give no mu_s", ("push", "name", "why"), rows))
    if feed.skipped:
        tables.append(Table("What was left out", ("what",), [[line] for line in feed.skipped]))
    sections = [
        Section("State", text, [_tabulate_states(answer), *causes], drawn),
        Section("Pushes", (), tables),
    ]
    return Report("Watched machine", lines, sections, _advise(feed))


def _advise(feed: Feed) -> list[str]:
    """Return what to do next with a watched machine."""
    if not find_new_alarms(feed):
        return ["Nothing has to be done. Give the next pushes to difffric monitor as they come."]
    return [
        "Look at the machine for what may have changed; the table names it with its probability.",
        "If the change is meant to stay, calibrate anew with difffric fit on pushes after it.",
    ]


def _tabulate_causes(alarms: list[ExplainedAlarm]) -> Table:
    rows = []
    for x in alarms:
        for c in x.causes:
            change, error = format_pair(100 * c.change, c.standard_error and 100 * c.standard_error)
            rows.append(
                [
                    str(x.alarm.push),
                    str(x.alarm.change),
                    c.words.rsplit(" ", 4)[0] if c.standard_error else c.words.rsplit(" ", 2)[0],
                    change if error == "–" else f"{change} ± {error}",
                    format_number(c.drop, 4),
                    format_number(c.probability, 2),
                    format_number(c.left, 2),
                ]
            )
    columns = (
        "alarm at push",
        "change at push",
        "what may have changed",
        "change [%]",
        "fall of chi²",
        "probability",
        "p-value of the rest",
    )
    return Table("What may have changed", columns, rows)


def _tabulate_states(answer: dict) -> Table:
    rows = []
    for part in answer["parts"]:
        value, error = format_pair(*part["mu_s"].values())
        speeds = ", ".join(f"{to_mm_min(s['velocity_m_per_s']):.4g}" for s in part["speeds"])
        rows.append(
            [
                part["condition"] or "–",
                format_number(part["mass_kg"]),
                f"{value} ± {error}",
                speeds or "–",
            ]
        )
    return Table(
        "The state of each part",
        ("part", "mass [kg]", "mu_s", "speeds since the last alarm [mm/min]"),
        rows,
    )


def _tabulate_last(answer: dict) -> Table:
    rows = []
    for x in answer["pushes"][-_SHOWN:]:
        z = x["z"]
        state = x["state"] or {"value": None}
        rows.append(
            [
                str(x["number"]) + (" ALARM" if x["alarm"] else ""),
                format_number(to_mm_min(x["velocity_m_per_s"])),
                x["condition"] or "–",
                format_number(x["mu_s"] and x["mu_s"]["value"]),
                format_number(state["value"]),
                format_number(z["friction"], 2),
                format_number(z["contrast"], 2),
                format_number(x["evidence"], 2),
            ]
        )
    columns = (
        "push",
        "speed [mm/min]",
        "part",
        "mu_s",
        "state",
        "change of mu_s [σ]",
        "change of contrast [σ]",
        "evidence",
    )
    return Table("The last pushes", columns, rows)
