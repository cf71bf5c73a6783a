"""Tables of measured pushes, `.csv`: read with all their problems named at once, and written.

A row a push; a column a quantity, whose name carries its unit (`velocity_mm_min`). An empty cell
was not measured.
"""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Sequence
from decimal import Decimal
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.atomic_files import read_bytes, write_whole
from difffric.errors import InputError
from difffric.measurements.pushes import Pushes
from difffric.measurements.quantities import (
    QUANTITIES,
    PushQuantity,
    describe_unknown,
    join_problems,
    parse_decimal,
    shorten_to_line,
)

BY_KEY = {q.key: q for q in QUANTITIES}
_TEN_TO = np.array([float(f"1e{n}") for n in range(23)])  # exact
_MANY = 2000
"""Rows from which polars, whose import takes as long as to read so many, is the faster."""
_COMMA = "is a comma meant as the decimal point? expected a decimal point, and commas between cells"


def read_table(path: str | os.PathLike, *, skip_bad: bool = False) -> Pushes:
    """The pushes (or free slides) of a table, SI units.

    With `skip_bad` rows that cannot be used are left out and told in `Pushes.skipped`. Raises
    `InputError` naming all that is wrong with the file, by line and column.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: expected text in UTF-8, line {line} is not") from None
    header, table, problems = _split(text, path)
    wrong = _column_problems(header)
    if wrong:
        raise InputError(join_problems([f"{path}: {problem}" for problem in wrong]))
    columns: dict[str, Any] = {}
    for name in header:
        columns[BY_KEY[name].attribute], bad = _read_column(table, BY_KEY[name])
        problems += bad
    problems += _find_unsaid(table)
    lines = [f"{path}: line {problem}" for _, problem in sorted(problems, key=lambda p: p[0])]
    bad_lines = {line for line, _ in problems}
    if lines and not skip_bad:
        raise InputError(join_problems(lines))
    keep = [i for i, line in enumerate(table.lines) if line not in bad_lines]
    if not keep:
        what = "no row of it can be used" if lines else "no rows below the header: expected pushes"
        raise InputError(join_problems([f"{path}: {what}", *lines]))
    used: dict[str, Any] = {k: [x[i] for i in keep] for k, x in columns.items()}
    return Pushes(**used, source=str(path), skipped=tuple(map(shorten_to_line, lines)))


def write_table(pushes: Pushes, path: str | os.PathLike) -> None:
    """Write a table that reads as the same pushes, to the last digit.

    Columns that nobody measured are left out. The file appears whole or not at all. Raises
    `InputError` where the format cannot say it (a condition that is more than a line, or begins
    or ends with a space), and where the path cannot be written.
    """
    columns: dict[str, list[str | None]] = {}
    for q in QUANTITIES:
        values = getattr(pushes, q.attribute)
        if q.range is None:
            for text in values:
                if text != text.strip() or not (text.isprintable() or text == ""):
                    raise InputError(f"{path}: the condition {text!r} cannot be in a table")
            cells = [text or None for text in values]
        else:
            cells = [None if math.isnan(x) else q.from_si(float(x)) for x in values]
        if any(cell is not None for cell in cells):
            columns[q.key] = cells
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    write_whole(path, lambda file: file.write(text.getvalue().encode()))


class _TableText(NamedTuple):
    """The cells of a table as text, None where empty, a column a name; and the line of each row."""

    columns: dict[str, list[str | None]]
    lines: list[int]


def _split(text: str, path) -> tuple[list[str], _TableText, list[tuple[int, str]]]:
    """(header, cells, rows that are too long or too short)."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[tuple[int, list[str]]] = []
    line = 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                rows.append((line, [cell.strip() for cell in cells]))
            line = reader.line_num + 1
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: not a table: {error}") from None
    if not rows:
        raise InputError(f"{path}: empty, expected a header and a row for each push")
    head_line, header = rows.pop(0)
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and mark in header[0]:
            raise InputError(
                f"{path}: line {head_line}: the columns are separated by {name}, "
                "expected commas (and decimal points)"
            )
    n, problems, good = len(header), [], []
    for line, cells in rows:
        while len(cells) > n and not cells[-1]:  # an empty column to the right of all others
            cells.pop()
        if len(cells) == n:
            good.append((line, cells))
            continue
        hint = f": {_COMMA}" if len(cells) > n else ""
        problems.append((line, f"{line}: {len(cells)} cells, expected {n}{hint}"))
    # Names may be doubled: that is told before a column is read.
    columns = {name: [cells[i] or None for _, cells in good] for i, name in enumerate(header)}
    return header, _TableText(columns, [line for line, _ in good]), problems


