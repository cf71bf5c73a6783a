"""`difffric ring`: a ring's offset, from probe readings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import difffric as df
from difffric.commands import reports
from difffric.commands.console import check_out, print_and_write
from difffric.commands.options import Out, require_positive
from difffric.errors import InputError
from difffric.units import from_mm, from_um


def ring(
    readings: Annotated[Path, typer.Argument(help="Probe readings, .csv.", show_default=False)],
    radius_mm: Annotated[
        float | None,
        typer.Option(help="Nominal radius of the ring, if the readings are reading_um."),
    ] = None,
    noise_um: Annotated[
        float | None, typer.Option(help="Noise of one reading; estimated by default.")
    ] = None,
    lobes: Annotated[
        int | None,
        typer.Option(help="Highest order of lobes, 1 for none; by default from the readings."),
    ] = None,
    form_um: Annotated[
        float, typer.Option(help="Amplitude of lobes that may stay unseen in the readings.")
    ] = 1.0,
    out: Out = None,
) -> None:
    """Report a ring's offset from the axis and its direction."""
    check_out(out)
    require_positive("--radius-mm", radius_mm)
    require_positive("--noise-um", noise_um)
    if not 0 <= form_um < 1e6:
        raise InputError(f"--form-um: expected a number >= 0, got {form_um:g}")
    nominal = None if radius_mm is None else from_mm(radius_mm)
    angle, radius = df.load_ring(readings, nominal)
    noise = None if noise_um is None else from_um(noise_um)
    try:
        found = df.measure(angle, radius, noise=noise, lobes=lobes, form=from_um(form_um))
    except InputError as error:
        raise InputError(f"{readings}: {error}") from None
    report = reports.ring.report_ring(found, angle, radius, pictures=out is not None)
    print_and_write(report, {"readings_file": str(readings), **found.as_dict()}, out)
