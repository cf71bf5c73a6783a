"""`difffric plan`: the push that brings a part to its target."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import difffric as df
from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write, show_progress
from difffric.commands.options import Out, Quiet, Setup, read_rig_setup, require_positive
from difffric.units import from_mm, from_mm_min, from_um


def plan(
    setup: Setup,
    offset_um: Annotated[
        float | None, typer.Option(help="Distance that the part shall go. Give this or --ring.")
    ] = None,
    offset_se_um: Annotated[
        float, typer.Option(help="Standard error of --offset-um.", min=0)
    ] = 0.0,
    ring: Annotated[
        Path | None,
        typer.Option(help="Probe readings of a ring, .csv, from which the offset follows."),
    ] = None,
    radius_mm: Annotated[
        float | None,
        typer.Option(help="Nominal radius of the ring, if the readings are reading_um."),
    ] = None,
    mu_s: Annotated[float | None, typer.Option(help="mu_s, in place of the set-up's.")] = None,
    mu_s_se: Annotated[
        float | None, typer.Option(help="Standard error of mu_s, in place of the set-up's.", min=0)
    ] = None,
    slowest_mm_min: Annotated[float, typer.Option(help="Lowest speed to choose from.")] = 500.0,
    fastest_mm_min: Annotated[float, typer.Option(help="Highest speed to choose from.")] = 5000.0,
    within_um: Annotated[float, typer.Option(help="Tolerance about the target.")] = 2.5,
    reach_mm: Annotated[
        float, typer.Option(help="Longest way that the rails let a part go.")
    ] = 20.0,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Report the best push, or two, and how likely the part lands within the tolerance."""
    check_out(out)
    require_positive("--within-um", within_um)
    require_positive("--reach-mm", reach_mm)
    require_positive("--mu-s", mu_s)
    require_positive("--radius-mm", radius_mm)
    said = reports.plan.replace_mu_s(read_rig_setup(setup), mu_s, mu_s_se)
    offset, error, found = reports.plan.find_offset(offset_um, offset_se_um, ring, radius_mm)
    known = df.centering.Known.of(
        said,
        speeds=df.centering.planning.space_speeds(
            from_mm_min(slowest_mm_min), from_mm_min(fastest_mm_min)
        ),
        within=from_um(within_um),
        reach=from_mm(reach_mm),
    )
    with show_progress(quiet) as tell:
        tell("planning", 0.0)
        planned = df.plan(known, offset, error)
    answer = reports.plan.describe_plan(planned, known, found, reports.plan.list_notes(said))
    print_and_write(
        reports.plan.report_plan(planned, known, answer, found, out is not None), answer, out
    )
