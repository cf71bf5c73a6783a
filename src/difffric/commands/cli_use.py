"""The commands that use the friction: plan a push, centre a ring, watch a machine, export."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from difffric.commands.options import (
    DataMass,
    Out,
    Quiet,
    Setup,
    SetupOption,
    SkipBad,
    app,
    check_writable,
    finish,
    positive,
    progress,
    rig_of,
)


@app.command()
def ring(
    readings: Annotated[Path, typer.Argument(help="probe readings, .csv", show_default=False)],
    radius_mm: Annotated[
        float | None, typer.Option(help="the nominal radius that reading_um counts from")
    ] = None,
    noise_um: Annotated[
        float | None, typer.Option(help="of one reading; estimated unless given")
    ] = None,
    lobes: Annotated[
        int | None, typer.Option(help="highest order of lobes, 1: none; else by the readings")
    ] = None,
    form_um: Annotated[
        float, typer.Option(help="amplitude of lobes that a ring may have unseen")
    ] = 1.0,
    out: Out = None,
) -> None:
    """A ring's offset from the axis and its direction, from probe readings over a rotation."""
    check_writable(out)
    positive("--radius-mm", radius_mm)
    positive("--noise-um", noise_um)
    from difffric.centering.ring import measure
    from difffric.centering.ring_csv import load_ring
    from difffric.commands.reports.ring import ring_report
    from difffric.errors import InputError
    from difffric.units import from_mm, from_um

    if not 0 <= form_um < 1e6:
        raise InputError(f"--form-um: expected a number >= 0, got {form_um:g}")
    nominal = None if radius_mm is None else from_mm(radius_mm)
    angle, radius = load_ring(readings, nominal)
    noise = None if noise_um is None else from_um(noise_um)
    try:
        found = measure(angle, radius, noise=noise, lobes=lobes, form=from_um(form_um))
    except InputError as error:
        raise InputError(f"{readings}: {error}") from None
    report = ring_report(found, angle, radius, pictures=out is not None)
    finish(report, {"readings_file": str(readings), **found.as_dict()}, out)


