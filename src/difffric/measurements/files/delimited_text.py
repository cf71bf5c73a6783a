"""Text of cells between separators, as spreadsheets and loggers write it, taken apart.

Separators, encoding, comments, a row of units: found from the text itself, and told where they
are not the usual ones. What the columns mean is `named_columns`' part.
"""

from __future__ import annotations

import codecs
import csv
import io
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass

from difffric.atomic_files import read_bytes
from difffric.errors import InputError
from difffric.measurements.files.decimal_marks import is_number_in_any_way
from difffric.units import find_unit

SEPARATORS = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", " ": "blanks"}
"""What may stand between cells, with its name; the first that the top line has is it."""

_MARKS = (  # the longer ones first: UTF-16's mark begins that of UTF-32
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_OTHERS = (
    (b"PK\x03\x04", "an Excel workbook (or another archive), not text: save it as CSV"),
    (b"\xd0\xcf\x11\xe0", "an Excel workbook of the old kind, not text: save it as CSV"),
    (b"TDSm", "a TDMS file, not text: give it the suffix .tdms"),
    (b"MATLAB", "a MATLAB file, not text: in MATLAB, writetable(T, 'pushes.csv') writes one"),
    (b"\x89HDF", "an HDF5 file, not text: save it as CSV"),
    (b"\x89PNG", "a picture, not text"),
    (b"%PDF", "a PDF, not text: export the table as CSV"),
)
_LOOKED_AT = 4096
"""Bytes, or lines, that tell what kind of text it is."""


@dataclass(frozen=True)
class DelimitedText:
    """A text's cells, blanks around them taken off, with the lines that they stand in."""

    header: list[str]
    """the columns' names; `1`, `2`, ... where the text has none"""
    units: list[str]
    """what a row of units below the header says of each column; empty: there is no such row"""
    rows: list[list[str]]
    """as many cells each as the header has"""
    lines: list[int]
    """of each row, from 1"""
    uneven: list[tuple[int, int]]
    """(line, cells) of the rows that are too long or too short"""
    separator: str
    has_header: bool
    notes: tuple[str, ...]
    """what was found that is not the usual, a line each"""


def read_delimited_text(
    path: str | os.PathLike, expected: str = "a header and rows"
) -> DelimitedText:
    """Take a file of cells apart; `expected` says what a message is to ask for where it is empty.

    Raises `InputError` where the file cannot be read, is no text, or holds nothing.
    """
    text, notes = decode_text(read_bytes(path), path)
    return split_text(text, path, expected, notes)


def decode_text(data: bytes, path: str | os.PathLike) -> tuple[str, list[str]]:
    """(the text of a file's bytes, notes): UTF-8, UTF-16 or UTF-32 by its mark, else UTF-8, else
    Windows' Latin-1, which is told. Raises `InputError` for what is no text."""
    for start, what in _OTHERS:
        if data.startswith(start):
            raise InputError(f"{path}: {what}")
    codec = next((name for mark, name in _MARKS if data.startswith(mark)), None)
    if codec is None and b"\0" in data:
        head = data[:_LOOKED_AT]
        halves = {"utf-16-le": head[1::2].count(0), "utf-16-be": head[0::2].count(0)}
        codec = max(halves, key=lambda name: halves[name])
        if 4 * halves[codec] < len(head):  # half of it at least would be zeros, of most texts all
            raise InputError(f"{path}: not text: expected a table as CSV (bytes that are zero)")
    try:
        return data.decode(codec or "utf-8"), []
    except UnicodeDecodeError as error:
        if codec is not None:
            line = data.count(b"\n", 0, error.start) + 1
            name = codec.removesuffix("-sig").upper()
            raise InputError(
                f"{path}: line {line} is not the {name} that the file begins with: save it as "
                "CSV UTF-8"
            ) from None
    line = next(i for i, one in enumerate(data.split(b"\n"), 1) if not _is_utf_8(one))
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text, [f"line {line} is not UTF-8: read as Latin-1 (Windows)"]


def _is_utf_8(line: bytes) -> bool:
    try:
        line.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def split_text(
    text: str,
    path: str | os.PathLike,
    expected: str = "a header and rows",
    notes: Sequence[str] = (),
) -> DelimitedText:
    """The cells of a text.

    Raises `InputError` where it is empty or its quotes do not close.
    """
    text, skipped, separator, remark = _take_off_head(text)
    separator = separator or find_separator(text)
    rows = _split_rows(text, separator, skipped, path)
    if not rows:
        raise InputError(f"{path}: empty, expected {expected}")
    return arrange_rows(rows, separator, notes, _split_cells(remark, separator))


def arrange_rows(
    rows: list[tuple[int, list[str]]],
    separator: str,
    notes: Sequence[str] = (),
    remark: Sequence[str] = (),
) -> DelimitedText:
    """Rows (line, cells), of which none is empty, as header, units and the rest; `remark`: what a
    comment above them says, which is the header where the first row holds numbers."""
    rows = [*rows]
    top = [cell for cell in rows[0][1] if cell]
    has_header = 2 * sum(map(is_number_in_any_way, top)) < len(top)
    if has_header:
        _, header = rows.pop(0)
    else:
        header = [*remark]
        has_header = len(header) == len(rows[0][1]) > 1
        if not has_header:
            header = [str(i + 1) for i in range(len(rows[0][1]))]
    while header and not header[-1] and not any(any(c[len(header) - 1 :]) for _, c in rows):
        header.pop()  # an empty column to the right of all others
    units = _take_units(header, rows)
    n, good, uneven = len(header), [], []
    for line, cells in rows:
        while len(cells) > n and not cells[-1]:
            cells.pop()
        if len(cells) == n:
            good.append((line, cells))
        else:
            uneven.append((line, len(cells)))
    said = [] if has_header else ["no header: the columns are called 1, 2, ..."]
    return DelimitedText(
        header,
        units,
        [cells for _, cells in good],
        [line for line, _ in good],
        uneven,
        separator,
        has_header,
        (*notes, *said),
    )


def find_separator(text: str) -> str:
    """What stands between a text's cells, by its first line outside of quotes; a comma where
    nothing does."""
    lines = [line for line in text.split("\n", _LOOKED_AT)[:_LOOKED_AT] if line.strip()]
    if not lines:
        return ","
    top = re.sub(r'"[^"]*"', "", lines[0])
    for mark in "\t;,|":
        if mark in top:
            return mark
    counts = {len(line.split()) for line in lines}
    numbers = all(is_number_in_any_way(cell) for line in lines[1:] for cell in line.split())
    return " " if len(counts) == 1 and counts != {1} and numbers else ","


def _take_off_head(text: str) -> tuple[str, int, str | None, str]:
    """(the text below its comments and Excel's `sep=;`, how many lines were taken off, what that
    says, the last comment)."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    skipped, separator, remark = 0, None, ""
    while text:
        line, _, rest = text.partition("\n")
        bare = line.strip()
        said = re.fullmatch(r' *"?sep=(.|\\t)"? *', line, re.IGNORECASE)
        if said:
            separator = said[1].replace("\\t", "\t")
        elif bare.startswith(("#", "%")):
            remark = bare.lstrip("#% ")
        elif bare:
            break
        skipped, text = skipped + 1, rest
    return text, skipped, separator, remark


def _split_rows(
    text: str, separator: str, skipped: int, path: str | os.PathLike
) -> list[tuple[int, list[str]]]:
    """(line, cells) of each row that is not empty."""
    if separator == " ":
        lines = enumerate(text.split("\n"), skipped + 1)
        return [(i, line.split()) for i, line in lines if line.strip()]
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    rows, line = [], skipped + 1
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                rows.append((line, [cell.strip() for cell in cells]))
            line = skipped + reader.line_num + 1
    except csv.Error as error:
        where = f"{path}: line {skipped + reader.line_num}"
        hint = ": a quote that does not close?" if '"' in text else ""
        raise InputError(f"{where}: not a table: {error}{hint}") from None
    return rows


def _split_cells(line: str, separator: str) -> list[str]:
    """The cells of one line without quotes."""
    cells = line.split() if separator == " " else line.split(separator)
    return [cell.strip() for cell in cells]


def _take_units(header: list[str], rows: list[tuple[int, list[str]]]) -> list[str]:
    """The units of a row below the header that holds nothing else, which is taken off."""
    if not rows or len(rows[0][1]) < len(header):
        return []
    cells = [cell.strip("[]()") for cell in rows[0][1][: len(header)]]
    if not any(map(find_unit, cells)) or not all(
        cell in ("", "-", "1") or find_unit(cell) for cell in cells
    ):
        return []
    rows.pop(0)
    return cells
