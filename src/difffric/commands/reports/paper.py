"""`difffric paper`: the report of the paper's measurements."""

from __future__ import annotations

from difffric.commands import figures
from difffric.commands.reports.page import Picture, Report, Section, Table
from difffric.number_text import format_number, format_with_error
from difffric.rig import parameters
from difffric.rig.catalogue import CATALOGUE
from difffric.simulation.trajectory import simulate
from difffric.studies.paper import Paper, find_misprints
from difffric.units import to_mm_min, to_um

_NAMES = {
    "b_N_s_per_m": "a damper on approach, b of (2)",
    "k_v_N_s_per_m": "viscous friction, k_v of (1)",
    "friction_ratio": "another mu_k / mu_s",
}
_FAST = 5000.0
"""The speed [mm/min] of the paper's Table V."""


def report_paper(paper: Paper) -> Report:
    """The paper's measurements for a person."""
    return Report(
        "The paper's measurements, explained",
        _summarise(paper),
        [
            Section(
                "What is found, in two pictures",
                (),
                [_tabulate_errors(paper)],
                [
                    Picture(
                        "explained",
                        "F_p and d over speed: what was measured, and what equation (2) as printed "
                        "and the extended model give with the gauge's mu_s.",
                        figures.paper.draw_explained(paper),
                    ),
                    Picture(
                        "errors",
                        "The error of mu_s at each speed by a calibration that has not seen it. "
                        "The crosses are the paper's own formulas.",
                        figures.paper.draw_errors(paper),
                    ),
                ],
            ),
            Section(
                "What equation (2) cannot do",
                _describe_failure(paper),
                [_tabulate_slopes(paper)],
                [
                    Picture(
                        "slopes",
                        "How much F_p tells about mu_s: its derivative, over the speed.",
                        figures.paper.draw_slopes(paper),
                    )
                ],
            ),
            Section(
                "The extended model, and what each part buys",
                (
                    "From the spring alone the search adds one part after the other, or two at "
                    "once, of the effects that a table can show; b and k_v count as parts too. "
                    "Errors on held-out pushes, all of one speed at a time, are in units of the "
                    "errors assumed: 2 % beside 3 N and 15 µm. The structure was chosen on all six "
                    "speeds, its numbers without the one that is judged.",
                ),
                [_tabulate_stages(paper), _tabulate_parameters(paper)],
            ),
            Section(
                "mu_s of the 24 measurements",
                (
                    "Each speed is judged by calibrations that have not seen it. The errors are "
                    "those against the gauge.",
                ),
                [_tabulate_rows(paper), _tabulate_weighted(paper), _tabulate_misfit(paper)],
            ),
            Section(
                "What 24 numbers cannot settle",
                _describe_open(paper),
                [_tabulate_proposals(paper)],
            ),
            Section("Misprints", (), [_tabulate_misprints()]),
            Section("The paper's figures", (), (), _draw_figures(paper)),
        ],
        _advise(paper),
    )


def name_part(part: str) -> str:
    """A part of a model as a person reads it."""
    return _NAMES.get(part) or CATALOGUE[part].text


def _find_error(paper: Paper, by: str, key: str = "model") -> tuple[float, float]:
    """Mean absolute errors [%], dry and oily."""
    found = {(e["condition"], e["by"]): e[key] for e in paper.list_errors()}
    return found["DRY", by], found["OILY", by]