@app.command()
def plan(
    setup: Setup,
    offset_um: Annotated[
        float | None, typer.Option(help="how far the part is to go; or --ring")
    ] = None,
    offset_se_um: Annotated[float, typer.Option(help="its standard error", min=0)] = 0.0,
    ring: Annotated[
        Path | None, typer.Option(help="probe readings that the offset is found from, .csv")
    ] = None,
    radius_mm: Annotated[
        float | None, typer.Option(help="the ring's nominal radius, which reading_um counts from")
    ] = None,
    mu_s: Annotated[float | None, typer.Option(help="instead of the set-up's")] = None,
    mu_s_se: Annotated[
        float | None, typer.Option(help="its standard error, instead of the set-up's", min=0)
    ] = None,
    slowest_mm_min: Annotated[float, typer.Option(help="of the speeds to choose from")] = 500.0,
    fastest_mm_min: Annotated[float, typer.Option(help="likewise")] = 5000.0,
    within_um: Annotated[float, typer.Option(help="of the target")] = 2.5,
    reach_mm: Annotated[float, typer.Option(help="how far the rails let a part go")] = 20.0,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """The push that brings a part to its target, and how likely it lands there."""
    check_writable(out)
    from difffric.centering.planning import Known, speeds_between
    from difffric.centering.planning import plan as next_push
    from difffric.commands.reports import plan as answers
    from difffric.rig.setup_toml import read_setup
    from difffric.units import from_mm, from_mm_min, from_um

    positive("--within-um", within_um)
    positive("--reach-mm", reach_mm)
    positive("--mu-s", mu_s)
    positive("--radius-mm", radius_mm)
    said = answers.with_mu_s(read_setup(setup), mu_s, mu_s_se)
    offset, error, found = answers.offset_of(offset_um, offset_se_um, ring, radius_mm)
    known = Known.of(
        said, speeds=speeds_between(from_mm_min(slowest_mm_min), from_mm_min(fastest_mm_min)),
        within=from_um(within_um), reach=from_mm(reach_mm),
    )  # fmt: skip
    with progress(quiet) as tell:
        tell("planning", 0.0)
        planned = next_push(known, offset, error)
    answer = answers.plan_answer(planned, known, found, answers.notes_on(said))
    finish(answers.plan_report(planned, known, answer, found, out is not None), answer, out)


@app.command()
def centre(
    setup: Setup,
    truth: Annotated[
        Path | None, typer.Option(help="the machine's own setup.toml, with hidden effects")
    ] = None,
    rings: Annotated[int, typer.Option(help="how many", min=1)] = 10,
    offset_um: Annotated[
        float | None, typer.Option(help="of each ring; else 5 to 5000, at random")
    ] = None,
    mu_s_from: Annotated[float, typer.Option(help="hidden friction is between this")] = 0.08,
    mu_s_to: Annotated[float, typer.Option(help="and this")] = 0.25,
    drift_percent: Annotated[float, typer.Option(help="of the hidden mu_s, per push")] = 0.0,
    verify: Annotated[bool, typer.Option("--verify", help="measure again at the end")] = False,
    alone: Annotated[bool, typer.Option("--alone", help="not beside other ways")] = False,
    seed: Annotated[int, typer.Option(help="of rings, noise and scatter", min=0)] = 0,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Centre rings on a simulated machine with hidden friction, beside other ways to do it."""
    check_writable(out)
    positive("--offset-um", offset_um)
    from difffric.centering.belief import Belief
    from difffric.centering.planning import SCATTER, Known
    from difffric.commands.reports import centre as answers
    from difffric.rig.setup_toml import load_setup, read_setup
    from difffric.studies.centering_runs import OFFSETS, OURS, hidden_rings, runs
    from difffric.studies.other_centering import RIVALS
    from difffric.units import from_um

    said = read_setup(setup)
    hidden = None if truth is None else load_setup(truth)
    known = Known.of(
        said, Belief.uniform(mu_s_from, mu_s_to, SCATTER, drift=abs(drift_percent) / 100)
    )
    own = OFFSETS[0] if offset_um is None else from_um(offset_um)
    offsets = OFFSETS if offset_um is None else (own, own)
    those = hidden_rings(rings, seed, (mu_s_from, mu_s_to), offsets)
    with progress(quiet) as tell:
        found = list(
            runs(
                known, those, truth=hidden, ways=(OURS,) if alone else (OURS, *RIVALS),
                drift=drift_percent / 100, verify=verify, tell=tell,
            )
        )  # fmt: skip
        tell("drawing", 0.99)
        answer = answers.centre_answer(found, known, seed)
        report = answers.centre_report(answer, found, known, pictures=out is not None)
    finish(report, answer, out)


@app.command()
def export(
    setup: Setup,
    out: Annotated[Path | None, typer.Option(help="folder for the files; needed")] = None,
    max_error: Annotated[float, typer.Option(help="largest error, a share of mu_s")] = 0.005,
    slowest_mm_min: Annotated[float, typer.Option(help="speeds from [mm/min]")] = 500.0,
    fastest_mm_min: Annotated[float, typer.Option(help="to [mm/min]")] = 5000.0,
    least_mu_s: Annotated[float, typer.Option(help="mu_s from")] = 0.05,
    most_mu_s: Annotated[float, typer.Option(help="to")] = 0.30,
    least_elasticity: Annotated[
        float, typer.Option(help="relative change of a reading, by mu_s, that still tells it")
    ] = 0.01,
    stroke_mm: Annotated[float | None, typer.Option(help="instead of the set-up's")] = None,
    no_stroke: Annotated[
        bool, typer.Option("--no-stroke", help="the pusher stops at the first loss of contact")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """mu_s from F_p and d for a controller: predictor.c, .h and .json, with the error proven."""
    from difffric.errors import InputError

    if out is None:
        raise InputError("export writes files: expected a folder for them; give --out DIR")
    if no_stroke and stroke_mm is not None:
        raise InputError("--no-stroke and --stroke-mm: expected one of them at most")
    check_writable(out)
    for name, value in (
        ("--slowest-mm-min", slowest_mm_min), ("--fastest-mm-min", fastest_mm_min),
        ("--least-mu-s", least_mu_s), ("--most-mu-s", most_mu_s),
    ):  # fmt: skip
        positive(name, value)
    rig = rig_of(setup, stroke_mm=stroke_mm)
    from difffric.commands.reports.export import export_answer, export_report, files_of
    from difffric.identification.controller.fitting import check, fit_predictor
    from difffric.identification.controller.predictor import Box
    from difffric.rig import parameters
    from difffric.units import from_mm_min

    if no_stroke:
        rig = parameters.with_stroke(rig, None)
    box = Box(from_mm_min(slowest_mm_min), from_mm_min(fastest_mm_min), least_mu_s, most_mu_s)
    check(rig, box, max_error, least_elasticity)
    with progress(quiet) as tell:
        found = fit_predictor(
            rig, box, max_error=max_error, least_elasticity=least_elasticity, tell=tell
        )
        tell("writing", 0.95)
        report, files = export_report(found, rig), files_of(found, rig)
    finish(report, export_answer(found, rig), out, files)


@app.command()
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
    """Watch a machine over its pushes: friction, and an alarm (exit status 3) when it changes."""
    check_writable(out)
    positive("--idle-s", idle_s)
    from difffric.commands.reports import monitor as answers
    from difffric.errors import InputError
    from difffric.monitoring.feed import Feed
    from difffric.rig.setup_toml import read_setup

    if follow and len(data) != 1:
        raise InputError(f"--follow: expected one .tdms, got {len(data)} files")
    feed = Feed(read_setup(setup), arl=arl, state=state)
    with progress(quiet) as tell:
        if follow:
            feed.on_push = answers.teller(feed)
            with suppress(KeyboardInterrupt):
                feed.follow(data[0], idle=idle_s, tell=tell)
        else:
            feed.files(data, use_data_mass=use_data_mass, skip_bad=skip_bad, tell=tell)
        tell("drawing", 0.99)
        alarms = answers.explained(feed.monitor)
        answer = answers.monitor_answer(feed, alarms)
        report = answers.monitor_report(feed, answer, alarms, pictures=out is not None)
    finish(report, answer, out)
    if answers.new_alarms(feed):
        raise typer.Exit(answers.ALARM)
