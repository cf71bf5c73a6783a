"""The set-up of an axis as a file: read with all its problems named at once, and written back."""

from __future__ import annotations

import difflib
import json
import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from decimal import Decimal
from typing import Any

from difffric.atomic_files import read_bytes
from difffric.axis.effects import EFFECTS
from difffric.axis.setup import AxisExtras, AxisSetup
from difffric.errors import InputError
from difffric.value_ranges import ANY, NOT_NEGATIVE, POSITIVE, SCATTER, Range


@dataclass(frozen=True)
class AxisNumber:
    """A number of the file: where it stands, and what it may be."""

    section: str
    key: str
    attribute: str
    """of an `AxisSetup`"""
    range: Range
    required: bool = False
    scale: str = "1"
    """of its unit in SI"""


NUMBERS = (
    AxisNumber("axis", "mass_kg", "mass", POSITIVE, required=True),
    AxisNumber("friction", "coulomb_N", "coulomb", POSITIVE, required=True),
    AxisNumber("friction", "breakaway_N", "breakaway", POSITIVE),
    AxisNumber("friction", "k_v_N_s_per_m", "k_v", NOT_NEGATIVE),
    AxisNumber("friction", "scatter", "scatter", SCATTER),
    AxisNumber("drive", "gain_N_per_V", "gain", ANY),
    AxisNumber("drive", "offset_N", "offset", ANY),
    AxisNumber("probe", "resolution_um", "resolution", POSITIVE, scale="0.000001"),
    AxisNumber("probe", "noise_um", "noise", NOT_NEGATIVE, scale="0.000001"),
)
"""The numbers of an axis without effects."""

_SECTIONS = {
    section: {x.key: x for x in NUMBERS if x.section == section}
    for section in ("axis", "friction", "drive", "probe")
}
_EXTRAS = ("value", "standard_error", "free", "lower", "upper")
_FILES = "files"
"""The table of the names that recordings have for what we call otherwise."""
_RIGS = ("part", "contact", "pusher", "force_sensor")


def read_axis(path: str | os.PathLike) -> AxisSetup:
    """All that the set-up of an axis says.

    Raises `InputError` naming all that is wrong with the file, a line each.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected text in UTF-8") from None
    return parse_axis(text, str(path))


def parse_axis(text: str, name: str = "setup.toml") -> AxisSetup:
    """What the text of an axis' set-up says.

    Raises `InputError` with a line for each thing that is wrong, led by the file's `name`.
    """
    try:
        document = tomllib.loads(text, parse_float=Decimal)
    except (ValueError, RecursionError, ArithmeticError) as error:
        raise InputError(f"{name}: not valid TOML: {error}") from None
    problems = _find_strangers(document)
    fields: dict[str, float] = {}
    extras: dict[str, AxisExtras] = {}
    for number in NUMBERS:
        table = document.get(number.section, {})
        given = table.get(number.key) if isinstance(table, dict) else None
        if given is None:
            if number.required and isinstance(table, dict):
                expected = number.range.describe_expected(0)
                problems.append(f"[{number.section}] {number.key}: missing, {expected}")
            continue
        value, more, wrong = _read_number(given, number.range, float(number.scale))
        problems += [f"[{number.section}] {number.key}{x}" for x in wrong]
        fields[number.attribute] = value
        if more is not None:
            extras[number.key if number.section != "probe" else f"probe.{number.key}"] = more
    said = document.get("effects")
    effects = said if isinstance(said, dict) else {}
    found: dict[str, dict[str, float]] = {}
    for effect in [x for x in EFFECTS if x in effects]:
        table = effects[effect] if isinstance(effects[effect], dict) else {}
        found[effect] = {}
        for key in [x for x in EFFECTS[effect].keys if x.name in table]:
            value, more, wrong = _read_number(table[key.name], ANY, 1.0)
            problems += [f"[effects.{effect}] {key.name}{x}" for x in wrong]
            found[effect][key.name] = value
            if more is not None:
                extras[f"{effect}.{key.name}"] = more
    breakaway, coulomb = fields.get("breakaway"), fields.get("coulomb")
    if breakaway is not None and coulomb is not None and breakaway < coulomb:
        problems.append(
            f"[friction] breakaway_N: expected a number >= coulomb_N ({coulomb:g}), "
            f"got {breakaway:g}"
        )
    if fields.get("gain") == 0:
        problems.append("[drive] gain_N_per_V: expected a number other than 0, got 0")
    if problems:
        raise InputError("\n".join(f"{name}: {x}" for x in problems))
    plain: Any = fields
    names = dict(document.get(_FILES, {}))
    text = text.replace("\r\n", "\n")
    return AxisSetup(**plain, effects=found, extras=extras, channels=names, text=text)


def format_axis(setup: AxisSetup, signed: str = "") -> str:
    """The text of an axis' file, with comments and layout of the one that it was read from.

    With `signed`, the line in which a command that fits signs for the numbers, each number that
    differs from that text is said to be fitted.
    """
    from difffric.rig.toml_layout import lay_out, mark_fitted, sign  # tomlkit comes with it

    tables = _format_tables(setup)
    if not signed:
        return lay_out(tables, setup.text)
    before = _format_tables(parse_axis(setup.text)) if setup.text else {}
    return sign(lay_out(tables, setup.text, mark_fitted(tables, before)), signed)


def _format_tables(setup: AxisSetup) -> dict[str, dict[str, str]]:
    """Table -> key -> the value's text."""
    tables: dict[str, dict[str, str]] = {section: {} for section in _SECTIONS}
    for number in NUMBERS:
        value = getattr(setup, number.attribute)
        prefix = "probe." if number.section == "probe" else ""
        extras = setup.extras.get(f"{prefix}{number.key}")
        if value is not None:
            scaled = value if number.scale == "1" else float(f"{value / float(number.scale):.15g}")
            tables[number.section][number.key] = _format_number(scaled, extras)
    for effect, keys in setup.effects.items():
        tables[f"effects.{effect}"] = {
            key: _format_number(value, setup.extras.get(f"{effect}.{key}"))
            for key, value in keys.items()
        }
    tables[_FILES] = {k: json.dumps(x, ensure_ascii=False) for k, x in setup.channels.items()}
    return {name: table for name, table in tables.items() if table}


