"""The columns of a delimited text as quantities in SI, by their names, units and decimal marks."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.errors import InputError
from difffric.measurements.files.decimal_marks import find_decimal_mark, write_with_point
from difffric.measurements.files.delimited_text import DelimitedText, read_delimited_text
from difffric.measurements.files.workbook import read_workbook
from difffric.measurements.headings import (
    Heading,
    HeadingError,
    ask_for_names,
    find_unknown,
    read_heading,
    resolve_channels,
)
from difffric.measurements.quantities import MeasuredQuantity, join_problems, parse_decimal
from difffric.units import find_unit

_TEN_TO = np.array([float(f"1e{n}") for n in range(23)])  # exact
_MANY = 2000
"""Rows from which polars, whose import takes as long as to read so many, is the faster."""
_COMMA = "is a comma meant as the decimal point? put semicolons between cells, or a decimal point"


@dataclass(frozen=True)
class NamedColumns:
    """The columns of a file: n rows, in SI."""

    values: dict[str, Any]
    """the quantity's attribute -> (n,) numbers, NaN where a cell is empty; of a text a list"""
    lines: list[int]
    """where each row stands in the file, from 1"""
    headings: dict[str, str]
    """the quantity's attribute -> the column's name in the file"""
    problems: list[tuple[int, str]]
    """(line, what is wrong) of cells and rows, such as `7, force [kN]: expected a number`"""
    notes: tuple[str, ...] = ()
    """what was converted or found otherwise than usual, a line each"""
    passed_over: tuple[str, ...] = ()
    """names of columns that are none of the quantities"""


@dataclass
class _Matched:
    """Which column is which quantity."""

    headings: dict[int, Heading] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    strange: list[str] = field(default_factory=list)
    """what is wrong with names that are like none of ours"""
    passed_over: list[str] = field(default_factory=list)
    misnamed: set[str] = field(default_factory=set)
    """attributes of quantities that a name with a fault seems to mean"""


def read_columns(
    path: str | os.PathLike,
    known: Sequence[MeasuredQuantity],
    *,
    find_needed: Callable[[Set[str]], Sequence[Sequence[str]]] = lambda found: (),
    channels: Mapping[str, str] | None = None,
    pass_over: bool = False,
    expected: str = "a header and a row for each sample",
) -> NamedColumns:
    """The columns of a delimited text, or of a workbook, that are quantities of `known`, in SI.

    `find_needed`: what is needed, by what was found: groups of attributes, one of each group.
    `channels`: the column's name by ours, where they differ (`{"force": "Kraft"}`). `pass_over`:
    whether a column is passed over where its name is like none of ours.

    Raises `InputError` where the file is no text or the columns cannot be told; what is wrong with
    cells is in `NamedColumns.problems`.
    """
    is_workbook = os.fspath(path).lower().endswith(".xlsx")
    text = (read_workbook if is_workbook else read_delimited_text)(path, expected)
    matched = _match(text, known, channels or {}, pass_over)
    missing = _find_missing(text, matched, known, find_needed)
    problems = [*missing, *matched.problems]
    if not (pass_over or missing):
        problems += [f"{one}; --skip-bad passes it over" for one in matched.strange]
    if problems:
        raise InputError(join_problems([f"{path}: {problem}" for problem in problems]))
    mark, doubt = _choose_mark(text, matched)
    wrong = [(line, _describe_length(text, line, n)) for line, n in text.uneven]
    values: dict[str, Any] = {}
    notes = [*text.notes, *_list_notes(matched)]
    grouped: list[str] = []
    numeric = [i for i, h in matched.headings.items() if h.quantity.range is not None]
    bare = _BareNumbers(text, numeric)
    for i, heading in matched.headings.items():
        q, cells = heading.quantity, [row[i] or None for row in text.rows]
        plain = cells if q.range is None else _write_plain(cells, mark, bare, grouped)
        read, bad = _read_cells(plain, cells, text.lines, q, doubt)
        values[q.attribute] = read
        wrong += bad
    if mark == ",":
        notes.append("numbers have decimal commas")
    if grouped:
        notes.append(f"thousands marks are taken out, as in {grouped[0]} ({len(grouped)} in all)")
    names = {h.quantity.attribute: h.quantity.key for h in matched.headings.values()}
    return NamedColumns(
        values, text.lines, names, sorted(wrong), tuple(notes), tuple(matched.passed_over)
    )


