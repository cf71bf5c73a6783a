"""`difffric ring`: the report of a measured ring."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from difffric.centering.ring import Ring
from difffric.commands import figures
from difffric.commands.reports.page import Picture, Report, Section, Table
from difffric.number_text import format_pair
from difffric.units import to_mm, to_um


def report_ring(ring: Ring, angle: NDArray, radius: NDArray, pictures: bool = True) -> Report:
    """Return the report of a ring that was measured at angles (n,) [rad] and radii (n,) [m]."""
    rows = [
        ["offset [µm]", *format_pair(to_um(ring.offset), to_um(ring.offset_se))],
        ["direction [degrees]", *format_pair(*np.degrees([ring.direction, ring.direction_se]))],
        ["x [µm]", *format_pair(to_um(ring.x), to_um(ring.covariance[0, 0] ** 0.5))],
        ["y [µm]", *format_pair(to_um(ring.y), to_um(ring.covariance[1, 1] ** 0.5))],
        ["radius [mm]", *format_pair(to_mm(ring.radius), to_mm(ring.radius_se))],
    ]
    tables = [Table("The ring", ("quantity", "value", "standard error"), rows)]
    lobes = [
        [str(n), *(f"{to_um(v):.3f} ± {to_um(e):.3f}" for v, e in zip(value, se, strict=True))]
        for n, (value, se) in enumerate(zip(ring.lobes, ring.lobes_se, strict=True), 2)
        if (np.abs(value) > 3 * se).any()
    ]
    if lobes:
        columns = ("order", "cos [µm]", "sin [µm]")
        tables.append(Table("Lobes beyond three standard errors", columns, lobes))
    offset, se = format_pair(to_um(ring.offset), to_um(ring.offset_se))
    direction, direction_se = format_pair(*np.degrees([ring.direction, ring.direction_se]))
    n, out = int(np.isfinite(ring.residuals).sum()), len(ring.outliers)
    chi2 = ""
    if ring.reduced_chi2 is not None:
        chi2 = f", and the reduced chi-square {ring.reduced_chi2:.3g}"
    summary = [
        f"The centre is {offset} ± {se} µm off the axis: with the table at {direction} ± "
        f"{direction_se} degrees it lies towards the probe. Push from there towards the axis.",
        f"{n} readings over {np.degrees(ring.arc):.0f} degrees were used; {ring.missing} are "
        f"missing and {out} are outliers. Their noise is {to_um(ring.noise):.3g} µm{chi2}.",
        *(f"Note: {note}." for note in ring.notes),
    ]
    text = []
    if out:
        some = ", ".join(f"{i + 1}" for i in ring.outliers[:20])
        text.append(f"The outliers are the readings {some}{' ...' if out > 20 else ''}.")
    text.append(
        "A deviation of the ring's form with one period per turn cannot be told from an offset."
    )
    shown = []
    if pictures:
        caption = (
            "Left: the deviation from the fitted radius, much enlarged. Right: what the fit "
            "leaves, and the ring's form."
        )
        shown.append(Picture("ring", caption, figures.ring.draw_ring(angle, radius, ring)))
    advice = [
        "Give the same readings to difffric plan --ring: it finds the push that centres the ring."
    ]
    return Report("Ring", summary, [Section("Offset", text, tables, shown)], advice)
