"""A first set-up as text: tables with a comment beside each number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from difffric.name_text import make_printable

Line = tuple[str, str, str]
"""Key, value and comment."""


def format_tables(
    tables: Mapping[str, Sequence[Line]],
    data: Path,
    empty: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """Return the text of a set-up that was made for a file. A table without lines is left out;
    where `empty` names it, the lines given there stand in its place."""
    out = [
        f"# A first set-up for {make_printable(data.name)}, which a fit starts from, "
        "by difffric init.",
        "# docs/formats.md says what each of them means and which others there are.",
    ]
    for name, entries in tables.items():
        if entries:
            rows = [f"{f'{key} = {value}':<29} # {words}" for key, value, words in entries]
            out += ["", f"[{name}]", *rows]
        else:
            out += (empty or {}).get(name, ())
    return "\n".join(out) + "\n"
