"""`difffric check`: what measured pushes hold, shown before anything is fitted."""

from __future__ import annotations

from dataclasses import replace

import difffric as df
from difffric.axis.files.file_kind import is_axis_file
from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write, show_progress
from difffric.commands.options import (
    Channel,
    Data,
    DataMass,
    Out,
    Quiet,
    ReadOptions,
    SetupOption,
    SkipBad,
    TrustUnits,
    check_setup,
    format_command,
    load_data,
    read_setup_for,
)


def check(
    data: Data,
    setup: SetupOption = None,
    use_data_mass: DataMass = False,
    skip_bad: SkipBad = False,
    channel: Channel = None,
    trust_units: TrustUnits = False,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Show what would be fitted: traces, landmarks, noise, what is missing, what can be told."""
    check_out(out)
    asked = ReadOptions(skip_bad, channel, trust_units, use_data_mass)
    setup = check_setup(setup, data)
    if is_axis_file(setup):
        from difffric.commands.axis import run  # pushes need none of it

        return run.run_check(data, setup, asked, out, quiet)
    rig = read_setup_for(setup, channel)
    with show_progress(quiet) as tell:
        tell("reading", 0.0)
        loaded = load_data(data, rig, skip_bad, trust_units)
        found = reports.check.examine(loaded, rig, use_data_mass=use_data_mass, skip_bad=skip_bad)
        tell("asking what the data determine", 0.3)
        known = df.calibration.identifiable(rig, found.pushes)
        tell("drawing", 0.9)
        answer = reports.check.describe_check(found, known)
        report = reports.check.report_check(found, known, rig, out is not None)
        command = format_command("fit", data, setup, asked, "--out", "DIR")
        report = replace(report, command=command)
    print_and_write(report, answer, out, timings=tell.timings, notes=loaded.notes)