def _summarise(paper: Paper) -> list[str]:
    stages, k = paper.list_stages(), paper.extended.fit.value("k_N_per_m")
    parts = [part for stage in stages for part in stage["added"]]
    slopes = {s["model"]: s for s in paper.compare_slopes()}
    fast = [r for r in paper.list_weighted() if r["velocity_mm_min"] == _FAST]
    seven = [100 * abs(r["mu_s_model"] / r["mu_s_gauge"] - 1) for r in fast]
    force, distance = _find_error(paper, "force"), _find_error(paper, "distance")
    was_F, was_d = (_find_error(paper, by, "plain") for by in ("force", "distance"))
    theirs_F, theirs_d = (_find_error(paper, by, "surrogate") for by in ("force", "distance"))
    lines = [
        f"Equation (2) as printed cannot serve both measurements. {len(paper.certificates)} of 12 "
        "distances are longer than any k, b and k_v give; and the damper on approach that the "
        f"other distances ask for leaves {slopes['plain']['slope_N'][-1]:.0f} N of F_p's "
        f"{slopes['forces']['slope_N'][-1]:.0f} N per unit of mu_s at {_FAST:.0f} mm/min.",
        f"The search finds what it lacks: {'; '.join(name_part(x) for x in parts)}. With a "
        f"stiffness of {k:.3g} N/m these are {len(paper.extended.fit.free)} parameters.",
        "On speeds that the fit has not seen, these parts lower the error from "
        f"{stages[0]['heldout_nrmse']:.0f} to {stages[-1]['heldout_nrmse']:.1f} standard errors.",
        f"mu_s from the force errs by {force[0]:.0f} % dry and {force[1]:.0f} % oily (equation "
        f"(2): {was_F[0]:.0f} and {was_F[1]:.0f} %; the paper's (4): {theirs_F[0]:.0f} and "
        f"{theirs_F[1]:.0f} %), from the distance by {distance[0]:.0f} and {distance[1]:.0f} % "
        f"({was_d[0]:.0f} and {was_d[1]:.0f} %; (6): {theirs_d[0]:.0f} and {theirs_d[1]:.0f} %), "
        f"by (7) at {_FAST:.0f} mm/min by {seven[0]:.1f} and {seven[1]:.1f} % (paper: 5.2 and "
        "2.9 %).",
    ]
    return lines


def _advise(paper: Paper) -> list[str]:
    """Return what to measure next."""
    if paper.explanation.rivals:
        one = paper.proposals[0]
        best, rival = paper.explanation.best.parts, paper.explanation.rivals[0].parts
        gone, instead = (
            " and ".join(name_part(x) for x in sorted(parts))
            for parts in (best - rival, rival - best)
        )
        return [
            f"Push a part with mu_s = {one.mu_s:g} once at {one.velocity_mm_min:.0f} mm/min: "
            f"it settles what these data cannot, “{gone}” or “{instead}”. The two differ there by "
            f"{one.after:.0f} standard errors."
        ]
    return ["Record a push with its tip: the paper gives neither its stroke nor its duration."]


def _describe_failure(paper: Paper) -> tuple[str, ...]:
    slopes = {s["model"]: s for s in paper.compare_slopes()}
    forces, plain = slopes["forces"], slopes["plain"]
    b = paper.plain.fit.value("b_N_s_per_m")
    return (
        "Equation (3), F_p = C_v v + C_mu mu_s, is a fingerprint of the paper's own simulation: "
        "C_mu = 146 N is hardly more than mu_k F_N / mu_s = 139 N. A contact without damping on "
        f"approach, k = {paper.by_force.value('k_N_per_m'):.3g} N/m as the twelve forces want it, "
        f"gives C_v = {forces['C_v_N_min_per_mm']:.4f} and C_mu = {forces['C_mu_N']:.1f} (printed: "
        "0.0529 and 146.2).",
        f"The distances at 2000 mm/min and above want a loss. With b = {b:.0f} N s/m on approach, "
        f"the only one that (2) has, dF_p/dmu_s falls to {plain['slope_N'][-1]:.0f} N at 5000 "
        "mm/min: where b v exceeds mu_s F_N the part slips at once, and F_p hardly knows mu_s.",
        "A rebound at most doubles the speed, so that d <= 4 v² / (2 mu_k g). The measured d at "
        "500 and 1000 mm/min is above it, dry and oily alike: the tip goes on after the first "
        "loss of contact, and d is counted from there.",
    )


