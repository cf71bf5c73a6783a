"""Measured data of either kind: tables and recordings."""

from __future__ import annotations

import os
from pathlib import Path

from difffric.errors import InputError
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings


def load(path: str | os.PathLike, *, skip_bad: bool = False) -> Pushes | Recordings:
    """Measured pushes: a table (`.csv`) gives `Pushes`, recordings (`.tdms`) `Recordings`.

    With `skip_bad` what cannot be used is left out and told in `.skipped`. Raises `InputError`
    naming all that is wrong, by line and column, or by group and channel.
    """
    suffix = Path(path).suffix.lower() or "no suffix"
    if suffix == ".csv":
        from difffric.measurements.files.table_csv import read_table

        return read_table(path, skip_bad=skip_bad)
    if suffix == ".tdms":
        from difffric.measurements.files.tdms_reader import read_recordings

        return read_recordings(path, skip_bad=skip_bad)
    raise InputError(
        f"{path}: expected a table (.csv) or recordings (.tdms), got {suffix or 'no suffix'}"
    )
