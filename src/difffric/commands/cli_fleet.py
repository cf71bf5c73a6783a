"""What `identify` and `diagnose` add for a fleet: their options, and the commands on many files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from difffric.commands.options import finish, progress

Archive = Annotated[
    Path,
    typer.Argument(
        metavar="DATA",
        help="measured pushes, .csv or .tdms; of a fleet a folder, or a pattern as 'a/**/*.tdms'",
        show_default=False,
    ),
]
FleetSetup = Annotated[
    Path | None,
    typer.Option(
        "--setup",
        help="the rig, a setup.toml; of a fleet, where no folder upwards has one",
        show_default=False,
    ),
]
Workers = Annotated[int | None, typer.Option(help="a fleet's processes; one needs no dask", min=1)]
Scheduler = Annotated[str | None, typer.Option(help="a fleet's dask scheduler, tcp://host:port")]


def is_fleet(data: Path, workers: int | None, scheduler: str | None) -> bool:
    """Whether the command is for a fleet."""
    if workers is not None or scheduler is not None:
        return True
    from difffric.fleet.archive import is_archive

    return is_archive(data)


def identify_many(data, setup, use_data_mass, workers, scheduler, out, quiet) -> None:
    """mu_s of all pushes of an archive, into the folder."""
    _checked(data, workers, scheduler, out)
    from difffric.commands.reports.fleet import fleet_answer, fleet_report
    from difffric.fleet.identify_archive import identify_fleet

    with progress(quiet) as tell:
        found = identify_fleet(
            data, out, setup=setup, n_workers=workers or 1, scheduler=scheduler,
            use_data_mass=use_data_mass, tell=tell,
        )  # fmt: skip
        tell("drawing", 1.0)
        answer = fleet_answer(found)
        report = fleet_report(found, answer, pictures=True)
    finish(report, answer, out)


def diagnose_many(data, setup, workers, scheduler, out, quiet, **options) -> None:
    """What the rigs of an archive share, and which of them differ, into the folder."""
    _checked(data, workers, scheduler, out)
    from difffric.commands.reports.fleet_diagnosis import (
        fleet_diagnosis_answer,
        fleet_diagnosis_report,
    )
    from difffric.fleet.diagnose_archive import diagnose_fleet

    with progress(quiet) as tell:
        found = diagnose_fleet(
            data, out, setup=setup, n_workers=workers or 1, scheduler=scheduler, tell=tell,
            **options,
        )  # fmt: skip
        tell("drawing", 1.0)
        report = fleet_diagnosis_report(found, pictures=True)
    finish(report, fleet_diagnosis_answer(found), out)


def _checked(data, workers, scheduler, out) -> None:
    """What any command on many files needs."""
    from difffric.errors import InputError

    if out is None:
        raise InputError(f"--out is missing: expected the folder for what is found in {data}")
    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler: expected one of them")
