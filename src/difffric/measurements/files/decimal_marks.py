"""Decimal points and decimal commas, with thousands marks where they are beyond doubt."""

from __future__ import annotations

import re
from collections.abc import Iterable

_BLANKS = " \u00a0\u2009\u202f'’"  # that group digits by thousands, and are never decimal marks
_GROUPED = re.compile(rf"([+-]?\d{{1,3}})(?:[{_BLANKS}]\d{{3}})+(?!\d)")
_TENTATIVE = re.compile(r"[+-]?(\d*)([.,])(\d*)((?:[.,]\d*)*)(?:[eE][+-]?\d{1,4})?")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?", re.ASCII)
_TWO_POINTS = re.compile(r"\.[^.\n]*\.")
_GROUP = 3
"""Digits between two thousands marks."""


def is_number_in_any_way(cell: str) -> bool:
    """Whether a cell is a number with a decimal point or with a decimal comma."""
    return write_with_point(cell, ".") is not None or write_with_point(cell, ",") is not None


def find_decimal_mark(cells: Iterable[str | None], default: str | None) -> str | None:
    """The decimal mark of a file by the numbers in it, `.` or `,`.

    A mark tells itself by what stands around it: `30,5` and `0,125` have a decimal comma,
    `1.234,5` too, `1.234` may be either. Where all are of the last kind the mark that there is is
    the decimal one, if that is a point; a comma, only where `default` says so. Where some cells
    tell one mark and some the other, the one of the most.

    Returns None where nothing tells: numbers such as `1,234` alone with no default, or together
    with `5.678`. `.` where there is no mark at all.
    """
    cells = [cell for cell in cells if cell]
    whole = "\n".join(cells)
    if "," not in whole and not _TWO_POINTS.search(whole):
        return (
            "."  # as nearly all files are: a look at each number would take as long as to read it
        )
    told = {".": 0, ",": 0}
    doubtful = set()
    for cell in cells:
        if "." not in cell and "," not in cell:
            continue
        mark = _read_mark(cell)
        if mark in told:
            told[mark] += 1
        elif mark:
            doubtful.add(mark[1])
    if told["."] or told[","]:
        return "," if told[","] > told["."] else "."
    if doubtful == {".", ","}:
        return None
    return default if doubtful == {","} else "."


def _read_mark(cell: str) -> str:
    """The decimal mark that a number tells; `?.` or `?,` where it may be one of thousands as
    well; empty where it is no number."""
    found = _TENTATIVE.fullmatch(_join_groups(cell))
    if not found:
        return ""
    before, mark, after, more = found.groups()
    if more:
        last = max(more.rfind("."), more.rfind(","))
        if more[last] != mark:
            return more[last]
        return "." if mark == "," else ","  # 1.234.567
    in_groups = len(after) == _GROUP and 0 < len(before) <= _GROUP and before[0] != "0"
    return f"?{mark}" if in_groups else mark


def write_with_point(cell: str, mark: str) -> str | None:
    """The number of a cell with a decimal point and no thousands marks, as `Decimal` reads it;
    None where it is not a number whose decimal mark is `mark`."""
    plain = _join_groups(cell)
    other = "," if mark == "." else "."
    if other in plain:
        whole, point, rest = plain.partition(mark)
        groups = whole.lstrip("+-").split(other)
        fit = all(len(x) == _GROUP for x in groups[1:]) and 0 < len(groups[0]) <= _GROUP
        if not fit or other in rest or groups[0][0] == "0":
            return None
        plain = whole.replace(other, "") + point + rest
    plain = plain.replace(mark, ".")
    return plain if _NUMBER.fullmatch(plain) else None


def _join_groups(cell: str) -> str:
    """The cell without blanks and apostrophes between groups of three digits, its minus ASCII."""
    plain = cell.replace("−", "-")
    if any(blank in plain for blank in _BLANKS):
        return _GROUPED.sub(lambda found: re.sub(rf"[{_BLANKS}]", "", found[0]), plain)
    return plain
