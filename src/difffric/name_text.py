"""Names from a user's files as texts for a person: a name is text, whatever stands in it."""

from __future__ import annotations

_END = 6
"""Letters of a long name's end that stay: names of a series differ there."""


def make_printable(text: str) -> str:
    """Return a text on one line, with a blank for what does not print, such as a terminal's
    commands."""
    return "".join(x if x.isprintable() else " " for x in text)


def shorten_name(name: str, most: int) -> str:
    """Return a name on one line of at most so many letters, the middle of a long one left out."""
    line = " ".join(make_printable(name).split())
    return line if len(line) <= most else f"{line[: most - _END - 1]}…{line[-_END:]}"
