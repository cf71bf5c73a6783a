"""What the columns of a table hold: numbers, texts, or nothing at all."""

from __future__ import annotations

import re
from collections.abc import Sequence

from difffric.number_text import MISSING

_NUMBER = re.compile(r"[<>≤≥≈±+\-−]?\s*[\d.]*\d")
"""How a cell with a number begins."""


def is_missing(cell: str) -> bool:
    """Whether a cell says nothing."""
    return cell.strip() in ("", MISSING)


def holds_numbers(cells: Sequence[str]) -> bool:
    """Whether most of the cells that say something begin with a number."""
    said = [cell for cell in cells if not is_missing(cell)]
    return 2 * sum(bool(_NUMBER.match(cell.strip())) for cell in said) > len(said)


def leave_out_empty(
    columns: Sequence[str], rows: Sequence[Sequence[str]]
) -> tuple[list[str], list[list[str]]]:
    """Return the columns and rows without columns that say nothing; the first column stays."""
    kept = [
        j
        for j in range(len(columns))
        if j == 0 or not rows or not all(is_missing(row[j]) for row in rows)
    ]
    return [columns[j] for j in kept], [[row[j] for j in kept] for row in rows]
