"""`difffric paper`: the report of the paper's measurements."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from difffric.commands import figures
from difffric.commands.reports.diagnose import tabulate_considered
from difffric.commands.reports.page import NO_STROKE, Picture, Report, Section, Table
from difffric.number_text import format_number, format_with_error
from difffric.rig import parameters
from difffric.simulation.trajectory import simulate
from difffric.studies.paper import Paper, find_misprints
from difffric.units import to_mm, to_mm_min, to_um


def report_paper(paper: Paper) -> Report:
    """The paper's measurements for a person."""
    return Report(
        "The paper's measurements, by equation (2)",
        _summarise(paper),
        [
            Section(
                "mu_s of the 24 measurements",
                (
                    "Each speed is judged by a calibration that has not seen it. Errors are "
                    "against the gauge.",
                ),
                [_tabulate_errors(paper), _tabulate_rows(paper), _tabulate_weighted(paper)],
                [
                    Picture(
                        "identified",
                        "mu_s over speed, one standard error; crosses: the paper's own formulas.",
                        figures.paper.draw_identified(paper),
                    )
                ],
            ),
            Section(
                "What equation (2) gets wrong here",
                (
                    "A rebound at most doubles the speed, so that d <= 4 v² / (2 mu_k g) for any "
                    "k, b and k_v (at mu_k = 0.75 mu_s). The measured d at 500 and 1000 mm/min is "
                    "above it in both conditions alike: what DRY and OILY share points at the "
                    "rig, not at the friction. These four are left out of the calibration.",
                ),
                [_tabulate_misfit(paper)],
                [
                    Picture(
                        "residuals",
                        "Measured minus model over speed.",
                        figures.paper.draw_residuals(paper),
                    )
                ],
            ),
            Section(
                "Which cause",
                _describe_diagnosis(paper),
                [tabulate_considered(paper.diagnosis, "gain, speeds held out")],
            ),
            Section(
                "Calibration",
                (
                    "k, b and k_v at the gauge's mu_s; the spreads of F_p and d are estimated "
                    "from the residuals. " + NO_STROKE + " The last rows say how much a stroke "
                    "would change.",
                ),
                [_tabulate_calibration(paper)],
            ),
            Section("Misprints", (), [_tabulate_misprints()]),
            Section("The paper's figures", (), (), _draw_figures(paper)),
        ],
    )


def _describe_diagnosis(paper: Paper) -> tuple[str, ...]:
    found = paper.diagnosis
    asked = [found.causes[0].id, *found.causes[0].confusable_with] if found.causes else []
    out = [c.id for c in found.considered if c.id not in asked]
    g = found.gain
    return (
        f"Verdict: {found.verdict}. {len(found.certificates)} distances are beyond what equation "
        "(2) gives with any k, b and k_v, so that it misses something; 24 numbers whose spread "
        "has to be estimated with the rest do not tell what.",
        f"In question: {', '.join(asked) or 'nothing of the catalogue'}. They lie within a factor "
        "of 20 of each other in likelihood, what their numbers would buy by chance taken off. "
        f"Looked at and explaining less: {', '.join(out) or 'all others of the catalogue'}.",
        f"Error on held-out speeds, in units of the spread: {g.before:.2f} with the plain model, "
        f"{g.after:.2f} with the first of them.",
        "What the data cannot say: the stroke is not printed, and decides d at low speed; one "
        "push a speed and condition does not show how far a measurement repeats; an order, rests "
        "and other masses are not given.",
    )


def _summarise(paper: Paper) -> list[str]:
    errors = {(e["condition"], e["by"]): e for e in paper.list_errors()}
    fast = [
        abs(r["mu_s_model"] / r["mu_s_gauge"] - 1) * 100
        for r in paper.list_rows()
        if r["quantity"] != "peak_force_N" and r["velocity_mm_min"] >= 2000 and r["mu_s_model"]
    ]
    by_d, by_F = errors["DRY", "distance"], errors["DRY", "force"]
    return [
        f"From the sliding distance, at 2000 mm/min and above, the model finds mu_s within "
        f"{max(fast):.1f} % (mean {np.mean(fast):.1f} %) at speeds it was not calibrated on; the "
        f"paper's (6) is off by up to 36 % there.",
        f"Over all six speeds the mean error from the distance is {by_d['model']:.0f} % dry and "
        f"{errors['OILY', 'distance']['model']:.0f} % oily (paper: {by_d['printed']:.0f} %, "
        f"{errors['OILY', 'distance']['printed']:.0f} %).",
        f"From the force it is {by_F['model']:.0f} % dry and "
        f"{errors['OILY', 'force']['model']:.0f} % oily, worse than the paper's (4) "
        f"({by_F['printed']:.0f} %, {errors['OILY', 'force']['printed']:.0f} %): with k and b set "
        f"by the distances, equation (2) misses F_p by {paper.calibration.spread_force:.1f} N.",
        f"{sum(r['unreachable'] for r in paper.misfit())} of 12 measured distances cannot come "
        "from equation (2) with any k, b and k_v.",
    ]


