"""`difffric identify`: mu_s of each push, of one rig or of a fleet."""

from __future__ import annotations

from pathlib import Path

import difffric as df
from difffric.axis.files.file_kind import is_axis_file
from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write, show_progress
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
    load_data,
    read_setup_for,
)


def identify(
    data: Archive,
    setup: FleetSetup = None,
    use_data_mass: DataMass = False,
    skip_bad: SkipBad = False,
    channel: Channel = None,
    trust_units: TrustUnits = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Identify mu_s of each push every way that its measurements allow."""
    check_out(out)
    asked = ReadOptions(skip_bad, channel, trust_units, use_data_mass)
    if is_fleet(data, workers, scheduler):
        return _identify_fleet(data, setup, use_data_mass, workers, scheduler, out, quiet)
    file = check_setup(setup, data)
    if is_axis_file(file):
        from difffric.commands.axis import run  # pushes need none of it

        return run.run_identify(data, file, asked, out, quiet)
    rig = read_setup_for(file, channel)
    loaded = load_data(data, rig, skip_bad, trust_units)
    with show_progress(quiet) as tell:
        found = df.identify(rig, loaded, use_data_mass=use_data_mass, skip_bad=skip_bad, tell=tell)
    answer = reports.identify.describe_friction(found, rig.rig)
    report = reports.identify.report_friction(found, answer, loaded, out is not None)
    print_and_write(report, answer, out, timings=tell.timings, notes=loaded.notes)


def _identify_fleet(
    data: Path,
    setup: Path | None,
    use_data_mass: bool,
    workers: int | None,
    scheduler: str | None,
    out: Path | None,
    quiet: bool,
) -> None:
    """Identify mu_s of all pushes of an archive, into the folder."""
    folder = check_fleet(data, workers, scheduler, out)
    with show_progress(quiet) as tell:
        found = df.identify_fleet(
            data,
            folder,
            setup=setup,
            n_workers=workers or 1,
            scheduler=scheduler,
            use_data_mass=use_data_mass,
            tell=tell,
        )
        tell("drawing", 1.0)
        answer = reports.fleet.describe_fleet(found)
        report = reports.fleet.report_fleet(found, answer, pictures=True)
    print_and_write(report, answer, folder)
