"""The command line: each command prints a table for a person and leaves its answer in --out."""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from difffric.commands.cli_fleet import (
    Archive,
    FleetSetup,
    Scheduler,
    Workers,
    diagnose_many,
    identify_many,
    is_fleet,
)
from difffric.commands.options import (
    Data,
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
from difffric.compute import private_folder

UsageError: Any = typer.BadParameter.__base__


def main() -> None:
    """Entry point: bad input is one clear message and exit status 2, never a traceback."""
    _prepare_jax()
    from difffric.errors import DifffricError, InputError

    try:
        sys.exit(app(standalone_mode=False) or 0)
    except UsageError as error:
        if not sys.argv[1:]:  # the help
            error.show()
            sys.exit(2)
        text = " ".join(error.format_message().split()).rstrip(".")
        sys.stderr.write(f"difffric: {text}; --help says what is expected\n")
        sys.exit(2)
    except typer.Abort:
        sys.stderr.write("difffric: aborted\n")
        sys.exit(1)
    except InputError as error:
        sys.stderr.write(f"difffric: {error}\n")
        sys.exit(2)
    except DifffricError as error:
        sys.stderr.write(f"difffric: {error}\n")
        sys.exit(1)


def _prepare_jax() -> None:
    """64 bits, and compiled programs kept in the user's cache folder between runs."""
    os.environ.setdefault("JAX_ENABLE_X64", "1")
    # Equinox's error callbacks would keep programs out of the cache; failures come as NaN and
    # with a reason here.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "difffric"
    os.environ.setdefault("DIFFFRIC_PROGRAMS", str(cache / "programs"))
    folder = Path(os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache / "jax")))
    if folder.name and private_folder.made(folder):
        private_folder.swept(folder)
    elif os.environ.pop("JAX_COMPILATION_CACHE_DIR"):
        sys.stderr.write(f"difffric: {folder}: {private_folder.REFUSED}: JAX's cache is not used\n")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    # An entry that another process is just writing: the program is compiled here.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")
    # One small program at a time: handing it to another thread costs more than running it.
    os.environ.setdefault("JAX_CPU_ENABLE_ASYNC_DISPATCH", "0")


