"""`difffric family`: the curve families as result.json holds them, and their report."""

from __future__ import annotations

import numpy as np

from difffric.commands import figures
from difffric.commands.reports.page import NO_STROKE, Picture, Report, Section, Table
from difffric.identification.surrogates import (
    PUBLISHED_DISTANCE,
    PUBLISHED_FORCE,
    fit_distance,
    fit_force,
)
from difffric.number_text import format_number
from difffric.rig.rig import Rig
from difffric.simulation.families import Family
from difffric.units import to_um


def describe_family(family: Family) -> dict:
    """Return the families and their fits as result.json holds them."""
    force, distance = fit_force(family), fit_distance(family)
    return {
        "velocity_m_per_s": family.velocity,
        "mu_s": family.mu_s,
        "peak_force_N": family.peak_force,
        "sliding_distance_m": family.sliding_distance,
        "range_ratio_N_per_m": family.range_ratio,
        "equation_3": {"fitted": vars(force), "published": vars(PUBLISHED_FORCE)},
        "equation_5": {"fitted": vars(distance), "published": vars(PUBLISHED_DISTANCE)},
        "misfit": _measure_misfit(family, force, distance),
    }


def _measure_misfit(family: Family, force, distance) -> dict:
    """How far the fitted surrogates are from the model they stand for, and their inverses'
    error in mu_s."""
    v, mu = np.meshgrid(family.velocity, family.mu_s, indexing="ij")
    dF = force.peak_force(v, mu) - family.peak_force
    dd = distance.sliding_distance(v, mu) - family.sliding_distance
    back_F = force.mu_s(v, family.peak_force) - mu
    back_d = distance.mu_s(v, family.sliding_distance) - mu
    return {
        "peak_force_rms_N": float(np.sqrt(np.mean(dF**2))),
        "sliding_distance_rms_m": float(np.sqrt(np.nanmean(dd**2))),
        "mu_s_by_4_rms": float(np.sqrt(np.mean(back_F**2))),
        "mu_s_by_6_rms": float(np.sqrt(np.nanmean(back_d**2))),
        "mu_s_by_6_answered": float(np.mean(np.isfinite(back_d))),
    }


def report_family(answer: dict, family: Family, rig: Rig) -> Report:
    """Return the report of the families, with their figures."""
    rows = []
    for equation in ("equation_3", "equation_5"):
        for name, fitted in answer[equation]["fitted"].items():
            published = answer[equation]["published"][name]
            rows.append(
                [f"({equation[-1]}) {name}", format_number(fitted), format_number(published)]
            )
    misfit = answer["misfit"]
    none = int(np.isnan(family.sliding_distance).sum())
    summary = [
        "Equation (3) follows the model's F_p to "
        f"{format_number(misfit['peak_force_rms_N'], 3)} N (rms), and equation (5) its d to "
        f"{format_number(to_um(misfit['sliding_distance_rms_m']), 3)} µm (rms).",
        "Their inverses, (4) and (6), give mu_s to "
        f"{format_number(misfit['mu_s_by_4_rms'], 2)} and "
        f"{format_number(misfit['mu_s_by_6_rms'], 2)} (rms); (6) gives an answer for "
        f"{100 * misfit['mu_s_by_6_answered']:.0f} % of the pushes.",
    ]
    if none:
        summary.append(f"The part never leaves the tip in {none} of {family.regime.size} pushes.")
    if rig.pusher.stroke is None:
        summary.append(NO_STROKE)
    table = Table(
        "Coefficients of equations (3) and (5) [N, mm/min, µm]",
        ("coefficient", "fitted", "published"),
        rows,
    )
    pictures = [
        Picture(
            "figure_II_5",
            "F_p over speed, a curve for each mu_s; the paper's equation (3) is dashed.",
            figures.paper.draw_families(family, "force"),
        ),
        Picture(
            "figure_II_6",
            "d over speed, a curve for each mu_s; the paper's equation (5) is dashed.",
            figures.paper.draw_families(family, "distance"),
        ),
    ]
    return Report("Curve families", summary, [Section("Fits", (), [table], pictures)])