def _find_strangers(document: Mapping[str, Any]) -> list[str]:
    """What is said of tables and keys that an axis does not know."""
    problems = []
    for section, table in document.items():
        if section == "effects":
            problems += _find_strange_effects(table)
        elif section == _FILES:
            problems += _find_strange_names(table)
        elif section not in _SECTIONS:
            if section in _RIGS:
                problems.append(f"[{section}]: an axis has none; [axis] stands in its place")
            else:
                problems.append(f"{section}: unknown key{_suggest(section, _SECTIONS)}")
        elif not isinstance(table, dict):
            problems.append(f"[{section}]: expected a table, got {_show(table)}")
        else:
            known = _SECTIONS[section]
            problems += [
                f"[{section}] {key}: unknown key{_suggest(key, known)}"
                for key in table
                if key not in known
            ]
    return problems


def _find_strange_names(table: Any) -> list[str]:
    if not isinstance(table, dict):
        return [f"[{_FILES}]: expected a table, got {_show(table)}"]
    return [
        f"[{_FILES}] {key}: expected a name in quotes, got {_show(given)}"
        for key, given in table.items()
        if not isinstance(given, str) or not given.strip()
    ]


def _find_strange_effects(table: Any) -> list[str]:
    if not isinstance(table, dict):
        return [f"[effects]: expected a table, got {_show(table)}"]
    problems = []
    for effect, keys in table.items():
        if effect not in EFFECTS:
            problems.append(f"[effects] {effect}: unknown effect{_suggest(effect, EFFECTS)}")
            continue
        known = [key.name for key in EFFECTS[effect].keys]
        if not isinstance(keys, dict) or not keys:
            problems.append(f"[effects.{effect}]: expected some of its keys: {', '.join(known)}")
            continue
        problems += [
            f"[effects.{effect}] {key}: unknown key{_suggest(key, known)}"
            for key in keys
            if key not in known
        ]
    return problems


def _read_number(
    given: Any, range: Range, scale: float
) -> tuple[float, AxisExtras | None, list[str]]:
    """The value of an entry in SI, what its table says beside it, and what is wrong with it."""
    table = given if isinstance(given, dict) else {"value": given}
    wrong = [f": unknown key {key}{_suggest(key, _EXTRAS)}" for key in table if key not in _EXTRAS]
    if "value" not in table:
        return math.nan, None, [*wrong, ".value: missing"]
    numbers = {}
    for key, x in table.items():
        if key == "free":
            if not isinstance(x, bool):
                wrong.append(f".free: expected true or false, got {_show(x)}")
        elif key in _EXTRAS:
            allowed = range if key == "value" else NOT_NEGATIVE if "error" in key else ANY
            value = float(x) if isinstance(x, int | Decimal) and not isinstance(x, bool) else None
            if value is None or not allowed.allows(value):
                expected = allowed.describe_expected(0.0 if value is None else value)
                where = "" if key == "value" else f".{key}"
                wrong.append(f"{where}: {expected}, got {_show(x)}")
            else:
                numbers[key] = value
    value = numbers.get("value", math.nan)
    low, high = numbers.get("lower", -math.inf), numbers.get("upper", math.inf)
    if not wrong and not low <= value <= high:
        wrong.append(f": expected lower < upper and the value between them, got {value:g}")
    if not isinstance(given, dict):
        return value * scale, None, wrong
    free = table.get("free")
    more = AxisExtras(
        numbers.get("standard_error"), free, numbers.get("lower"), numbers.get("upper")
    )
    return value * scale, more, wrong


def _format_number(value: float, extras: AxisExtras | None) -> str:
    if extras is None:
        return repr(float(value))
    entries = {"value": repr(float(value))}
    for key, x in asdict(extras).items():
        if x is not None:
            entries[key] = json.dumps(x) if isinstance(x, bool) else repr(float(x))
    return f"{{ {', '.join(f'{key} = {x}' for key, x in entries.items())} }}"


def _suggest(key: str, known: Any) -> str:
    close = difflib.get_close_matches(key, [*known], n=1)
    return f", did you mean {close[0]}?" if close else f", known: {', '.join(known)}"


def _show(given: Any) -> str:
    if isinstance(given, Decimal):
        return repr(float(given))
    if isinstance(given, bool | str):
        return json.dumps(given, ensure_ascii=False)
    return {dict: "a table", list: "a list"}.get(type(given), str(given))