def _column_problems(header: list[str]) -> list[str]:
    problems = [
        f"column {name} stands there {header.count(name)} times, expected once"
        for name in dict.fromkeys(header)
        if header.count(name) > 1
    ]
    for i, name in enumerate(header):
        if not name:
            problems.append(f"column {i + 1} has no name")
        elif name not in BY_KEY:
            problems.append(f"column {name}: {describe_unknown(name, QUANTITIES)}")
    slides = "release_velocity_mm_min" in header and "sliding_distance_um" in header
    if "velocity_mm_min" not in header and not slides:
        problems.append(
            "column velocity_mm_min is missing (or, for free slides, release_velocity_mm_min "
            "and sliding_distance_um)"
        )
    if not {"peak_force_N", "sliding_distance_um"} & set(header):
        problems.append(
            "column peak_force_N or sliding_distance_um is missing, expected at least one"
        )
    return problems


def _read_column(table: _TableText, q: PushQuantity) -> tuple[list, list[tuple[int, str]]]:
    """The values [SI] of a column, NaN (or "") where not measured; and the cells that are wrong."""
    cells = table.columns[q.key]
    if q.range is None:
        return [cell or "" for cell in cells], []
    values, problems = np.full(len(cells), np.nan), []
    if len(cells) >= _MANY:
        values = parse_plain_cells(cells, q)
        values = np.where(q.range.holds(values), values, np.nan)
    for i in np.flatnonzero(np.isnan(values)):
        cell, line = cells[i], table.lines[i]
        if cell is None:
            continue
        number = parse_decimal(cell)
        value = math.nan if number is None else q.to_si(number)
        if math.isfinite(value) and q.range.holds(value):
            values[i] = value
            continue
        comma = (
            f" ({_COMMA})" if number is None and parse_decimal(cell.replace(",", ".", 1)) else ""
        )
        problems.append(
            (line, f"{line}, {q.key}: {q.range.describe_expected(value)}, got {cell!r}{comma}")
        )
    return values.tolist(), problems


def parse_plain_cells(texts: Sequence[str | None], q: PushQuantity) -> NDArray:
    """(n,) the values [SI] of decimals of at most 15 digits, each as by `to_si`; NaN for others.

    Digits over a power of ten, both exact as floats, so that only the quotient is rounded.
    """
    import polars as pl

    cells = pl.Series(texts, dtype=pl.String)
    digits = cells.str.replace(".", "", literal=True)
    plain = cells.str.contains(r"^\d+(\.\d+)?$") & (digits.str.len_bytes() <= 15)
    places = (cells.str.len_bytes() - 1 - cells.str.find(".", literal=True)).fill_null(0)
    power = places.cast(pl.Int64).clip(0, 15).to_numpy() - Decimal(q.unit).adjusted()
    value = digits.cast(pl.Float64, strict=False).to_numpy() / (_TEN_TO[power] * q.per)
    return np.where(plain.fill_null(False).to_numpy(), value, np.nan)


def _find_unsaid(table: _TableText) -> list[tuple[int, str]]:
    """Rows that name no speed at all."""
    names = ("velocity_mm_min", "release_velocity_mm_min")
    speeds = [name for name in names if name in table.columns]
    said = zip(table.lines, *(table.columns[name] for name in speeds), strict=True)
    return [
        (line, f"{line}, {speeds[0]}: empty, expected a number > 0")
        for line, *cells in said
        if not any(cells)
    ]
