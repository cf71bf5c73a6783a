"""`difffric diagnose`: what a simulation lacks, for one rig or a fleet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import difffric as df
from difffric.axis.files.file_kind import is_axis_file
from difffric.commands import reports
from difffric.commands.console import check_out, check_setup_stays, print_and_write, show_progress
from difffric.commands.fleet_options import (
    Archive,
    FleetSetup,
    Scheduler,
    Workers,
    check_fleet,
    is_fleet,
)
from difffric.commands.options import (
    Channel,
    DataMass,
    Out,
    Quiet,
    ReadOptions,
    SkipBad,
    TrustUnits,
    check_setup,
    format_command,
    load_data,
    read_setup_for,
    sign_setup,
)
from difffric.errors import InputError


def diagnose(
    data: Archive,
    setup: FleetSetup = None,
    matters: Annotated[
        float,
        typer.Option(help="Least share of mu_s that a cause changes (or F_p or d as much)."),
    ] = 0.005,
    held_out: Annotated[
        str,
        typer.Option(
            help="Hold out one push at a time, or all pushes of one speed: push or speed."
        ),
    ] = "push",
    use_data_mass: DataMass = False,
    skip_bad: SkipBad = False,
    channel: Channel = None,
    trust_units: TrustUnits = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Report what the simulation gets wrong, the cause, the extended model and what it gains."""
    check_out(out)
    asked = ReadOptions(skip_bad, channel, trust_units, use_data_mass)
    if not 0 <= matters < 1:
        raise InputError(f"--matters: expected a share of mu_s from 0 to 1, got {matters:g}")
    if is_fleet(data, workers, scheduler):
        options = {"matters": matters, "held_out": held_out, "use_data_mass": use_data_mass}
        return _diagnose_fleet(data, setup, workers, scheduler, out, quiet, options)
    file = check_setup(setup, data)
    if is_axis_file(file):
        from difffric.commands.axis import run  # pushes need none of it

        return run.run_diagnose(data, file, matters, asked, out, quiet)
    check_setup_stays(out, file)
    rig = read_setup_for(file, channel)
    loaded = load_data(data, rig, skip_bad, trust_units)
    with show_progress(quiet) as tell:
        found = df.diagnose(
            rig,
            loaded,
            matters=matters,
            held_out=held_out,
            use_data_mass=use_data_mass,
            skip_bad=skip_bad,
            tell=tell,
        )
        tell("drawing", 0.99)
        go_on = format_command("identify", data, (out or Path("DIR")) / "setup.toml", asked)
        report = reports.diagnose.report_diagnosis(found, go_on, pictures=out is not None)
        files = (
            None
            if out is None
            else {
                "setup.toml": df.rig.format_setup(
                    found.setup, signed=sign_setup("diagnose", data)
                ).encode()
            }
        )
    print_and_write(report, found.as_dict(), out, files, tell.timings, loaded.notes)


def _diagnose_fleet(
    data: Path,
    setup: Path | None,
    workers: int | None,
    scheduler: str | None,
    out: Path | None,
    quiet: bool,
    options: dict[str, Any],
) -> None:
    """Report what the rigs of an archive share and which of them differ, into the folder."""
    folder = check_fleet(data, workers, scheduler, out)
    with show_progress(quiet) as tell:
        found = df.diagnose_fleet(
            data,
            folder,
            setup=setup,
            n_workers=workers or 1,
            scheduler=scheduler,
            tell=tell,
            **options,
        )
        tell("drawing", 1.0)
        report = reports.fleet_diagnosis.report_fleet_diagnosis(found, pictures=True)
    answer = reports.fleet_diagnosis.describe_fleet_diagnosis(found)
    print_and_write(report, answer, folder)
