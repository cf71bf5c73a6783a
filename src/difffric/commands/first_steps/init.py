"""`difffric init`: a first setup.toml for a rig, with k and b guessed from its own pushes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from difffric.commands.console import open_console
from difffric.commands.options import Channel, Data, SkipBad, parse_channels, require_positive
from difffric.errors import InputError


def init(
    data: Data,
    mass_kg: Annotated[
        float | None, typer.Option(help="Mass of the part; asked for if the data do not say it.")
    ] = None,
    stroke_mm: Annotated[
        float | None,
        typer.Option(help="Travel of the pusher; by default what the data say, if they do."),
    ] = None,
    sensitivity_mv_per_n: Annotated[
        float, typer.Option(help="Sensitivity of the force sensor.")
    ] = 11.2,
    range_n: Annotated[float, typer.Option(help="Force at which the sensor saturates.")] = 446.0,
    resolution_um: Annotated[float, typer.Option(help="Resolution of the probe.")] = 0.02,
    channel: Channel = None,
    skip_bad: SkipBad = False,
    to: Annotated[Path, typer.Option(help="File to write; it must not exist yet.")] = Path(
        "setup.toml"
    ),
) -> None:
    """Write a first set-up, which a fit can start from."""
    # Not at the top: help needs no numbers.
    from difffric.atomic_files import write_whole
    from difffric.commands.first_steps.first_setup import FirstNumbers, write_first_setup

    if to.exists():
        raise InputError(f"{to}: exists already; give another name with --to")
    sensor = require_positive("--sensitivity-mv-per-n", sensitivity_mv_per_n)
    said = FirstNumbers(
        require_positive("--mass-kg", mass_kg),
        require_positive("--stroke-mm", stroke_mm),
        sensor or 1.0,
        require_positive("--range-n", range_n) or 1.0,
        require_positive("--resolution-um", resolution_um) or 1.0,
    )
    text, words = write_first_setup(data, said, parse_channels(channel), skip_bad)
    write_whole(to, lambda file: file.write(text.encode()))
    console = open_console()
    console.print(words)
    console.print(f"written to {to}; next: difffric check {data} --setup {to}", soft_wrap=True)
