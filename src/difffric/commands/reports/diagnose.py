"""The report of `difffric diagnose`; the answer is the diagnosis' own `as_dict`."""

from __future__ import annotations

from difffric.commands import figures
from difffric.commands.reports.page import Picture, Report, Section, Table
from difffric.diagnosis.misfit import describe_misfits
from difffric.diagnosis.verdict import ADEQUATE, AMBIGUOUS, NAMED, Cause, Diagnosis
from difffric.number_text import format_number
from difffric.units import to_mm, to_mm_min, to_um

_VERDICTS = {
    ADEQUATE: "The plain model is adequate: nothing that matters was found.",
    NAMED: "The cause is named.",
    AMBIGUOUS: "There is a cause, but these data cannot tell it from others.",
}
_UNEXPLAINED = "The misfit is real, and no effect of the catalogue explains it."


def _format_sizes(cause: Cause) -> str:
    return "; ".join(
        f"{name} = {format_number(value)} ± {format_number(error, 2)}"
        for name, (value, error) in cause.parameters.items()
    )


def _format_share(x: float) -> str:
    return f"{100 * x:.2g} %" if x > 1e-6 else "0"


def _list_cause(cause: Cause) -> list[str]:
    return [
        cause.id,
        cause.component,
        _format_sizes(cause),
        format_number(cause.probability, 3),
        ", ".join(cause.confusable_with) or "–",
        format_number(cause.chi2_drop),
        ", ".join(
            _format_share(x)
            for x in (cause.change_peak_force, cause.change_sliding_distance, cause.change_as_mu_s)
        ),
    ]


_COLUMNS = (
    "effect",
    "component",
    "size",
    "probability",
    "confusable with",
    "drop of χ²",
    "changes F_p, d, as mu_s",
)


def tabulate_considered(found: Diagnosis, gain: str = "gain held out") -> Table:
    """Return a table of the leading effects, each alone on top of the plain model."""
    rows = [
        [
            cause.id,
            cause.component,
            _format_sizes(cause),
            format_number(cause.chi2_drop),
            format_number(cause.heldout_gain, 3),
            format_number(cause.p_value, 2),
        ]
        for cause in found.considered
    ]
    columns = ("effect", "component", "size", "drop of -2 log L", gain, "p-value")
    return Table("The leading effects, each alone on top of the plain model", columns, rows)


def tabulate_experiments(found: Diagnosis) -> Table:
    """Return a table of the pushes that would tell more."""
    rows = [
        [
            " or ".join(x if x != "plain" else "nothing" for x in one.separates),
            format_number(to_mm_min(one.velocity_m_per_s)),
            format_number(one.mass_kg, 3),
            "–" if one.stroke_m is None else format_number(to_mm(one.stroke_m), 3),
            format_number(one.rest_before_s, 3),
            format_number(one.separation, 2),
        ]
        for one in found.experiments
    ]
    columns = (
        "tells",
        "v [mm/min]",
        "mass [kg]",
        "stroke [mm]",
        "rest before [s]",
        "apart by [s.d.]",
    )
    return Table("The push that would tell most", columns, rows)


def report_diagnosis(found: Diagnosis, pictures: bool) -> Report:
    """Return the report of a diagnosis; with figures where there are to be pictures."""
    g, left = found.gain, found.remaining
    summary = [] if left is None else [f"{str(left).capitalize()}."]
    summary.append(_VERDICTS.get(found.verdict, _UNEXPLAINED))
    summary += [f"{cause.id}: {cause.text}." for cause in found.causes]
    summary.append(
        f"Error on held-out pushes, in units of the noise: {format_number(g.before, 3)} before, "
        f"{format_number(g.after, 3)} after ({format_number(g.noise_floor, 3)} is perfect)."
    )
    if found.location:
        where = found.location
        summary.append(
            f"The misfit sits in: {where.component.replace('_', ' ')}. A curve over the "
            f"{where.quantity} explains {100 * where.explained[where.form]:.0f} % of it."
        )
    if found.causes:
        moved = format_number(100 * found.change_mu_s, 2)
        summary.append(f"The identified mu_s changes by {moved} % (rms over the pushes).")
    sections = []
    if found.causes:
        table = Table(
            "Causes, by how much they change F_p and d",
            _COLUMNS,
            [_list_cause(c) for c in found.causes],
        )
        sections.append(Section("Causes", tables=(table,)))
    if found.negligible:
        table = Table(
            "Detected, too small to matter", _COLUMNS, [_list_cause(c) for c in found.negligible]
        )
        sections.append(Section("Negligible", tables=(table,)))
    if found.considered:
        sections.append(Section("What was considered", tables=(tabulate_considered(found),)))
    if found.certificates:
        rows = [
            [
                str(x.push + 1),
                format_number(to_mm_min(x.velocity_m_per_s)),
                format_number(to_um(x.sliding_distance_m)),
                format_number(to_um(x.bound_m)),
            ]
            for x in found.certificates
        ]
        table = Table(
            "Distances that no k, b and k_v give",
            ("push", "v [mm/min]", "d [µm]", "at most [µm]"),
            rows,
        )
        sections.append(Section("Beyond the plain model", tables=(table,)))
    if pictures:
        recordings = found.used_recordings
        drawn = []
        if recordings:
            drawn.append(
                Picture(
                    "misfit",
                    "Where the plain model misses, push by push.",
                    figures.diagnose.draw_misfit(found),
                )
            )
        drawn.append(
            Picture(
                "where",
                "Squared residuals per number, in units of the noise, over what changes "
                "(red: plain, blue: with its causes).",
                figures.diagnose.draw_where(found),
            )
        )
        if recordings:
            drawn.append(
                Picture(
                    "residuals",
                    "Residuals of the pushes that the plain model fits worst "
                    "(red: plain, blue: with its causes).",
                    figures.diagnose.draw_residuals(found),
                )
            )
        if found.location:
            drawn.append(
                Picture(
                    "location",
                    "What each component would explain if it were free to bend, and "
                    "the correction of the one that explains most.",
                    figures.diagnose.draw_location(found.location),
                )
            )
        words = describe_misfits(found.misfit)
        sections.append(
            Section("Where the misfit sits", (words,) if words else (), pictures=tuple(drawn))
        )
    unseen = [x for x in found.not_visible if x not in found.impossible]
    reasons = [[name, why] for name, why in found.impossible.items()]
    reasons += [[name, "too small a trace in these pushes at its typical size"] for name in unseen]
    if found.experiments:
        sections.append(Section("What to push next", tables=(tabulate_experiments(found),)))
    if reasons:
        table = Table("Not to be seen in these data", ("effect", "why"), reasons)
        sections.append(Section("What these data cannot say", tables=(table,)))
    if found.notes:
        sections.append(Section("Notes", found.notes))
    return Report("Diagnosis", tuple(summary), tuple(sections))