def _match(
    text: DelimitedText,
    known: Sequence[MeasuredQuantity],
    channels: Mapping[str, str],
    pass_over: bool,
) -> _Matched:
    meanings, problems = resolve_channels(channels, text.header, known)
    found = _Matched(problems=[*find_unknown(channels, known), *problems])
    for name in dict.fromkeys(text.header):
        if name and text.header.count(name) > 1:
            times = text.header.count(name)
            found.problems.append(f"column {name} stands there {times} times, expected once")
    taken: dict[str, str] = {}
    doubtful: list[tuple[str | None, str, str]] = []
    units = text.units or [""] * len(text.header)
    for i, (name, unit) in enumerate(zip(text.header, units, strict=True)):
        if not name and pass_over:
            continue
        if not name:
            found.problems.append(f"column {i + 1} has no name")
            continue
        if not text.has_header and name not in meanings:
            found.passed_over.append(name)
            continue
        try:
            heading = read_heading(name, known, unit, meanings.get(name, ""))
        except HeadingError as error:
            words = f"column {name}: {error}"
            if error.near is None and name not in meanings:
                found.passed_over.append(name)
                found.strange.append(words)
            else:
                doubtful.append((None if name in meanings else error.near, name, words))
            continue
        attribute = heading.quantity.attribute
        if attribute in taken and taken[attribute] != name:
            found.problems.append(f"column {name}: {taken[attribute]} is that already")
        taken[attribute] = name
        found.headings[i] = heading
    for near, name, words in doubtful:
        if pass_over and near in taken:
            found.passed_over.append(name)  # alike by chance: `position_set` beside `position`
            continue
        found.problems.append(words)
        found.misnamed |= {near} if near else set()
    return found


def _find_missing(
    text: DelimitedText,
    matched: _Matched,
    known: Sequence[MeasuredQuantity],
    find_needed: Callable[[Set[str]], Sequence[Sequence[str]]],
) -> list[str]:
    """The line on columns that are missing; it names those found, and how to say which is which."""
    got = {h.quantity.attribute for h in matched.headings.values()} | matched.misnamed
    by = {q.attribute: q for q in known}
    missing = [[by[name] for name in group] for group in find_needed(got) if not got & set(group)]
    if not missing:
        return []
    said = [f"column {' or '.join(q.key for q in group)} is missing" for group in missing]
    units = text.units or [""] * len(text.header)
    free = [
        (name, unit)
        for i, (name, unit) in enumerate(zip(text.header, units, strict=True))
        if i not in matched.headings
    ]
    asked = ask_for_names(missing, [name for name, _ in free], [unit for _, unit in free])
    found = ", ".join(text.header)
    if not text.has_header:
        found = f"{len(text.header)} without a header"
        asked = asked.replace("=NAME", "=NUMBER")
    remedy = f": say which is which, with {asked}" if free else ""
    return [f"{', '.join(said)}; found {found}{remedy}"]


def _list_notes(matched: _Matched) -> list[str]:
    headings = matched.headings.values()
    return [f"column {h.quantity.key}: {h.note}" for h in headings if h.note]


def _choose_mark(text: DelimitedText, matched: _Matched) -> tuple[str | None, str]:
    """(the file's decimal mark, None where it cannot be told; what to say of a cell that is no
    number with it)."""
    numeric = [i for i, h in matched.headings.items() if h.quantity.range is not None]
    default = None if text.separator == "," else ","
    mark = find_decimal_mark((row[i] for row in text.rows for i in numeric), default)
    if mark is None:
        return None, "is its mark one of thousands? write numbers without thousands marks"
    if text.separator == "," and mark == ".":
        return mark, _COMMA
    other, usual = ("point", "commas") if mark == "," else ("comma", "points")
    return mark, f"a {other}, where the rest of the file has decimal {usual}"


