"""The answer and report of `difffric fit`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.data_comparison import (
    PushComparison,
    compare_pushes,
    compare_trace,
)
from difffric.calibration.optimal_push import NextPush, next_push
from difffric.calibration.profiles import Profile
from difffric.calibration.profiles import profile as profiled
from difffric.calibration.result import Fit
from difffric.commands import figures
from difffric.commands.reports.fit_summary import advise, describe_next, list_open, summarise_fit
from difffric.commands.reports.page import Picture, Report, Section, Table
from difffric.errors import InputError
from difffric.number_text import format_number, format_pair
from difffric.progress import Tell, silent
from difffric.units import to_mm_min, to_um

SHOWN = 4
"""Recordings whose traces are drawn."""


@dataclass(frozen=True)
class Answer:
    """A calibration with what its report shows beside it."""

    fit: Fit
    beside: PushComparison
    order: NDArray
    """(n,) place in the order of the pushes"""
    names: tuple[str, ...]
    """of the file's groups, empty for a table"""
    profiles: Mapping[str, Profile] = field(default_factory=dict)
    next_push: NextPush | None = None
    no_next_push: str | None = None
    """why there is none, where it was asked for"""

    @classmethod
    def of(cls, fit: Fit) -> Answer:
        """Set a fit beside the pushes that it was fitted to."""
        return cls(
            fit, compare_pushes(fit, fit.pushes), fill_order(fit.pushes.order), fit.push_names
        )

    def as_dict(self) -> dict:
        """Return what result.json holds: what the fit gives, and more of each push."""
        answer, b = self.fit.as_dict(), self.beside
        chi2 = self.fit.chi2_per_sample
        speed = "release_velocity_m_per_s" if self.fit.kind == "slides" else "velocity_m_per_s"
        answer["pushes"] = [
            {
                "name": self.names[i] if self.names else None,
                "order": self.order[i],
                speed: b.velocity[i],
                **push,
                "measured_peak_force_N": b.measured[0, i],
                "measured_peak_force_se_N": b.standard_error[0, i],
                "measured_sliding_distance_m": b.measured[1, i],
                "measured_sliding_distance_se_m": b.standard_error[1, i],
                "residual_peak_force_sigma": b.residual[0, i],
                "residual_sliding_distance_sigma": b.residual[1, i],
                "trace_reduced_chi2": None if chi2 is None else chi2[i],
            }
            for i, push in enumerate(answer["pushes"])
        ]
        answer["profiles"] = {x: p.as_dict() for x, p in self.profiles.items()} or None
        answer["next_push"] = None if self.next_push is None else self.next_push.as_dict()
        return answer


def add_more(answer: Answer, profile: bool, push: bool, tell: Tell = silent) -> Answer:
    """Return the answer with profiles and with the next push to make, where asked for."""
    if profile:
        answer = replace(answer, profiles=profiled(answer.fit, tell=tell))
    if push:
        tell("looking for the next push", 0.9)
        try:
            answer = replace(answer, next_push=next_push(answer.fit))
        except InputError as error:
            answer = replace(answer, no_next_push=str(error))
    return answer


def fill_order(order: NDArray) -> NDArray:
    """Return the order (n,) that the data say, or as they stand where it lacks for any push."""
    return np.arange(1.0, len(order) + 1) if np.isnan(order).any() else order


def report_fit(answer: Answer, pictures: bool) -> Report:
    """Return the report of a calibration; with figures where there are to be pictures."""
    fit = answer.fit
    sections = [
        Section(
            "Parameters",
            (
                "The standard errors come from the noise, as it is known or estimated, and from "
                "the scatter of mu_s. Those of the last column alone are multiplied by the root of "
                "the reduced chi-square: they hold if the noise is as large as the residuals.",
            ),
            [_tabulate_parameters(fit), *_tabulate_open(fit), *_tabulate_correlations(fit)],
            _draw_correlations(fit) if pictures else (),
        )
    ]
    if answer.profiles:
        sections.append(_report_profiles(answer, pictures))
    sections.append(
        Section(
            "Pushes",
            (_describe_residuals(fit),),
            [_tabulate_pushes(answer)],
            _draw_pushes(answer) if pictures else (),
        )
    )
    if fit.noise:
        sections.append(
            Section(
                "Noise", ("The noise was estimated where nothing moves.",), [_tabulate_noise(fit)]
            )
        )
    if answer.next_push is not None or answer.no_next_push:
        sections.append(_report_next(answer))
    if fit.skipped:
        rows = [[line] for line in fit.skipped]
        sections.append(
            Section("Skipped", (), [Table("What was left out, and why", ("what",), rows)])
        )
    return Report(
        "Calibration",
        summarise_fit(fit),
        sections,
        advise(fit, answer.next_push, answer.no_next_push),
    )


