"""`difffric centre`: rings centred on a simulated machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import difffric as df
from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write, show_progress
from difffric.commands.options import Out, Quiet, Setup, read_rig_setup, require_positive
from difffric.units import from_um


def centre(
    setup: Setup,
    truth: Annotated[
        Path | None,
        typer.Option(help="Set-up of the simulated machine itself, with hidden effects."),
    ] = None,
    rings: Annotated[int, typer.Option(help="Number of rings.", min=1)] = 10,
    offset_um: Annotated[
        float | None, typer.Option(help="Offset of each ring; by default 5 to 5000, at random.")
    ] = None,
    mu_s_from: Annotated[float, typer.Option(help="Smallest hidden mu_s.")] = 0.08,
    mu_s_to: Annotated[float, typer.Option(help="Largest hidden mu_s.")] = 0.25,
    drift_percent: Annotated[float, typer.Option(help="Drift of the hidden mu_s per push.")] = 0.0,
    verify: Annotated[
        bool, typer.Option("--verify", help="Measure the ring again at the end.")
    ] = False,
    alone: Annotated[
        bool, typer.Option("--alone", help="Leave out the other ways to centre a ring.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of rings, noise and scatter.", min=0)] = 0,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Centre rings whose friction nobody knows, and report pushes and errors of each way."""
    check_out(out)
    require_positive("--offset-um", offset_um)
    said = read_rig_setup(setup)
    hidden = None if truth is None else read_rig_setup(truth).rig
    scatter, drift = df.centering.planning.SCATTER, abs(drift_percent) / 100
    belief = df.centering.Belief.uniform(mu_s_from, mu_s_to, scatter, drift=drift)
    known = df.centering.Known.of(said, belief)
    runs = df.studies.centering_runs
    own = runs.OFFSETS[0] if offset_um is None else from_um(offset_um)
    offsets = runs.OFFSETS if offset_um is None else (own, own)
    those = runs.draw_rings(rings, seed, (mu_s_from, mu_s_to), offsets)
    with show_progress(quiet) as tell:
        found = list(
            runs.run_rings(
                known,
                those,
                truth=hidden,
                ways=(runs.OURS,) if alone else (runs.OURS, *df.studies.other_centering.RIVALS),
                drift=drift_percent / 100,
                verify=verify,
                tell=tell,
            )
        )
        tell("drawing", 0.99)
        answer = reports.centre.describe_centering(found, known, seed)
        report = reports.centre.report_centering(answer, found, known, pictures=out is not None)
    print_and_write(report, answer, out)
