"""A first set-up as text: tables with a comment beside each number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from difffric.name_text import make_printable

Line = tuple[str, str, str]
"""Key, value and comment."""


def format_tables(tables: Mapping[str, Sequence[Line]], data: Path) -> str:
    """Return the text of a set-up that was made for a file; tables without lines are left out."""
    out = [
        f"# A first set-up for {make_printable(data.name)}, by difffric init:",
        "# numbers to start a fit from.",
        "# What each means and what else may stand here: docs/formats.md.",
    ]
    for name, entries in tables.items():
        if entries:
            rows = [f"{f'{key} = {value}':<29} # {words}" for key, value, words in entries]
            out += ["", f"[{name}]", *rows]
    return "\n".join(out) + "\n"