def _describe_open(paper: Paper) -> tuple[str, ...]:
    lines = []
    for rival in paper.explanation.rivals:
        best = paper.explanation.best
        gone, instead = best.parts - rival.parts, rival.parts - best.parts
        lines.append(
            f"{', '.join(name_part(x) for x in instead)} in place of "
            f"{', '.join(name_part(x) for x in gone)} explains the 24 numbers nearly as well "
            f"(chi-square {rival.cost:.1f} against {best.cost:.1f})."
            + (
                " The paper's own simulation, by (3), had no such damper."
                if "b_N_s_per_m" in instead
                else ""
            )
        )
    lines += [
        f"Not determined by themselves: {', '.join(x['parameters'])}. {x['reason']}."
        for x in paper.extended.fit.not_identifiable
    ]
    lines.append(
        "The stroke, the duration of the tip's motion and the threshold at which d begins to count "
        "are not printed: a recording of the pusher and one look at the card's program would tell "
        "the last two. One push a speed and condition does not show how far a measurement repeats."
    )
    return tuple(lines)


def _tabulate_errors(paper: Paper) -> Table:
    rows = [
        [
            f"{e['condition']}, {e['by']}",
            format_number(e["printed"], 3),
            format_number(e["surrogate"], 3),
            format_number(e["plain"], 3),
            f"{e['answered_plain']} of {e['measurements']}",
            format_number(e["model"], 3),
            f"{e['answered']} of {e['measurements']}",
        ]
        for e in paper.list_errors()
    ]
    columns = (
        "mu_s from", "as printed", "by (4), (6), (7)", "by equation (2)", "answered by (2)",
        "by the extended model", "answered by it",
    )  # fmt: skip
    return Table("Mean absolute error of mu_s over six unseen speeds [%]", columns, rows)


def _tabulate_slopes(paper: Paper) -> Table:
    at = [500.0, 1000.0, 2000.0, 3000.0, 4000.0, 5000.0]
    names = {
        "forces": "no damping on approach (forces)",
        "plain": "equation (2), forces and distances",
        "extended": "extended model",
    }
    rows = []
    for s in paper.compare_slopes():
        by_speed = dict(zip((round(v) for v in s["velocity_mm_min"]), s["slope_N"], strict=True))
        rows.append(
            [
                names[s["model"]],
                f"{s['C_v_N_min_per_mm']:.4f}",
                f"{s['C_mu_N']:.1f}",
                *(f"{by_speed[round(v)]:.0f}" for v in at),
            ]
        )
    rows.append(["(3) as printed", "0.0529", "146.2", *["146"] * len(at)])
    columns = ("model", "C_v [N min/mm]", "C_mu [N]", *(f"{v:.0f}" for v in at))
    return Table(
        "C_v and C_mu of equation (3) by each model, and its dF_p/dmu_s [N] at 500 to 5000 mm/min",
        columns,
        rows,
    )


def _tabulate_stages(paper: Paper) -> Table:
    rows = []
    for stage in paper.list_stages():
        added = "; ".join(name_part(x) for x in stage["added"]) or "the spring alone"
        dropped = "; ".join(name_part(x) for x in stage["dropped"])
        rows.append(
            [
                added + (f" (without {dropped})" if dropped else ""),
                str(len(stage["parameters"])),
                f"{stage['heldout_nrmse']:.2f}",
            ]
        )
    columns = ("part", "parameters", "error on held-out speeds")
    return Table("What each part buys (1 is perfect)", columns, rows)


def _tabulate_parameters(paper: Paper) -> Table:
    fit = paper.extended.fit
    drops = {
        part: one.cost - paper.explanation.best.cost
        for part, one in paper.explanation.without.items()
    }
    rows = []
    for name in fit.free:
        error, part = fit.standard_error(name), name.partition(".")[0]
        rows.append(
            [
                name,
                f"{fit.value(name):.4g}" + (f" ± {error:.2g}" if error else ""),
                "" if not error else f"{100 * error / abs(fit.value(name)):.0f} %",
                f"{drops[part]:.0f}" if part in drops else "",
            ]
        )
    columns = ("parameter [SI]", "value", "error", "chi-square more without it")
    return Table("The extended model, on all 24 measurements", columns, rows)


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
                format_number(r["mu_s_plain"], 3),
                format_with_error(r["mu_s_model"], r["mu_s_model_standard_error"]),
                r["reason"] or "",
            ]
        )
    columns = (
        "table", "speed [mm/min]", "measured", "gauge", "printed", "by (4) or (6)",
        "by equation (2)", "by the extended model", "remark",
    )  # fmt: skip
    return Table("Tables I-IV", columns, rows)


