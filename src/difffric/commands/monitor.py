"""`difffric monitor`: a machine watched over its pushes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import difffric as df
from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write, show_progress
from difffric.commands.options import (
    Channel,
    DataMass,
    Out,
    Quiet,
    SetupOption,
    SkipBad,
    check_setup,
    read_setup_for,
    require_positive,
)
from difffric.commands.running.interruption import COMMAND
from difffric.errors import InputError


def monitor(
    data: Annotated[
        list[Path], typer.Argument(help="Pushes in time order, .csv or .tdms.", show_default=False)
    ],
    setup: SetupOption = None,
    state: Annotated[
        Path | None, typer.Option(help="File that keeps what is known until the next run.")
    ] = None,
    arl: Annotated[
        float | None,
        typer.Option(help="Mean number of pushes between false alarms; 1000 by default."),
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="Wait for the pushes of a .tdms that is being written.")
    ] = False,
    idle_s: Annotated[
        float | None,
        typer.Option(help="With --follow: end after so long without a push, not at Ctrl-C only."),
    ] = None,
    use_data_mass: DataMass = False,
    skip_bad: SkipBad = False,
    channel: Channel = None,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Watch friction over the pushes; the exit status is 3 where it changed."""
    check_out(out)
    require_positive("--idle-s", idle_s)
    if follow and len(data) != 1:
        raise InputError(f"--follow: expected one .tdms, got {len(data)} files")
    known = read_setup_for(check_setup(setup, data[0]), channel)
    feed = df.monitoring.feed.Feed(known, arl=arl, state=state)
    with show_progress(quiet) as tell:
        if follow:
            feed.on_push = reports.monitor.make_teller(feed)
            with COMMAND.end_by_ctrl_c():
                feed.follow(data[0], idle=idle_s, tell=tell)
        else:
            feed.files(data, use_data_mass=use_data_mass, skip_bad=skip_bad, tell=tell)
        tell("drawing", 0.99)
        alarms = reports.monitor.explain_alarms(feed.monitor)
        answer = reports.monitor.describe_monitor(feed, alarms)
        report = reports.monitor.report_monitor(feed, answer, alarms, pictures=out is not None)
    print_and_write(report, answer, out, notes=feed.notes)
    if reports.monitor.find_new_alarms(feed):
        raise typer.Exit(reports.monitor.ALARM)
