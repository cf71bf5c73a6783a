"""`difffric export`: mu_s from F_p and d as a controller's C."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import difffric as df
from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write, show_progress
from difffric.commands.options import Quiet, Setup, load_rig, require_positive
from difffric.errors import InputError
from difffric.units import from_mm_min


def export(
    setup: Setup,
    out: Annotated[Path | None, typer.Option(help="Folder for the files; required.")] = None,
    max_error: Annotated[float, typer.Option(help="Largest error, as a share of mu_s.")] = 0.005,
    slowest_mm_min: Annotated[float, typer.Option(help="Lowest speed [mm/min].")] = 500.0,
    fastest_mm_min: Annotated[float, typer.Option(help="Highest speed [mm/min].")] = 5000.0,
    least_mu_s: Annotated[float, typer.Option(help="Smallest mu_s.")] = 0.05,
    most_mu_s: Annotated[float, typer.Option(help="Largest mu_s.")] = 0.30,
    least_elasticity: Annotated[
        float,
        typer.Option(help="Least relative change of a reading by mu_s that still determines mu_s."),
    ] = 0.01,
    stroke_mm: Annotated[
        float | None, typer.Option(help="Stroke, in place of the set-up's.")
    ] = None,
    no_stroke: Annotated[
        bool, typer.Option("--no-stroke", help="Let the pusher stop at the first loss of contact.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Write predictor.c, .h and .json, with the largest error that they make proven."""
    if out is None:
        raise InputError("export writes files: expected a folder for them; give --out DIR")
    if no_stroke and stroke_mm is not None:
        raise InputError("--no-stroke and --stroke-mm: give one of them, not both")
    check_out(out)
    require_positive("--slowest-mm-min", slowest_mm_min)
    require_positive("--fastest-mm-min", fastest_mm_min)
    require_positive("--least-mu-s", least_mu_s)
    require_positive("--most-mu-s", most_mu_s)
    rig = load_rig(setup, stroke_mm=stroke_mm)
    if no_stroke:
        rig = df.rig.parameters.with_stroke(rig, None)
    controller = df.identification.controller
    box = controller.predictor.Box(
        from_mm_min(slowest_mm_min), from_mm_min(fastest_mm_min), least_mu_s, most_mu_s
    )
    controller.fitting.check(rig, box, max_error, least_elasticity)
    with show_progress(quiet) as tell:
        found = df.identification.fit_predictor(
            rig, box, max_error=max_error, least_elasticity=least_elasticity, tell=tell
        )
        tell("writing", 0.95)
        report = reports.export.report_predictor(found, rig)
        files = reports.export.render_files(found, rig)
    print_and_write(report, reports.export.describe_predictor(found, rig), out, files)
