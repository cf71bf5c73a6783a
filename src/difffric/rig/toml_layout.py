"""Tables of values as TOML text that keeps the comments and the layout of an earlier one."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from decimal import Decimal
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError


def lay_out(tables: Mapping[str, Mapping[str, str]], template: str = "") -> str:
    """The text that says these tables (name -> key -> text of the value) and nothing else.

    Where a template's own layout cannot carry them, its comments are lost.
    """
    plain = _write_into(tomlkit.document(), tables, {})
    if template:
        try:
            kept = _write_into(tomlkit.parse(template), tables, _read(template))
            if _read(kept) == _read(plain):
                return kept
        except (TOMLKitError, ValueError, ArithmeticError, TypeError, AttributeError, LookupError):
            pass  # it is no TOML, or has a value where a table is to be
    return plain


def _read(text: str) -> dict[str, Any]:
    """The text's tables, with their numbers to the last digit."""
    return tomllib.loads(text, parse_float=Decimal)


def _write_into(
    document: Any, tables: Mapping[str, Mapping[str, str]], old: Mapping[str, Any]
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