def _tabulate_parameters(fit: Fit) -> Table:
    rows, left_open = [], list_open(fit)
    for label in fit.free:
        value, error = fit.value(label), fit.standard_error(label)
        shown, se = format_pair(value, error)
        interval, scaled = fit.interval(label), fit.standard_error(label, scaled=True)
        relative = _format_percent(error, value)
        ends = "–"
        if interval is not None:
            ends = " … ".join(format_pair(x, error)[0] for x in interval)
        if label in left_open:
            rows.append([label, shown, "not determined", "–", "–", "–"])
            continue
        rows.append(
            [label, shown, se if error else "at bound", relative, ends, format_number(scaled, 3)]
        )
    columns = (
        "parameter [SI]", "value", "standard error", "error [%]", "95 % interval",
        "error × √(reduced χ²)",
    )  # fmt: skip
    spreads = [
        ("mu_s_scatter", fit.scatter, fit.scatter_se),
        ("spread of F_p [N]", fit.spread_force, math.nan),
        ("spread of d [µm]", to_um(fit.spread_distance), math.nan),
    ]
    for name, value, error in spreads:
        if math.isfinite(value) and (name != "mu_s_scatter" or "mu_s" in fit.names):
            rows.append([name, *format_pair(value, error), _format_percent(error, value), "–", "–"])
    return Table("Parameters", columns, rows)


def _format_percent(error, value) -> str:
    if not error or not value or not math.isfinite(error):
        return "–"
    share = 100 * error / abs(value)
    return f"{share:.0f}" if share >= 10 else f"{share:.2g}"


def _tabulate_open(fit: Fit) -> list[Table]:
    rows = [[", ".join(x["parameters"]), x["reason"]] for x in fit.not_identifiable]
    return [Table("Not determined by these data", ("parameter", "why"), rows)] if rows else []


def _tabulate_correlations(fit: Fit) -> list[Table]:
    correlation = fit.correlation
    pairs = [
        (a, b, float(correlation[i, j]))
        for i, a in enumerate(fit.free)
        for j, b in enumerate(fit.free)
        if j > i and abs(correlation[i, j]) > 0.1
    ]
    rows = [[a, b, f"{c:+.3f}"] for a, b, c in sorted(pairs, key=lambda x: -abs(x[2]))]
    return (
        [Table("Correlations above 0.1", ("parameter", "and", "correlation"), rows)] if rows else []
    )


def _describe_residuals(fit: Fit) -> str:
    if fit.kind == "recordings":
        return (
            "A residual is what was measured less what the model gives, in standard errors. Here "
            "F_p and d are those that the recording shows without a model, and the model has the "
            "push's own mu_s, found from all of its samples. “Squared residual” is the mean over "
            "the push's samples in units of the noise: 1 is perfect."
        )
    return (
        "A residual is what was measured less what the model gives with the mean mu_s, in standard "
        "deviations of the noise and the scatter together. The columns of the model have the "
        "push's own mu_s."
    )


def _tabulate_pushes(answer: Answer) -> Table:
    fit, b = answer.fit, answer.beside
    chi2 = fit.chi2_per_sample
    rows = []
    for i, condition in enumerate(fit.conditions):
        row = [
            answer.names[i] if answer.names else f"{answer.order[i]:g}",
            format_number(to_mm_min(b.velocity[i]), 5),
            condition or "–",
            " ± ".join(format_pair(fit.mu_s[i], fit.mu_s_se[i])),
        ]
        if fit.kind != "slides":
            row += [
                format_number(b.measured[0, i], 5),
                format_number(b.model[0, i], 5),
                f"{b.residual[0, i]:+.1f}" if np.isfinite(b.residual[0, i]) else "–",
            ]
        row += [
            format_number(to_um(b.measured[1, i]), 6),
            format_number(to_um(b.model[1, i]), 6),
            f"{b.residual[1, i]:+.1f}" if np.isfinite(b.residual[1, i]) else "–",
        ]
        if chi2 is not None:
            row.append(f"{chi2[i]:.3f}")
        if np.any(fit.start):
            row.append(f"{1e6 * fit.start[i]:+.2f}")
        rows.append(row)
    columns = ["push", "speed [mm/min]", "condition", "own mu_s"]
    columns += [] if fit.kind == "slides" else ["F_p [N]", "model F_p [N]", "residual of F_p [σ]"]
    columns += ["d [µm]", "model d [µm]", "residual of d [σ]"]
    columns += [] if chi2 is None else ["squared residual (1: noise)"]
    columns += ["start [µs]"] if np.any(fit.start) else []
    return Table("Each push", columns, rows)