@app.command()
def simulate(
    setup: Setup,
    velocity_mm_min: Annotated[float, typer.Option(help="pusher speed [mm/min]")],
    mu_s: Annotated[float | None, typer.Option(help="instead of the set-up's")] = None,
    mass_kg: Annotated[float | None, typer.Option(help="instead of the set-up's")] = None,
    stroke_mm: Annotated[float | None, typer.Option(help="instead of the set-up's")] = None,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """One push: F_p, d, regime, and their derivatives in every parameter."""
    check_writable(out)
    rig = rig_of(setup, mu_s, mass_kg, stroke_mm)
    positive("--velocity-mm-min", velocity_mm_min)
    from difffric.commands.reports.simulate import (
        simulate_answer,
        simulate_pictures,
        simulate_report,
    )
    from difffric.units import from_mm_min

    with progress(quiet) as tell:
        tell("simulating", 0.0)
        answer = simulate_answer(rig, from_mm_min(velocity_mm_min))
    pictures = () if out is None else simulate_pictures(rig, from_mm_min(velocity_mm_min))
    finish(simulate_report(answer, velocity_mm_min, rig, pictures), answer, out)


@app.command()
def acquire(
    simulate: Annotated[Path | None, typer.Option(help="a setup.toml to push, no card")] = None,
    velocity_mm_min: Annotated[
        list[float] | None, typer.Option(help="pusher speed [mm/min], once a push")
    ] = None,
    stroke_mm: Annotated[float | None, typer.Option(help="instead of the set-up's")] = None,
    rate_hz: Annotated[float | None, typer.Option(help="simulated: samples a second")] = None,
    seed: Annotated[int, typer.Option(help="simulated: of noise and scatter", min=0)] = 0,
    bitfile: Annotated[Path | None, typer.Option(help="of the card, .lvbitx")] = None,
    resource: Annotated[str, typer.Option(help="the card's name")] = "RIO0",
    setup: Annotated[
        Path | None, typer.Option(help="with a card: the rig, to identify each push")
    ] = None,
    plot: Annotated[bool, typer.Option("--plot", help="a live figure")] = False,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """Record pushes into pushes.tdms, in --out or here, and identify them as they come."""
    check_writable(out)
    for v in velocity_mm_min or ():
        positive("--velocity-mm-min", v)
    positive("--rate-hz", rate_hz)
    positive("--stroke-mm", stroke_mm)
    from difffric.acquisition.card import open_card
    from difffric.commands.reports import acquire as answers
    from difffric.commands.simulated_rig import simulated_card
    from difffric.errors import InputError
    from difffric.output_folder import open_folder
    from difffric.rig.setup_toml import read_setup
    from difffric.units import from_mm

    if simulate is not None and setup is not None:
        raise InputError("--setup is for a card: --simulate has its set-up")
    file = simulate or setup
    known, truth = None if file is None else read_setup(file), []
    if known is not None and simulate is not None:
        card, truth = simulated_card(known, rate_hz, seed)
    else:
        card = open_card(bitfile, resource)
    stroke = None if stroke_mm is None else from_mm(stroke_mm)
    if stroke is None and known is not None:
        stroke = known.rig.pusher.stroke
    mass = float("nan") if known is None else float(known.rig.mass)
    pushes = answers.commands(velocity_mm_min or (), stroke=stroke, mass=mass)
    with open_folder(out or Path()) as folder, card as session:
        run = answers.record(session, pushes, folder, setup=known, quiet=quiet, plot=plot)
    note = answers.NO_STROKE if stroke is None else None
    seeded = None if simulate is None else seed
    answer = answers.acquire_answer(run, truth=truth, seed=seeded, stroke=note)
    finish(answers.acquire_report(answer, run, pictures=out is not None), answer, out)
    answers.raise_for_lost(run)


@app.command()
def family(setup: Setup, out: Out = None, quiet: Quiet = False) -> None:
    """The curve families over speed and mu_s, the fits (3) and (5), their inverses (4), (6)."""
    check_writable(out)
    rig = rig_of(setup)
    from difffric.commands.reports.family import family_answer, family_report
    from difffric.simulation.families import family as curves

    with progress(quiet) as tell:
        tell("simulating 494 pushes", 0.0)
        grid = curves(rig)
    answer = family_answer(grid)
    finish(family_report(answer, grid, rig), answer, out)


@app.command()
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
    """Calibrate a part or rig on measured pushes: parameters, errors, what stays open."""
    check_writable(out)
    from difffric.calibration.calibrate import fit as calibrate
    from difffric.commands.reports import fit as answers
    from difffric.errors import InputError
    from difffric.measurements.load_file import load
    from difffric.measurements.recordings import Recordings
    from difffric.rig.setup_toml import read_setup

    answers.check_out(out, setup)
    rig, loaded = read_setup(setup), load(data, skip_bad=skip_bad)
    if robust and isinstance(loaded, Recordings):
        raise InputError(
            f"--robust: {data}: expected a table; recordings are fitted sample by sample"
        )
    chosen = ["mu_s"] if per_condition is None else [x for x in per_condition if x != "none"]
    with progress(quiet) as tell:
        found = calibrate(
            rig, loaded, free=free or None, per_condition=chosen, priors=prior,
            free_start=free_start, robust=robust, several_starts=not one_start, tell=tell,
            use_data_mass=use_data_mass, skip_bad=skip_bad,
        )  # fmt: skip
        answer = answers.Answer.of(found)
        answer = answers.with_more(answer, profile, next_push, tell)
        tell("drawing", 0.99)
        report = answers.fit_report(answer, pictures=out is not None)
        files = None if out is None else {"setup.toml": answers.setup_file_of(found)}
    finish(report, answer.as_dict(), out, files)


@app.command()
def identify(
    data: Archive,
    setup: FleetSetup = None,
    use_data_mass: DataMass = False,
    skip_bad: SkipBad = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """mu_s of each push from force, distance, (7), the optimal combination, the recording; of
    a folder or a pattern of files, a fleet's: one Parquet data set."""
    check_writable(out)
    if is_fleet(data, workers, scheduler):
        return identify_many(data, setup, use_data_mass, workers, scheduler, out, quiet)
    from difffric.commands.reports import identify as answers
    from difffric.errors import InputError
    from difffric.identification.estimators import identify as estimate
    from difffric.measurements.load_file import load
    from difffric.rig.setup_toml import read_setup

    if setup is None:
        raise InputError(f"--setup is missing: expected the set-up of the rig of {data}")
    rig, loaded = read_setup(setup), load(data, skip_bad=skip_bad)
    with progress(quiet) as tell:
        found = estimate(rig, loaded, use_data_mass=use_data_mass, skip_bad=skip_bad, tell=tell)
    answer = answers.identify_answer(found, rig.rig)
    finish(answers.identify_report(found, answer, loaded, out is not None), answer, out)


@app.command()
def diagnose(
    data: Archive,
    setup: FleetSetup = None,
    negligible: Annotated[
        float, typer.Option(help="share of the systematic error below which a cause is left out")
    ] = 0.1,
    held_out: Annotated[
        str, typer.Option(help="what is held out at a time: push, or speed (all of one speed)")
    ] = "push",
    use_data_mass: DataMass = False,
    skip_bad: SkipBad = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Out = None,
    quiet: Quiet = False,
) -> None:
    """What the simulation gets wrong, the cause, the extended model and what it gains; of a folder
    or a pattern of files, a fleet: what its rigs share, and which of them differ."""
    check_writable(out)
    from difffric.commands.reports import diagnose as answers
    from difffric.commands.reports.fit import check_out
    from difffric.diagnosis.procedure import diagnose as look
    from difffric.errors import InputError
    from difffric.measurements.load_file import load
    from difffric.rig.setup_toml import read_setup

    if not 0 <= negligible < 1:
        raise InputError(f"--negligible: expected a share from 0 to 1, got {negligible:g}")
    if is_fleet(data, workers, scheduler):
        return diagnose_many(
            data, setup, workers, scheduler, out, quiet, negligible=negligible,
            held_out=held_out, use_data_mass=use_data_mass,
        )  # fmt: skip
    if setup is None:
        raise InputError(f"--setup is missing: expected the set-up of the rig of {data}")
    check_out(out, setup)
    rig, loaded = read_setup(setup), load(data, skip_bad=skip_bad)
    with progress(quiet) as tell:
        found = look(
            rig, loaded, negligible=negligible, held_out=held_out, use_data_mass=use_data_mass,
            skip_bad=skip_bad, tell=tell,
        )  # fmt: skip
        tell("drawing", 0.99)
        report = answers.diagnose_report(found, pictures=out is not None)
        files = None if out is None else {"setup.toml": answers.setup_file_of(found)}
    finish(report, found.as_dict(), out, files)


@app.command()
def paper(out: Out = None, quiet: Quiet = False) -> None:
    """The paper's Tables I-V and Figures II.3-II.6, beside the differentiable model's answers."""
    check_writable(out)
    from difffric.commands.reports.paper import paper_report
    from difffric.studies.paper import study

    with progress(quiet) as tell:
        found = study(tell)
    finish(paper_report(found), found.as_dict(), out)


if __name__ == "__main__":
    main()
