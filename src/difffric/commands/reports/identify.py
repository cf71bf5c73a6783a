"""`difffric identify`: mu_s of each push as result.json holds it, and the report."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from difffric.commands import figures
from difffric.commands.reports.page import NO_STROKE, Picture, Report, Section, Table
from difffric.identification.estimates import NONE, WAYS, Estimate, Identified
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.name_text import shorten_name
from difffric.number_text import format_number, format_pair
from difffric.rig.rig import Rig
from difffric.simulation.events import word_reason
from difffric.units import to_mm_min

_APART = 3.0
"""Standard errors between force and distance that chance does not give a push."""
_NAME = 40
"""Letters of a name that a table has room for; result.json has it whole."""


def summarise_conditions(found: Identified) -> dict[str, dict]:
    """Condition -> mean of its pushes' best mu_s, its standard error, and their spread.

    The spread s is the relative sample standard deviation: scatter and noise together. The mean
    weighs each push by 1 / (error^2 + (s mean)^2). Its standard error has two parts, added as
    squares: how the pushes differ, and the error of the calibration, which they share and which
    no number of pushes makes smaller (also by itself, `calibration_standard_error`).
    """
    out = {}
    for condition in dict.fromkeys(p.condition for p in found):
        best = [p.best for p in found if p.condition == condition and p.best.value is not None]
        out[condition] = {"pushes": len(best), **_combine(best)}
    return out


def _combine(best: list[Estimate]) -> dict:
    if len(best) < 2:
        one = best[0] if best else NONE
        return {
            "mean": one.value,
            "standard_error": one.standard_error,
            "calibration_standard_error": _measure_norm(one.shared) if best else None,
            "spread": None,
        }
    value = np.array([x.value for x in best], float)
    error = np.array([x.standard_error or 0.0 for x in best])
    n, spread = len(value), float(np.std(value, ddof=1))
    variance = error**2 + spread**2
    w = 1.0 / variance if spread > 0 else np.ones(n)
    w /= w.sum()
    mean = float(w @ value)
    between = float(np.sqrt(w**2 @ (value - mean) ** 2 * n / (n - 1)))
    shared = np.zeros(max(len(x.shared) for x in best))
    for one, weight in zip(best, w, strict=True):
        shared[: len(one.shared)] += weight * np.array(one.shared)
    calibration = _measure_norm(shared)
    return {
        "mean": mean,
        "standard_error": math.hypot(between, calibration),
        "calibration_standard_error": calibration,
        "spread": spread / mean,
    }


def _measure_norm(shared) -> float:
    return float(np.linalg.norm(shared))


def describe_friction(found: Identified, rig: Rig) -> dict:
    """mu_s of all pushes, as `difffric identify` writes it."""
    return {
        **found.as_dict(),
        "conditions": summarise_conditions(found),
        "stroke": NO_STROKE if rig.pusher.stroke is None else None,
    }


def _find_places(found: Identified, data: Pushes | Recordings) -> tuple[NDArray, NDArray]:
    """(n,) speeds [m/s], of free slides at their release, and the order of the pushes."""
    n = len(found)
    velocity, order = np.array([p.velocity for p in found]), np.arange(1.0, n + 1)
    if len(data) != n:  # some were skipped
        return velocity, order
    said = data.order if isinstance(data, Pushes) else np.array([r.order for r in data])
    if isinstance(data, Pushes) and data.free_slides:
        velocity = data.release_velocity
    return velocity, order if np.isnan(said).any() else said


def report_friction(
    found: Identified, answer: dict, data: Pushes | Recordings, pictures: bool
) -> Report:
    """mu_s of all pushes for a person."""
    velocity, order = _find_places(found, data)
    drawn = []
    if pictures:
        drawn = [
            Picture(
                "mu_s_ways",
                "mu_s of each push, a panel for each way to find it, with bars of one standard "
                "error. The dotted line is the mean of the best estimates; a cross marks a "
                "recording that the model does not follow.",
                figures.identify.draw_identified(found, velocity),
            ),
            Picture(
                "mu_s",
                "The best estimate of each push. The band is the mean of its condition ± the "
                "spread of its pushes.",
                figures.identify.draw_best_estimates(found, order, answer["conditions"]),
            ),
        ]
    text = (
        "Each push has one best estimate of mu_s. It comes from the whole recording where there is "
        "one that the model follows, else from the optimal combination of force and distance, else "
        "from the free slide. Where the model does not follow a recording, the table shows its "
        "reduced chi-square, which is 1 where it does.",
        "The standard error of a push contains that of the calibration. The standard error of a "
        "condition's mean comes from how its pushes differ, and from the calibration's error, "
        "which they share.",
    )
    sections = [
        Section(
            "Pushes", text, [_tabulate_pushes(found, velocity), _tabulate_conditions(answer)], drawn
        )
    ]
    if found.skipped:
        rows = [[line] for line in found.skipped]
        sections.append(
            Section("Skipped", (), [Table("What was left out, and why", ("what",), rows)])
        )
    return Report("Identified friction", _summarise(found, answer), sections, _advise(found))


def _summarise(found: Identified, answer: dict) -> list[str]:
    known = sum(p.best.value is not None for p in found)
    lines = [f"Each of the {known} pushes gives mu_s."]
    if known < len(found):
        lines = [f"{known} of {len(found)} pushes give mu_s; the table says why the others do not."]
    for condition, of in answer["conditions"].items():
        value, error = format_pair(of["mean"], of["standard_error"])
        spread = "" if of["spread"] is None else f", spread {100 * of['spread']:.2g} %"
        name = f"{shorten_name(condition, _NAME)}: " if condition else ""
        lines.append(f"{name}mu_s = {value} ± {error} ({of['pushes']} pushes{spread})")
    if answer["stroke"] and any(not np.isnan(p.velocity) for p in found):
        lines.append(answer["stroke"])
    lines += [f"Note: {note}." for note in found.notes]
    if found.skipped:
        lines.append(f"Skipped: {len(found.skipped)} of the data; the last table says why.")
    return lines


def _advise(found: Identified) -> list[str]:
    """Return what to do next with identified pushes."""
    apart = [p for p in found if p.disagreement is not None and abs(p.disagreement) > _APART]
    misfits = sum(p.misfits for p in found)
    lines = []
    if misfits or 3 * len(apart) > len(found):
        why = (
            f"the model does not follow {misfits} of the recordings"
            if misfits
            else f"force and distance of {len(apart)} pushes contradict each other"
        )
        lines.append(f"Run difffric diagnose on these data: {why}.")
    if any(p.best.value is None for p in found):
        lines.append(
            "See in the last column of the table why a push gives no mu_s, and repeat it otherwise."
        )
    if not lines:
        lines.append(
            "Use the mean of each condition. difffric monitor watches whether it stays, difffric "
            "plan finds the push that brings a part to its target."
        )
    return lines


def _tabulate_pushes(found: Identified, velocity: NDArray) -> Table:
    ways = [way for way in WAYS if np.isfinite(found.values(way)).any()]
    both = any(p.disagreement is not None for p in found)
    bad = any(p.misfits for p in found)
    rows = []
    for i, p in enumerate(found):
        row = [
            shorten_name(p.name, _NAME) or str(i + 1),
            format_number(to_mm_min(velocity[i]), 5),
            shorten_name(p.condition, _NAME) or "–",
        ]
        for way in ways:
            one = getattr(p, way)
            value, error = format_pair(one.value, one.standard_error)
            row.append(value if error == "–" else f"{value} ± {error}")
        if bad:
            row.append(format_number(p.trace_reduced_chi2, 3))
        if both:
            row.append(format_number(p.disagreement, 2))
        words = [word_reason(p.reason or "")]
        if p.alternatives:
            others = [x for x in p.alternatives if x != p.mu_s_distance.value]
            other = ", ".join(format_number(x, 3) for x in others)
            words.append(f"the same d follows from mu_s = {other}, too")
        rows.append([*row, "; ".join(x for x in words if x)])
    measures = ["reduced chi²"] * bad + ["force − distance [σ]"] * both
    columns = ["push", "speed [mm/min]", "condition", *(WAYS[way] for way in ways)]
    columns += [*measures, "remark"]
    return Table(f"mu_s of each push{_name_best(found)}", columns, rows)


def _name_best(found: Identified) -> str:
    """Say which column holds the best estimate, and of how many pushes where they differ."""
    ways = [WAYS[p.best_way] for p in found if p.best_way is not None]
    if not ways:
        return ""
    if len(set(ways)) == 1:
        return f"; the best estimate: {ways[0]}"
    said = [f"{way} ({ways.count(way)} pushes)" for way in dict.fromkeys(ways)]
    return f"; the best estimates: {', '.join(said)}"


def _tabulate_conditions(answer: dict) -> Table:
    rows = []
    for condition, of in answer["conditions"].items():
        value, error = format_pair(of["mean"], of["standard_error"])
        spread = None if of["spread"] is None else 100 * of["spread"]
        name = shorten_name(condition, _NAME) or "all"
        rows.append([name, str(of["pushes"]), value, error, format_number(spread, 3)])
    columns = ("condition", "pushes", "mean mu_s", "standard error", "spread [%]")
    return Table("The weighted mean of the best estimates of each condition", columns, rows)
