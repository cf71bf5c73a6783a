"""`difffric acquire`: pushes recorded from the card, or from a simulated one."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

import difffric as df
from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write
from difffric.commands.options import Out, Quiet, read_rig_setup, require_positive
from difffric.commands.running.interruption import COMMAND
from difffric.errors import InputError
from difffric.output_folder import open_folder
from difffric.units import from_mm

_LET_GO = 5.0
"""How long [s] a card may take to be stopped and closed, after Ctrl-C: it must not push on."""


def acquire(
    simulate: Annotated[
        Path | None, typer.Option(help="Set-up of a rig to simulate in place of a card.")
    ] = None,
    velocity_mm_min: Annotated[
        list[float] | None,
        typer.Option(help="Speed of one push [mm/min]. Repeatable, one for each push."),
    ] = None,
    stroke_mm: Annotated[
        float | None, typer.Option(help="Stroke, in place of the set-up's.")
    ] = None,
    rate_hz: Annotated[
        float | None, typer.Option(help="With --simulate: samples per second.")
    ] = None,
    seed: Annotated[
        int, typer.Option(help="With --simulate: seed of noise and scatter.", min=0)
    ] = 0,
    bitfile: Annotated[Path | None, typer.Option(help="Bitfile of the card, .lvbitx.")] = None,
    resource: Annotated[str, typer.Option(help="Name of the card.")] = "RIO0",
    setup: Annotated[
        Path | None, typer.Option(help="With a card: the set-up, to identify each push.")
    ] = None,
    plot: Annotated[
        bool, typer.Option("--plot", help="Draw the last push while pushes come.")
    ] = False,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Record pushes into pushes.tdms, in `out` or the current folder, and identify each.

    Raises `NumericalError`, after all is written, where samples were lost.
    """
    check_out(out)
    for v in velocity_mm_min or ():
        require_positive("--velocity-mm-min", v)
    require_positive("--rate-hz", rate_hz)
    require_positive("--stroke-mm", stroke_mm)
    if simulate is not None and setup is not None:
        raise InputError(
            "--setup and --simulate: give one of them; --simulate names its own set-up"
        )
    file = simulate or setup
    known, truth = None if file is None else read_rig_setup(file), []
    if known is not None and simulate is not None:
        card, truth = df.studies.simulated_rig.make_simulated_card(known, rate_hz, seed)
    else:
        card = df.acquisition.open_card(bitfile, resource)
    stroke = None if stroke_mm is None else from_mm(stroke_mm)
    if stroke is None and known is not None:
        stroke = known.rig.pusher.stroke
        if stroke is not None and not math.isfinite(stroke):
            raise InputError(
                f"{file}: [pusher] duration_ms: the card needs a stroke; give --stroke-mm"
            )
    mass = float("nan") if known is None else float(known.rig.mass)
    pushes = reports.acquire.plan_commands(velocity_mm_min or (), stroke=stroke, mass=mass)
    with (
        open_folder(out or Path()) as folder,
        COMMAND.keep_known(),
        COMMAND.take_time(_LET_GO),
        card as session,
    ):
        run = reports.acquire.record(session, pushes, folder, setup=known, quiet=quiet, plot=plot)
    note = reports.acquire.NO_STROKE if stroke is None else None
    seeded = None if simulate is None else seed
    answer = reports.acquire.describe_run(run, truth=truth, seed=seeded, stroke=note)
    print_and_write(reports.acquire.report_run(answer, run, pictures=out is not None), answer, out)
    reports.acquire.require_all_samples(run)
