"""`difffric simulate`: one push of a set-up's rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from difffric.axis.files.file_kind import is_axis_file
from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write, show_progress
from difffric.commands.options import (
    Channel,
    Out,
    Quiet,
    Setup,
    load_motions,
    load_rig,
    read_setup_for,
    require_positive,
)
from difffric.errors import InputError
from difffric.units import from_mm_min


def simulate(
    setup: Setup,
    velocity_mm_min: Annotated[
        float | None, typer.Option(help="Speed of the pusher [mm/min].", show_default=False)
    ] = None,
    mu_s: Annotated[float | None, typer.Option(help="mu_s, in place of the set-up's.")] = None,
    mass_kg: Annotated[float | None, typer.Option(help="Mass, in place of the set-up's.")] = None,
    stroke_mm: Annotated[
        float | None, typer.Option(help="Stroke, in place of the set-up's.")
    ] = None,
    motion: Annotated[
        Path | None,
        typer.Option(
            help="What drives it: the forces on an axis, .csv or .tdms; for pushes, recordings "
            "with a channel pusher, .tdms."
        ),
    ] = None,
    channel: Channel = None,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Simulate one push and report F_p, d, regime and their derivatives."""
    check_out(out)
    if is_axis_file(setup):
        from difffric.commands.axis import run  # pushes need none of it

        return run.run_simulate(setup, motion, out, quiet)
    if motion is not None:
        if velocity_mm_min is not None or stroke_mm is not None:
            raise InputError("--motion: the recorded motion has its own speed and stroke")
        said = read_setup_for(setup, channel)
        rig = load_rig(setup, mu_s, mass_kg)
        recordings = load_motions(motion, said)
        with show_progress(quiet) as tell:
            answer = reports.simulate.describe_motions(rig, recordings, mass_kg is None, tell)
        print_and_write(reports.simulate.report_motions(answer, recordings), answer, out)
        return None
    if velocity_mm_min is None:
        raise InputError("--velocity-mm-min is missing: expected the pusher's speed in mm/min")
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
