"""What `identify` and `diagnose` need to take a fleet's archive in place of one rig's file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from difffric.errors import InputError
from difffric.fleet.archive import is_archive

Archive = Annotated[
    Path,
    typer.Argument(
        metavar="DATA",
        help="Measured data, .csv or .tdms. For a fleet: a folder, or 'a/**/*.tdms'.",
        show_default=False,
    ),
]
FleetSetup = Annotated[
    Path | None,
    typer.Option(
        "--setup",
        help="The set-up, a setup.toml. For a fleet: for files without one above them.",
        show_default=False,
    ),
]
Workers = Annotated[int | None, typer.Option(help="For a fleet: number of processes.", min=1)]
Scheduler = Annotated[
    str | None, typer.Option(help="For a fleet: a dask scheduler, tcp://host:port.")
]


def is_fleet(data: Path, workers: int | None, scheduler: str | None) -> bool:
    """Whether the command is for a fleet: it names processes, or a folder or pattern of files."""
    return workers is not None or scheduler is not None or is_archive(data)


def check_fleet(data: Path, workers: int | None, scheduler: str | None, out: Path | None) -> Path:
    """Return the folder for what is found in an archive.

    Raises `InputError` where there is none, or where both ways to have workers are asked for.
    """
    if out is None:
        raise InputError(f"--out is missing: expected the folder for what is found in {data}")
    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler: give one of them, not both")
    return out