def _write_plain(
    cells: list[str | None], mark: str | None, bare: _BareNumbers, grouped: list[str]
) -> list[str | None]:
    """The cells with decimal points, None where they are no numbers; numbers that had thousands
    marks are added to `grouped`.

    A mark that may be one of thousands, as in `1,234` beside `30.5`, is none where the file has
    thousands without: it is a slip then.
    """
    out: list[str | None] = []
    other = "," if mark == "." else "."
    for cell in cells:
        if cell is None or (mark == "." and cell.replace(".", "", 1).isdigit()):
            out.append(cell)
            continue
        if mark is None:
            out.append(None if {".", ","} & set(cell) else write_with_point(cell, "."))
            continue
        plain = write_with_point(cell, mark)
        if plain is not None and cell.count(other) == 1 and mark not in cell and bare.have_large:
            plain = None
        if plain is not None and other in cell:
            grouped.append(cell)
        out.append(plain)
    return out


class _BareNumbers:
    """Numbers of a file as they stand there: looked through when that is asked for."""

    def __init__(self, text: DelimitedText, numeric: list[int]):
        self._text, self._numeric = text, numeric

    @cached_property
    def have_large(self) -> bool:
        """Whether one of them has four digits in a row before its decimal mark."""
        cells = (row[i] for row in self._text.rows for i in self._numeric)
        return any(re.match(r"[+-]?[1-9]\d{3}", cell) for cell in cells)


def _describe_length(text: DelimitedText, line: int, n: int) -> str:
    hint = f": {_COMMA}" if n > len(text.header) and text.separator == "," else ""
    return f"{line}: {n} cells, expected {len(text.header)}{hint}"


def _read_cells(
    plain: list[str | None],
    cells: list[str | None],
    lines: list[int],
    q: MeasuredQuantity,
    doubt: str,
) -> tuple[Any, list[tuple[int, str]]]:
    """The values [SI] of a column, NaN (or "") where not measured; and the cells that are wrong."""
    if q.range is None:
        return [cell or "" for cell in cells], []
    values, problems = np.full(len(cells), np.nan), []
    if len(cells) >= _MANY:
        values = parse_plain_cells(plain, q)
        values = np.where(q.range.holds(values), values, np.nan)
    for i in np.flatnonzero(np.isnan(values)):
        cell, exact, line = cells[i], plain[i], lines[i]
        if cell is None:
            continue
        number = None if exact is None else parse_decimal(exact)
        value = math.nan if number is None else q.to_si(number)
        if math.isfinite(value) and q.range.holds(value):
            values[i] = value
            continue
        hint = f" ({_advise(cell, doubt)})" if number is None and _advise(cell, doubt) else ""
        problems.append(
            (line, f"{line}, {q.key}: {q.range.describe_expected(value)}, got {cell!r}{hint}")
        )
    return values, problems


def _advise(cell: str, doubt: str) -> str:
    """What to do about a cell that is no number; empty where that is not plain."""
    first, _, rest = cell.partition(" ")
    if rest and find_unit(rest) and parse_decimal(first.replace(",", ".", 1)):
        return f"numbers only, the unit stands in the heading: NAME [{rest}]"
    is_near = parse_decimal(cell.replace(",", ".", 1)) or parse_decimal(cell.replace(".", "", 1))
    return doubt if is_near else ""


def parse_plain_cells(texts: Sequence[str | None], q: MeasuredQuantity) -> NDArray:
    """(n,) the values [SI] of decimals of at most 15 digits, each as by `to_si`; NaN for others,
    and for all where the unit is no power of ten.

    Digits over a power of ten, both exact as floats, so that only the quotient is rounded.
    """
    import polars as pl

    unit = Decimal(q.unit)
    if unit != Decimal(1).scaleb(unit.adjusted()) or (unit > 1 and q.per > 1):
        return np.full(len(texts), np.nan)
    cells = pl.Series(texts, dtype=pl.String)
    sign = np.where(cells.str.starts_with("-").fill_null(False).to_numpy(), -1.0, 1.0)
    cells = cells.str.strip_prefix("-")
    digits = cells.str.replace(".", "", literal=True)
    plain = cells.str.contains(r"^\d+(\.\d+)?$") & (digits.str.len_bytes() <= 15)
    places = (cells.str.len_bytes() - 1 - cells.str.find(".", literal=True)).fill_null(0)
    power = places.cast(pl.Int64).clip(0, 15).to_numpy() - unit.adjusted()
    value = digits.cast(pl.Float64, strict=False).to_numpy()
    value = value * _TEN_TO[np.maximum(-power, 0)] / (_TEN_TO[np.maximum(power, 0)] * q.per)
    return np.where(plain.fill_null(False).to_numpy(), sign * value, np.nan)
