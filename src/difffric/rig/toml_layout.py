"""Tables of values as TOML text that keeps the comments and the layout of an earlier one."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from decimal import Decimal
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

Comments = Mapping[str, Mapping[str, str]]
"""Name of a table -> key -> what is said of the value, in place of what was said of another one."""

_SIGNED = re.compile(r"# .* by difffric \w+\.\s*")
"""The first line of a set-up whose numbers a command has made."""


def sign(text: str, line: str) -> str:
    """The text of a file under a line in which a command signs for its numbers, in place of what
    an earlier command has signed."""
    lines = text.splitlines(keepends=True)
    above = next((i for i, x in enumerate(lines) if not x.startswith("#")), len(lines))
    head = [x for x in lines[:above] if not _SIGNED.fullmatch(x)]
    gap = [] if head or not lines[above:] or not lines[above].strip() else ["\n"]
    return "".join([f"# {line}\n", *head, *gap, *lines[above:]])


def mark_fitted(
    tables: Mapping[str, Mapping[str, str]], before: Mapping[str, Mapping[str, str]]
) -> Comments:
    """What is said of each value that differs from the one before: that it is fitted."""
    return {
        name: {key: "fitted" for key, x in table.items() if before.get(name, {}).get(key) != x}
        for name, table in tables.items()
    }


def lay_out(
    tables: Mapping[str, Mapping[str, str]], template: str = "", comments: Comments | None = None
) -> str:
    """The text that says these tables (name -> key -> text of the value) and nothing else.

    Where a template's own layout cannot carry them, its comments are lost.
    """
    words = comments or {}
    plain = _write_into(tomlkit.document(), tables, {}, words)
    if template:
        try:
            kept = _write_into(tomlkit.parse(template), tables, _read(template), words)
            if _read(kept) == _read(plain):
                return kept
        except (TOMLKitError, ValueError, ArithmeticError, TypeError, AttributeError, LookupError):
            pass  # it is no TOML, or has a value where a table is to be
    return plain


def _read(text: str) -> dict[str, Any]:
    """The text's tables, with their numbers to the last digit."""
    return tomllib.loads(text, parse_float=Decimal)


def _write_into(
    document: Any,
    tables: Mapping[str, Mapping[str, str]],
    old: Mapping[str, Any],
    comments: Comments,
) -> str:
    """The text of a document with these tables in place of its `old` ones."""
    _drop_others(document, tables)
    for name, values in tables.items():
        *within, last = name.split(".")
        home, said = document, old
        for part in within:
            if part not in home:
                home[part] = tomlkit.table(is_super_table=True)
            home, said = home[part], said.get(part, {})
        if last not in home:
            home[last] = tomlkit.table()
        _fill(home[last], values, said.get(last, {}))
        for key, words in comments.get(name, {}).items():
            trivia = home[last][key].trivia
            trivia.comment_ws, trivia.comment = "  ", f"# {words}"
    return tomlkit.dumps(document)


def _drop_others(home: Any, tables: Mapping[str, Any], within: str = "") -> None:
    """Remove the tables that are not among these."""
    for key in [*home]:
        name = f"{within}{key}"
        if any(other.startswith(f"{name}.") for other in tables):
            _drop_others(home[key], tables, f"{name}.")
        elif name not in tables:
            home.remove(key)


def _fill(table: Any, values: Mapping[str, str], old: Mapping[str, Any]) -> None:
    """Give a table these values; one that is as it should be stays as it was written."""
    for key in [*table]:
        if key not in values:
            table.remove(key)
    for key in values.keys() & table.keys():
        if old[key] != _read(f"x = {values[key]}")["x"]:
            table[key] = tomlkit.value(values[key])
    # Comments at a table's end are mostly about the next one: new keys go before them.
    body, end = table.value.body, []
    while body and body[-1][0] is None:
        end.insert(0, body.pop())
    for key, text in values.items():
        if key not in table:
            table.append(key, tomlkit.value(text))
    body.extend(end)
