"""Tables of measured pushes, `.csv`: read with all their problems named at once, and written.

A row a push; a column a quantity, whose name carries its unit (`velocity_mm_min`). An empty cell
was not measured. `named_columns` knows the ways in which spreadsheets write that.
"""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping, Set
from typing import Any

import numpy as np

from difffric.atomic_files import write_whole
from difffric.errors import InputError
from difffric.measurements.files.named_columns import NamedColumns, read_columns
from difffric.measurements.pushes import Pushes
from difffric.measurements.quantities import QUANTITIES, join_problems, shorten_to_line


def read_table(
    path: str | os.PathLike, *, skip_bad: bool = False, channels: Mapping[str, str] | None = None
) -> Pushes:
    """The pushes (or free slides) of a table, SI units.

    Cells may stand between commas, semicolons or tabs, numbers have decimal points or commas, and
    columns other units than the contract's, told in `Pushes.notes`. `channels`: a column's name by
    ours, where they differ. With `skip_bad` what cannot be used is left out, a row or a column that
    is unknown, and told in `Pushes.skipped`.

    Raises `InputError` naming all that is wrong with the file, by line and column.
    """
    columns = read_columns(
        path,
        QUANTITIES,
        find_needed=_find_needed,
        channels=channels,
        pass_over=skip_bad,
        expected="a header and a row for each push",
    )
    problems = columns.problems + _find_unsaid(columns)
    lines = [f"{path}: line {problem}" for _, problem in sorted(problems, key=lambda p: p[0])]
    bad_lines = {line for line, _ in problems}
    if lines and not skip_bad:
        raise InputError(join_problems(lines))
    keep = [i for i, line in enumerate(columns.lines) if line not in bad_lines]
    if not keep:
        what = "no row of it can be used" if lines else "no rows below the header: expected pushes"
        raise InputError(join_problems([f"{path}: {what}", *lines]))
    used: dict[str, Any] = {k: [x[i] for i in keep] for k, x in columns.values.items()}
    unknown = [f"{path}: column {name}: unknown" for name in columns.passed_over]
    left_out = tuple(map(shorten_to_line, [*unknown, *lines]))
    return Pushes(**used, source=str(path), skipped=left_out, notes=columns.notes)


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


def _find_needed(found: Set[str]) -> list[tuple[str, ...]]:
    """What a table of pushes needs, or, where it has them, a table of free slides."""
    if {"release_velocity", "sliding_distance"} <= found:
        return []
    return [("velocity",), ("peak_force", "sliding_distance")]


def _find_unsaid(columns: NamedColumns) -> list[tuple[int, str]]:
    """Rows that name no speed at all."""
    speeds = [name for name in ("velocity", "release_velocity") if name in columns.values]
    empty = np.all([np.isnan(columns.values[name]) for name in speeds], axis=0)
    heading = columns.headings[speeds[0]]
    said = {line for line, problem in columns.problems if heading in problem}
    return [
        (line, f"{line}, {heading}: empty, expected a number > 0")
        for line, unsaid in zip(columns.lines, empty.tolist(), strict=True)
        if unsaid and line not in said
    ]