def _tabulate_weighted(paper: Paper) -> Table:
    rows = [
        [
            r["condition"],
            f"{r['velocity_mm_min']:.0f}",
            f"{r['mu_s_gauge']:.3f}",
            format_number(r["mu_s_printed"], 3),
            format_number(r["mu_s_surrogate"], 3),
            format_number(r["mu_s_plain"], 3),
            format_with_error(r["mu_s_model"], r["mu_s_model_standard_error"]),
            format_with_error(r["mu_s_optimal"], r["mu_s_optimal_standard_error"]),
            format_number(r["disagreement_in_standard_deviations"], 2),
        ]
        for r in paper.list_weighted()
    ]
    columns = (
        "condition", "speed [mm/min]", "gauge", "printed", "(7), published", "(7), equation (2)",
        "(7), extended", "optimal", "force − distance [σ]",
    )  # fmt: skip
    return Table("Table V, at every speed", columns, rows)


def _tabulate_misfit(paper: Paper) -> Table:
    rows = [
        [
            m["condition"],
            f"{m['velocity_mm_min']:.0f}",
            f"{m['peak_force_residual_N_plain']:+.1f}",
            f"{m['peak_force_residual_N_extended']:+.1f}",
            f"{to_um(m['sliding_distance_residual_m_plain']):+.0f}",
            f"{to_um(m['sliding_distance_residual_m_extended']):+.0f}",
            f"{to_um(m['lossless_bound_m']):.0f}",
            "above the bound" if m["unreachable"] else "",
        ]
        for m in paper.misfit()
    ]
    columns = (
        "condition", "speed [mm/min]", "F_p − (2) [N]", "F_p − extended [N]", "d − (2) [µm]",
        "d − extended [µm]", "bound on d [µm]", "remark",
    )  # fmt: skip
    return Table(
        "What was measured less what each model gives with the gauge's mu_s", columns, rows
    )


def _tabulate_proposals(paper: Paper) -> Table:
    rows = []
    for one in paper.proposals:
        if one.before:
            gain = f"standard error {one.before:.3g} → {one.after:.3g}"
        else:
            gain = f"{one.after:.0f} standard errors apart in {one.quantity}"
        rows.append([one.purpose, f"{one.velocity_mm_min:.0f}", f"{one.mu_s:g}", gain])
    columns = ("to settle", "speed [mm/min]", "mu_s of the part", "what one push tells")
    return Table("The next experiment", columns, rows)


def _tabulate_misprints() -> Table:
    rows = [
        [m["table"], f"{m['velocity_mm_min']:.0f}", f"{m['printed']:.3f}", f"{m['recomputed']:.4f}"]
        for m in find_misprints()
    ]
    columns = ("table", "speed [mm/min]", "printed mu_s", "by its own formula")
    return Table("Printed mu_s that (4) or (6) does not give", columns, rows)


def _draw_figures(paper: Paper) -> list[Picture]:
    speed, push = paper.pushes.velocity[3], {}
    for condition in ("DRY", "OILY"):
        gauge = paper.pushes.mu_s_gauge[paper.pushes.condition.index(condition)]
        rig = parameters.with_values(paper.by_force.rig, {"mu_s": float(gauge)})
        push[condition] = simulate(rig, speed)
    where = f"18.9 kg, {to_mm_min(speed):.0f} mm/min, calibrated on the forces"
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
            "Figure II.5: F_p over speed, extended model; dashed: the published (3).",
            figures.paper.draw_families(paper.families, "force", paper),
        ),
        Picture(
            "figure_II_6",
            "Figure II.6: d over speed, extended model; dashed: the published (5).",
            figures.paper.draw_families(paper.families, "distance", paper),
        ),
    ]
