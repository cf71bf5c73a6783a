"""Tables (`.csv`) of a ring's probe readings over a rotation: read, with all problems named, and
written.

A row a reading: `angle_deg`, and `radius_mm` or `reading_um`, the deviation from the nominal
radius. An empty cell, or `nan`, is a missing sample.
"""

from __future__ import annotations

import csv
import io
import os

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.atomic_files import read_bytes, write_whole
from difffric.errors import InputError
from difffric.measurements.quantities import join_problems, parse_decimal
from difffric.units import from_mm, from_um, to_mm

_ANGLE, _RADIUS, _READING = "angle_deg", "radius_mm", "reading_um"


def load_ring(path: str | os.PathLike, radius: float | None = None) -> tuple[NDArray, NDArray]:
    """Read the angle [rad] and radius [m] of each reading, (n,) each; NaN where one is missing.

    `radius` is the nominal one [m], which `reading_um` counts from; a table of `radius_mm` does not
    need it.

    Raises `InputError` naming what is wrong with the file, by line and column.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected text in UTF-8") from None
    try:
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        rows = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader]
    except csv.Error as error:
        raise InputError(f"{path}: expected a table of cells between commas: {error}") from None
    rows = [(line, cells) for line, cells in rows if any(cells)]
    header = rows[0][1] if rows else []
    missing = [name for name in (_ANGLE,) if name not in header]
    has = [name for name in (_RADIUS, _READING) if name in header]
    if missing or len(has) != 1 or len(set(header)) < len(header):
        got = ", ".join(header) or "nothing"
        raise InputError(
            f"{path}: expected the columns {_ANGLE} and either {_RADIUS} or {_READING}, got {got}"
        )
    if has == [_READING] and radius is None:
        raise InputError(
            f"{path}: {_READING} is a deviation from the nominal radius, which is not said; give "
            "--radius-mm"
        )
    problems, columns = [], []
    for name in (_ANGLE, has[0]):
        at, column = header.index(name), []
        for line, cells in rows[1:]:
            cell = cells[at] if at < len(cells) else ""
            value = parse_decimal(cell)
            if len(cells) > len(header) and name == _ANGLE:
                problems.append((line, f"{len(cells)} cells, expected {len(header)}"))
            elif value is None and cell.lower() not in ("", "nan"):
                problems.append((line, f"{name}: expected a number, got {cell!r}"))
            elif name == _RADIUS and value is not None and value <= 0:
                problems.append((line, f"{name}: expected a number > 0, got {cell}"))
            column.append(np.nan if value is None else float(value))
        columns.append(np.array(column, float))
    if problems:
        lines = [f"{path}: line {line}: {what}" for line, what in sorted(problems)]
        raise InputError(join_problems(lines))
    angle, measured = np.radians(columns[0]), columns[1]
    if has == [_RADIUS]:
        return angle, from_mm(measured)
    return angle, float(radius or 0.0) + from_um(measured)


def write_ring(path: str | os.PathLike, angle: ArrayLike, radius: ArrayLike) -> None:
    """Write readings, `angle` [rad] and `radius` [m], as a table; NaN is an empty cell."""
    lines = [f"{_ANGLE},{_RADIUS}"]
    for a, r in zip(np.degrees(angle), to_mm(np.asarray(radius, float)), strict=True):
        lines.append(",".join("" if np.isnan(x) else repr(float(x)) for x in (a, r)))
    text = "\n".join([*lines, ""])
    write_whole(path, lambda file: file.write(text.encode()))
