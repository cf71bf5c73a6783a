"""`difffric fit`: a part or rig calibrated on measured pushes."""

from __future__ import annotations

from typing import Annotated

import typer

import difffric as df
from difffric.axis.files.file_kind import is_axis_file
from difffric.commands import reports
from difffric.commands.console import check_out, check_setup_stays, print_and_write, show_progress
from difffric.commands.options import (
    Channel,
    Data,
    DataMass,
    Out,
    Quiet,
    SetupOption,
    SkipBad,
    TrustUnits,
    load_data,
    read_setup_for,
)
from difffric.errors import InputError


def fit(
    data: Data,
    setup: SetupOption,
    free: Annotated[
        list[str] | None, typer.Option(help="a free parameter, once each; default k, b, k_v, mu_s")
    ] = None,
    per_condition: Annotated[
        list[str] | None,
        typer.Option(help="one value for each condition, once each; default mu_s; none: nothing"),
    ] = None,
    prior: Annotated[
        bool, typer.Option("--prior", help="the set-up's standard errors count as knowledge")
    ] = False,
    free_start: Annotated[
        bool, typer.Option("--free-start", help="a start offset for each recording")
    ] = False,
    robust: Annotated[
        bool, typer.Option("--robust", help="outliers of a table weigh less (Huber)")
    ] = False,
    use_data_mass: DataMass = False,
    skip_bad: SkipBad = False,
    channel: Channel = None,
    trust_units: TrustUnits = False,
    one_start: Annotated[
        bool, typer.Option("--one-start", help="search from the set-up's values only")
    ] = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="profile-likelihood intervals too")
    ] = False,
    next_push: Annotated[
        bool, typer.Option("--next-push", help="which push would say most, too")
    ] = False,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Calibrate on the data and report parameters, errors and what stays open."""
    check_out(out)
    if is_axis_file(setup):
        from difffric.commands.axis import run  # pushes need none of it

        for option, given in (
            ("--per-condition", per_condition),
            ("--prior", prior),
            ("--free-start", free_start),
            ("--robust", robust),
            ("--profile", profile),
            ("--next-push", next_push),
        ):
            if given:
                raise InputError(f"{option}: of pushes only, {setup} is the set-up of an axis")
        asked = run.Reading(skip_bad, channel, trust_units)
        return run.run_fit(data, setup, free or None, asked, out, quiet)
    check_setup_stays(out, setup)
    rig = read_setup_for(setup, channel)
    loaded = load_data(data, rig, skip_bad, trust_units)
    if robust and isinstance(loaded, df.Recordings):
        raise InputError(
            f"--robust: {data}: expected a table; recordings are fitted sample by sample"
        )
    chosen = ["mu_s"] if per_condition is None else [x for x in per_condition if x != "none"]
    with show_progress(quiet) as tell:
        found = df.fit(
            rig,
            loaded,
            free=free or None,
            per_condition=chosen,
            priors=prior,
            free_start=free_start,
            robust=robust,
            several_starts=not one_start,
            tell=tell,
            use_data_mass=use_data_mass,
            skip_bad=skip_bad,
        )
        answer = reports.fit.Answer.of(found)
        answer = reports.fit.add_more(answer, profile, next_push, tell)
        tell("drawing", 0.99)
        report = reports.fit.report_fit(answer, pictures=out is not None)
        files = (
            None
            if out is None
            else {"setup.toml": df.rig.format_setup(found.fitted_setup).encode()}
        )
    print_and_write(report, answer.as_dict(), out, files, tell.timings, loaded.notes)
