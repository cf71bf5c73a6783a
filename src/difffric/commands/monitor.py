"""`difffric monitor`: a machine watched over its pushes."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from difffric.commands.console import check_out, print_and_write, show_progress
from difffric.commands.options import (
    DataMass,
    Out,
    Quiet,
    SetupOption,
    SkipBad,
    require_positive,
)
from difffric.commands.reports import monitor as answers
from difffric.errors import InputError
from difffric.monitoring.feed import Feed
from difffric.rig.setup_toml import read_setup


def monitor(
    data: Annotated[
        list[Path], typer.Argument(help="pushes in time order, .csv or .tdms", show_default=False)
    ],
    setup: SetupOption,
    state: Annotated[
        Path | None, typer.Option(help="what is known is kept here, and gone on from")
    ] = None,
    arl: Annotated[
        float | None, typer.Option(help="pushes between false alarms, in the mean; 1000")
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="wait for the pushes of a .tdms that is being written")
    ] = False,
    idle_s: Annotated[
        float | None, typer.Option(help="--follow ends when no push came for so long; else Ctrl-C")
    ] = None,
    use_data_mass: DataMass = False,
    skip_bad: SkipBad = False,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Watch friction over the pushes; the exit status is 3 where it changed."""
    check_out(out)
    require_positive("--idle-s", idle_s)
    if follow and len(data) != 1:
        raise InputError(f"--follow: expected one .tdms, got {len(data)} files")
    feed = Feed(read_setup(setup), arl=arl, state=state)
    with show_progress(quiet) as tell:
        if follow:
            feed.on_push = answers.make_teller(feed)
            with suppress(KeyboardInterrupt):
                feed.follow(data[0], idle=idle_s, tell=tell)
        else:
            feed.files(data, use_data_mass=use_data_mass, skip_bad=skip_bad, tell=tell)
        tell("drawing", 0.99)
        alarms = answers.explain_alarms(feed.monitor)
        answer = answers.describe_monitor(feed, alarms)
        report = answers.report_monitor(feed, answer, alarms, pictures=out is not None)
    print_and_write(report, answer, out)
    if answers.find_new_alarms(feed):
        raise typer.Exit(answers.ALARM)
