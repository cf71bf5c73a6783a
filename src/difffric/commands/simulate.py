"""`difffric simulate`: one push of a set-up's rig."""

from __future__ import annotations

from typing import Annotated

import typer

from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write, show_progress
from difffric.commands.options import Out, Quiet, Setup, load_rig, require_positive
from difffric.units import from_mm_min


def simulate(
    setup: Setup,
    velocity_mm_min: Annotated[float, typer.Option(help="pusher speed [mm/min]")],
    mu_s: Annotated[float | None, typer.Option(help="instead of the set-up's")] = None,
    mass_kg: Annotated[float | None, typer.Option(help="instead of the set-up's")] = None,
    stroke_mm: Annotated[float | None, typer.Option(help="instead of the set-up's")] = None,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Simulate one push and report F_p, d, regime and their derivatives."""
    check_out(out)
    rig = load_rig(setup, mu_s, mass_kg, stroke_mm)
    require_positive("--velocity-mm-min", velocity_mm_min)
    with show_progress(quiet) as tell:
        tell("simulating", 0.0)
        answer = reports.simulate.describe_simulation(rig, from_mm_min(velocity_mm_min))
    pictures = (
        () if out is None else reports.simulate.draw_simulation(rig, from_mm_min(velocity_mm_min))
    )
    report = reports.simulate.report_simulation(answer, velocity_mm_min, rig, pictures)
    print_and_write(report, answer, out)