def _tabulate_errors(paper: Paper) -> Table:
    rows = [
        [
            f"{e['condition']}, {e['by']}",
            format_number(e["printed"], 3),
            format_number(e["surrogate"], 3),
            format_number(e["model"], 3),
            f"{e['answered']} of {e['measurements']}",
            format_number(e["model_on_all_24"], 3),
        ]
        for e in paper.list_errors()
    ]
    columns = ("", "as printed", "(4), (6), (7)", "model", "answered", "model, all 24 fitted")
    return Table("Mean absolute error of mu_s over six speeds [%]", columns, rows)


def _tabulate_rows(paper: Paper) -> Table:
    rows = []
    for r in paper.list_rows():
        force = r["quantity"] == "peak_force_N"
        rows.append(
            [
                f"{r['table']} {r['condition']}",
                f"{r['velocity_mm_min']:.0f}",
                f"{r['measured']:g} {'N' if force else 'µm'}",
                f"{r['mu_s_gauge']:.3f}",
                f"{r['mu_s_printed']:.3f}",
                f"{r['mu_s_surrogate']:.3f}",
                format_with_error(r["mu_s_model"], r["mu_s_model_standard_error"]),
                r["reason"] or "",
            ]
        )
    columns = ("table", "v [mm/min]", "measured", "gauge", "printed", "(4) or (6)", "model", "")
    return Table("Tables I-IV", columns, rows)


def _tabulate_weighted(paper: Paper) -> Table:
    rows = [
        [
            r["condition"],
            f"{r['velocity_mm_min']:.0f}",
            f"{r['mu_s_gauge']:.3f}",
            format_number(r["mu_s_printed"], 3),
            format_number(r["mu_s_surrogate"], 3),
            format_with_error(r["mu_s_model"], r["mu_s_model_standard_error"]),
            format_with_error(r["mu_s_optimal"], r["mu_s_optimal_standard_error"]),
            format_number(r["disagreement_in_standard_deviations"], 2),
        ]
        for r in paper.list_weighted()
    ]
    columns = (
        "",
        "v [mm/min]",
        "gauge",
        "printed",
        "(7), published",
        "(7), model",
        "optimal",
        "force − distance [σ]",
    )
    return Table("Table V, at every speed", columns, rows)


def _tabulate_misfit(paper: Paper) -> Table:
    rows = [
        [
            m["condition"],
            f"{m['velocity_mm_min']:.0f}",
            f"{m['peak_force_residual_N']:+.1f}",
            f"{to_um(m['sliding_distance_residual_m']):+.0f}",
            f"{to_um(m['lossless_bound_m']):.0f}",
            "above the bound" if m["unreachable"] else "",
        ]
        for m in paper.misfit()
    ]
    columns = ("", "v [mm/min]", "F_p − model [N]", "d − model [µm]", "bound on d [µm]", "")
    return Table("Measured minus model at the gauge's mu_s", columns, rows)


def _tabulate_calibration(paper: Paper) -> Table:
    def list_row(name, fit) -> Sequence[str]:
        values = []
        for parameter in fit.free:
            error = fit.standard_error(parameter)
            shown = format_number(fit.value(parameter), 4)
            values.append(
                f"{shown} ± {format_number(error, 2)}" if error is not None else f"{shown} (bound)"
            )
        return [
            name,
            *values,
            f"{fit.spread_force:.1f}",
            f"{to_um(fit.spread_distance):.0f}",
            "yes" if fit.converged else "no",
        ]

    rows = [
        list_row("20 reachable measurements", paper.calibration),
        list_row("all 24", paper.on_all),
    ]
    rows += [
        list_row(f"20, stroke {to_mm(stroke):g} mm", fit) for stroke, fit in paper.strokes.items()
    ]
    columns = (
        "",
        "k [N/m]",
        "b [N s/m]",
        "k_v [N s/m]",
        "spread F_p [N]",
        "spread d [µm]",
        "converged",
    )
    return Table("Calibrations", columns, rows)


def _tabulate_misprints() -> Table:
    rows = [
        [m["table"], f"{m['velocity_mm_min']:.0f}", f"{m['printed']:.3f}", f"{m['recomputed']:.4f}"]
        for m in find_misprints()
    ]
    columns = ("table", "v [mm/min]", "printed mu_s", "by its own formula")
    return Table("Printed mu_s that (4) or (6) does not give", columns, rows)


def _draw_figures(paper: Paper) -> list[Picture]:
    speed = paper.pushes.velocity[3]
    push = {}
    for condition in ("DRY", "OILY"):
        gauge = paper.pushes.mu_s_gauge[paper.pushes.condition.index(condition)]
        rig = parameters.with_values(paper.calibration.rig, {"mu_s": float(gauge)})
        push[condition] = simulate(rig, speed)
    where = f"18.9 kg, {to_mm_min(speed):.0f} mm/min, calibrated"
    return [
        Picture(
            "figure_II_3",
            f"Figure II.3: position ({where}).",
            figures.paper.draw_response(push, "position"),
        ),
        Picture(
            "figure_II_4",
            f"Figure II.4: force ({where}).",
            figures.paper.draw_response(push, "force"),
        ),
        Picture(
            "figure_II_5",
            "Figure II.5: F_p over speed; dashed: the published (3).",
            figures.paper.draw_families(paper.families, "force", paper),
        ),
        Picture(
            "figure_II_6",
            "Figure II.6: d over speed; dashed: the published (5).",
            figures.paper.draw_families(paper.families, "distance", paper),
        ),
    ]
