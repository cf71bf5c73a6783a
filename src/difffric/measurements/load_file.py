"""Measured data of either kind: tables and recordings."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from difffric.errors import InputError
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings

_TABLES = (".csv", ".tsv", ".txt", ".xlsx")
_INSTEAD = {
    ".mat": "in MATLAB, writetable(T, 'pushes.csv') writes one",
    ".xls": "save it as .csv (CSV UTF-8)",
    ".ods": "save it as .csv (CSV UTF-8)",
    ".tdms_index": "an index file, expected the .tdms file beside it",
}
"""What to do with files of other kinds that people have."""


def load(
    path: str | os.PathLike, *, skip_bad: bool = False, channels: Mapping[str, str] | None = None
) -> Pushes | Recordings:
    """Measured pushes: a table (`.csv`, `.tsv`, `.txt`, `.xlsx`) gives `Pushes`, recordings
    (`.tdms`) give `Recordings`.

    `channels`: a name in the file by ours, where they differ, such as `{"force": "Kraft"}`. What
    was converted is told in `.notes`. With `skip_bad` what cannot be used is left out and told in
    `.skipped`. Raises `InputError` naming all that is wrong, by line and column, or by group and
    channel.
    """
    suffix = Path(path).suffix.lower()
    if suffix in _TABLES:
        from difffric.measurements.files.table_csv import read_table

        return read_table(path, skip_bad=skip_bad, channels=channels)
    if suffix == ".tdms":
        from difffric.measurements.files.tdms_reader import read_recordings

        return read_recordings(path, skip_bad=skip_bad, channels=channels)
    instead = f": {_INSTEAD[suffix]}" if suffix in _INSTEAD else ""
    raise InputError(
        f"{path}: expected a table (.csv) or recordings (.tdms), got {suffix or 'no suffix'}"
        f"{instead}"
    )
