"""`difffric fit`: a part or rig calibrated on measured pushes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

import difffric as df
from difffric.axis.files.file_kind import is_axis_file
from difffric.commands import reports
from difffric.commands.console import (
    check_out,
    check_setup_stays,
    print_and_write,
    show_progress,
)
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
    sign_setup,
)
from difffric.errors import InputError
from difffric.known_so_far import tell_known
from difffric.number_text import format_pair


def fit(
    data: Data,
    setup: SetupOption = None,
    free: Annotated[
        list[str] | None,
        typer.Option(help="A free parameter; by default k, b, k_v and mu_s. Repeatable."),
    ] = None,
    per_condition: Annotated[
        list[str] | None,
        typer.Option(
            help="A parameter with a value for each condition: mu_s (default), others, or none."
        ),
    ] = None,
    prior: Annotated[
        bool,
        typer.Option("--prior", help="Use the standard errors in the set-up as prior knowledge."),
    ] = False,
    free_start: Annotated[
        bool, typer.Option("--free-start", help="Fit a start offset for each recording.")
    ] = False,
    robust: Annotated[
        bool, typer.Option("--robust", help="Give outliers of a table less weight (Huber).")
    ] = False,
    use_data_mass: DataMass = False,
    skip_bad: SkipBad = False,
    channel: Channel = None,
    trust_units: TrustUnits = False,
    one_start: Annotated[
        bool, typer.Option("--one-start", help="Search from the set-up's values only.")
    ] = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="Also give profile-likelihood intervals.")
    ] = False,
    next_push: Annotated[
        bool, typer.Option("--next-push", help="Also say which push would tell most.")
    ] = False,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Calibrate on the data and report parameters, errors and what stays open."""
    check_out(out)
    asked = ReadOptions(skip_bad, channel, trust_units, use_data_mass)
    setup = check_setup(setup, data)
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
                raise InputError(f"{option} is for pushes only: {setup} is the set-up of an axis")
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
        pairs = {x: format_pair(found.value(x), found.standard_error(x)) for x in found.free}
        words = ", ".join(f"{label} = {' ± '.join(pair)}" for label, pair in pairs.items())
        tell_known("the fit", words, found.as_dict())
        answer = reports.fit.Answer.of(found)
        answer = reports.fit.add_more(answer, profile, next_push, tell)
        tell("drawing", 0.99)
        report = reports.fit.report_fit(answer, pictures=out is not None)
        then = reports.fit_summary.choose_command(found)
        if then == "diagnose":
            report = replace(
                report, command=format_command(then, data, setup, asked, "--out", "DIR")
            )
        elif then:
            fitted = (out or Path("DIR")) / "setup.toml"
            report = replace(report, command=format_command(then, data, fitted, asked))
        files = (
            None
            if out is None
            else {
                "setup.toml": df.rig.format_setup(
                    found.fitted_setup, signed=sign_setup("fit", data)
                ).encode()
            }
        )
    print_and_write(report, answer.as_dict(), out, files, tell.timings, loaded.notes)
