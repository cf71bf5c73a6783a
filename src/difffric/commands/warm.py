"""`difffric warm`: the programs that the commands need, compiled before they are asked for."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

import difffric as df
from difffric.commands.console import show_progress
from difffric.commands.options import Quiet, read_rig_setup


def warm(
    setup: Annotated[
        Path | None,
        typer.Argument(help="The set-up; by default the paper's rig, with and without a stroke."),
    ] = None,
    processes: Annotated[
        int | None,
        typer.Option(help="Number of processes at once; by default one for each core.", min=1),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Compile what the commands need for this set-up, and print what was made."""
    from difffric.studies import first_runs

    if setup is None:
        rigs = [df.studies.published_tables.guess_rig(stroke) for stroke in (None, 2e-3)]
        setups = [df.Setup(rig) for rig in rigs]
    else:
        setups = [read_rig_setup(setup)]
    start, made = time.perf_counter(), 0
    with show_progress(quiet) as tell:
        for name, why, _ in first_runs.make_programs(setups, processes, tell):
            made += 1
            if why:
                typer.echo(f"{name}: {why}")
    found = first_runs.list_made(setups)
    for one in sorted(found, key=lambda one: -one.compiled):
        name = one.name.removeprefix("difffric.")
        seconds = f"{one.traced:6.1f} s traced {one.compiled:6.1f} s compiled"
        typer.echo(f"{seconds if made else '':35s}{1e-6 * one.size:6.2f} MB  {name}")
    size = 1e-6 * sum(one.size for one in found)
    typer.echo(
        f"{len(found)} programs, {size:.1f} MB, "
        + (f"made in {time.perf_counter() - start:.0f} s" if made else "all there")
    )
