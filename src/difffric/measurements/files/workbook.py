"""The first sheet of an Excel workbook, `.xlsx`, as the cells of a text.

It needs `fastexcel`, which polars reads workbooks by: `pip install difffric[xlsx]`.
"""

from __future__ import annotations

import os
from importlib.util import find_spec

from difffric.atomic_files import read_bytes
from difffric.errors import InputError
from difffric.measurements.files.delimited_text import DelimitedText, arrange_rows


def read_workbook(path: str | os.PathLike, expected: str = "a header and rows") -> DelimitedText:
    """Take the first sheet of a workbook apart; `expected` says what a message is to ask for.

    Raises `InputError` where it cannot be read, holds nothing, or `fastexcel` is not installed.
    """
    if find_spec("fastexcel") is None:
        raise InputError(
            f"{path}: expected a table (.csv) or recordings (.tdms), got .xlsx: save the sheet as "
            "CSV UTF-8, or pip install 'difffric[xlsx]', which reads it"
        )
    import polars as pl

    data = read_bytes(path)
    try:
        # Without a schema each cell is a text, as it stands in a CSV.
        sheet = pl.read_excel(data, has_header=False, infer_schema_length=0, drop_empty_rows=False)
    except Exception as error:  # calamine has several of its own, as its reader goes
        words = " ".join(str(error).split())
        raise InputError(f"{path}: not an Excel workbook, or an empty one: {words}") from None
    rows = [
        (i, [(cell or "").strip() for cell in cells]) for i, cells in enumerate(sheet.rows(), 1)
    ]
    rows = [(line, cells) for line, cells in rows if any(cells)]
    if not rows:
        raise InputError(f"{path}: empty, expected {expected}")
    return arrange_rows(rows, ";")