def _tabulate_noise(fit: Fit) -> Table:
    units = {"force": (1.0, "N"), "position": (to_um(1.0), "µm")}
    rows = []
    for name, noise in fit.noise.items():
        scale, unit = units.get(name, (1.0, ""))
        level = format_number(scale * noise["standard_deviation"], 4, unit)
        rows.append([name, level, f"{noise['correlation']:.3f}"])
    columns = ("channel", "standard deviation", "correlation of neighbours")
    return Table("Noise of a sample", columns, rows)


def _draw_correlations(fit: Fit) -> list[Picture]:
    if len(fit.free) < 3:
        return []
    caption = (
        "How the errors of the free parameters go together: 1 or −1 means that the data tell only "
        "a combination of two."
    )
    return [Picture("correlations", caption, figures.fit.draw_correlations(fit))]


def _draw_pushes(answer: Answer) -> list[Picture]:
    fit = answer.fit
    found = [
        Picture(
            "pushes",
            "F_p and d over speed: what was measured, with bars of one standard error, and the "
            "calibrated model, whose shaded band is the scatter of mu_s. The residuals below "
            "should mostly lie in the shaded band of ±2.",
            figures.fit.draw_pushes(fit, answer.beside),
        )
    ]
    if "mu_s" in fit.names:
        caption = (
            "Each push's own mu_s with a bar of one standard error; the band is the mean ± the "
            "scatter."
        )
        found.append(Picture("mu_s", caption, figures.fit.draw_own_friction(fit, answer.order)))
    if fit.kind == "recordings":
        shown = {}
        for i in _choose_typical(answer.beside.velocity):
            v = to_mm_min(answer.beside.velocity[i])
            title = f"{answer.names[i] or f'push {i + 1}'}: {v:g} mm/min {fit.conditions[i]}"
            shown[title.rstrip()] = compare_trace(fit, i)
        caption = (
            "Recordings and the calibrated model; below each the residuals, freed of the noise's "
            "colour, which should mostly lie in the shaded band of ±2."
        )
        found.append(Picture("traces", caption, figures.fit.draw_traces(shown)))
    return found


def _choose_typical(velocity: NDArray) -> list[int]:
    """Return the places of up to `SHOWN` pushes, spread from the slowest to the fastest."""
    order = np.argsort(velocity, kind="stable")
    places = np.linspace(0, len(order) - 1, min(SHOWN, len(order))).round().astype(int)
    return [int(order[i]) for i in places]


def _report_profiles(answer: Answer, pictures: bool) -> Section:
    rows = []
    for label, one in answer.profiles.items():
        error = answer.fit.standard_error(label)
        row = [label, format_pair(one.value, error)[0]]
        for ends in one.intervals.values():
            row.append(" … ".join("open" if x is None else format_pair(x, error)[0] for x in ends))
        why = [f"{s}: {r}" for s, r in zip(("lower", "upper"), one.reasons, strict=True) if r]
        rows.append([*row, "; ".join([*why, *([one.note] if one.note else [])])])
    levels = next(iter(answer.profiles.values())).intervals
    columns = ("parameter [SI]", "value", *(f"{100 * x:g} %" for x in levels), "remark")
    text = (
        "For each interval one parameter is held at a value and all others are fitted anew. The "
        "interval ends where chi-square has risen by t², the square of Student's t of its level.",
    )
    drawn = []
    if pictures:
        caption = (
            "How chi-square rises where one parameter is held at another value. The dashed curve "
            "is what the standard error alone would say."
        )
        drawn.append(
            Picture("profiles", caption, figures.fit.draw_profiles(answer.fit, answer.profiles))
        )
    return Section("Profile-likelihood intervals", text, [Table("Intervals", columns, rows)], drawn)


def _report_next(answer: Answer) -> Section:
    best, text = answer.next_push, describe_next(answer.next_push, answer.no_next_push)
    if best is None:
        return Section("Next push", text)
    text += [f"Note: {note}." for note in best.notes]
    rows = [
        [x, format_number(se, 3), format_number(best.after[x], 3)] for x, se in best.before.items()
    ]
    table = Table(
        "Standard errors [SI], without and with the next push",
        ("parameter", "now", "with this push"),
        rows,
    )
    return Section("Next push", text, [table])
