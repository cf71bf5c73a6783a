"""`difffric init`: a first setup.toml for a rig, with k and b guessed from its own pushes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from difffric.axis.files.file_kind import is_axis_recording, lacks_speeds
from difffric.commands.console import open_console
from difffric.commands.options import Channel, Data, SkipBad, parse_channels, require_positive
from difffric.errors import InputError


def init(
    data: Data,
    mass_kg: Annotated[
        float | None,
        typer.Option(help="Mass of the part or of the axis; asked for if the data do not say it."),
    ] = None,
    stroke_mm: Annotated[
        float | None,
        typer.Option(help="Travel of the pusher; by default what the data say, if they do."),
    ] = None,
    sensitivity_mv_per_n: Annotated[
        float | None, typer.Option(help="Sensitivity of the force sensor; 11.2 by default.")
    ] = None,
    range_n: Annotated[
        float | None, typer.Option(help="Force at which the sensor saturates; 446 by default.")
    ] = None,
    resolution_um: Annotated[
        float | None,
        typer.Option(help="Resolution of the probe, 0.02 by default; or of an axis' encoder."),
    ] = None,
    gain_n_per_v: Annotated[
        float | None,
        typer.Option(help="Gain of an axis' drive; needed if the drive was recorded in volts."),
    ] = None,
    channel: Channel = None,
    skip_bad: SkipBad = False,
    to: Annotated[Path, typer.Option(help="File to write; it must not exist yet.")] = Path(
        "setup.toml"
    ),
) -> None:
    """Write a first set-up, which a fit can start from. Sampling rates are read from the data."""
    from difffric.atomic_files import write_whole  # not at the top: help needs no numbers

    if to.exists():
        raise InputError(f"{to}: exists already; give another name with --to")
    mass = require_positive("--mass-kg", mass_kg)
    stroke = require_positive("--stroke-mm", stroke_mm)
    sensitivity = require_positive("--sensitivity-mv-per-n", sensitivity_mv_per_n)
    most = require_positive("--range-n", range_n)
    resolution = require_positive("--resolution-um", resolution_um)
    names = parse_channels(channel)
    if is_axis_recording(data, names) or lacks_speeds(data):
        from difffric.commands.first_steps.first_axis import AxisNumbers, write_first_axis

        for option, given in (
            ("--stroke-mm", stroke), ("--sensitivity-mv-per-n", sensitivity), ("--range-n", most)
        ):  # fmt: skip
            if given is not None:
                raise InputError(f"{option} is for pushes only: {data} is the recording of an axis")
        of_axis = AxisNumbers(mass, gain_n_per_v, resolution)
        text, words = write_first_axis(data, of_axis, names, skip_bad)
    else:
        from difffric.commands.first_steps.first_setup import FirstNumbers, write_first_setup

        if gain_n_per_v is not None:
            raise InputError(f"--gain-n-per-v is for an axis only: {data} holds pushes")
        of_rig = FirstNumbers(mass, stroke, sensitivity, most, resolution)
        text, words = write_first_setup(data, of_rig, names, skip_bad)
    write_whole(to, lambda file: file.write(text.encode()))
    console = open_console()
    console.print(words)
    console.print(f"written to {to}; next: difffric check {data} --setup {to}", soft_wrap=True)
