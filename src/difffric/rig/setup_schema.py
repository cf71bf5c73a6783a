"""The models of a setup.toml, and what a message says of each thing that is wrong with one.

The validators say in words what pydantic says in its own.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Iterator, Mapping
from decimal import Decimal
from functools import cache, reduce
from operator import getitem
from typing import Annotated, Any

import pydantic
from pydantic_core import PydanticCustomError

from difffric.errors import InputError
from difffric.rig import catalogue
from difffric.rig.quantities import QUANTITIES, SECTIONS, AbstractSetupQuantity
from difffric.value_ranges import ANY, NOT_NEGATIVE, Range


def validate_document(document: dict, name: str) -> Any:
    """The model of a file's document: a field for each table, in it one for each number.

    Raises `InputError` with a line for each thing that is wrong, led by the file's `name`.
    """
    given = document.get("effects")
    effects = tuple(x for x in _EFFECTS if isinstance(given, dict) and x in given)
    try:
        model = _make_file_model(effects)
        return model.model_validate({table: {} for table in _TABLES} | document)
    except pydantic.ValidationError as error:
        problems = [_describe(e, document) for e in error.errors(include_url=False)]
        raise InputError("\n".join(f"{name}: {problem}" for problem in problems)) from None


def iterate_entries(
    model: Any, document: dict
) -> Iterator[tuple[AbstractSetupQuantity, Any, bool]]:
    """Each quantity that the document says, its entry, and whether it is given as a table."""
    for q in QUANTITIES:
        table, given = model, document
        for name in q.section.split("."):
            table, given = getattr(table, name, None), given.get(name, {})
        entry = getattr(table, q.key, None)
        if entry is not None:
            yield q, entry, isinstance(given[q.key], dict)


def _refuse(words: str) -> PydanticCustomError:
    return PydanticCustomError("setup", "{words}", {"words": words})


def _format_given(given) -> str:
    if isinstance(given, bool | str):
        return json.dumps(given, ensure_ascii=False)
    if isinstance(given, Decimal):
        return repr(float(given))
    return {dict: "a table", list: "a list"}.get(type(given), str(given))


def _number(range: Range, q: AbstractSetupQuantity | None = None) -> pydantic.PlainValidator:
    """A number in a range: a quantity's value as the file has it, else a float."""

    def validate(given):
        is_number = isinstance(given, int | Decimal) and not isinstance(given, bool)
        exact = Decimal(given) if is_number else Decimal(0)
        value = q.to_si(exact) if q else float(exact)
        if not (is_number and range.allows(value)):
            raise _refuse(f"{range.describe_expected(value)}, got {_format_given(given)}")
        return exact if q else value

    return pydantic.PlainValidator(validate)


_Name = Annotated[str, pydantic.StringConstraints(strict=True)]


class _StrictModel(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid", strict=True)


class _Entry(_StrictModel):
    """A number with its extras."""

    value: Any  # each quantity has its own range
    standard_error: Annotated[float | None, _number(NOT_NEGATIVE)] = None
    free: bool = None  # type: ignore[assignment]
    lower: Annotated[float | None, _number(ANY)] = None
    upper: Annotated[float | None, _number(ANY)] = None

    @pydantic.model_validator(mode="after")
    def _check_order(self):
        value = float(self.value)
        lower = -math.inf if self.lower is None else self.lower
        upper = math.inf if self.upper is None else self.upper
        # A fit that ends at a bound may pass it by a rounding error.
        at_bound = math.isclose(value, lower) or math.isclose(value, upper)
        if lower >= upper or not (lower <= value <= upper or at_bound):
            said = {"lower": self.lower, "value": value, "upper": self.upper}
            got = ", ".join(f"{key} = {x}" for key, x in said.items() if x is not None)
            raise _refuse(f"expected lower < upper and the value between them, got {got}")
        return self


def _entry(q: AbstractSetupQuantity) -> Any:
    """The field of one quantity, which may be plain too."""
    value: Any = (Annotated[Any, _number(q.range, q)], ...)
    model: Any = pydantic.create_model(q.key, __base__=_Entry, value=value)
    as_table = pydantic.BeforeValidator(lambda x: x if isinstance(x, dict) else {"value": x})
    return (Annotated[model, as_table], ... if q.required else None)


class _EffectTable(_StrictModel):
    """The numbers of an effect."""

    @pydantic.model_validator(mode="after")
    def _check_not_empty(self):
        if not self.model_fields_set:
            raise _refuse(f"expected some of its keys: {', '.join(type(self).model_fields)}")
        return self


def _section(section: str) -> Any:
    of_effect = "." in section
    entries: Any = {key: _entry(q) for key, q in SECTIONS[section].items()}
    model = pydantic.create_model(
        "_Section", __base__=_EffectTable if of_effect else _StrictModel, **entries
    )
    return (model, None if of_effect else ...)


_EFFECTS = [section.removeprefix("effects.") for section in SECTIONS if "." in section]
FILES = "files"
"""The table of the names that files of data have for what we call otherwise."""
_TABLES = [*(section for section in SECTIONS if "." not in section), FILES, "effects"]


@cache
def _make_file_model(effects: tuple[str, ...]) -> Any:
    """The model of a file that has tables of these effects: to make those of all effects takes
    longer than to read the file."""
    each: Any = {name: _section(f"effects.{name}") for name in effects}
    fields: Any = {section: _section(section) for section in _TABLES[:-2]}
    names = Annotated[dict[str, _Name], pydantic.Field(default_factory=dict)]
    fields[FILES] = (names, ...)
    fields["effects"] = (pydantic.create_model("_Effects", __base__=_StrictModel, **each), ...)
    return pydantic.create_model("_File", __base__=_StrictModel, **fields)


def _describe(error: Mapping[str, Any], document: dict) -> str:
    """`[section] key: what was expected, what was got`."""
    loc, kind, given = error["loc"], error["type"], error["input"]
    depth = 2 if loc[0] == "effects" else 1
    if kind == "extra_forbidden" and len(loc) == depth and not isinstance(given, dict):
        depth -= 1  # a key outside the tables
    section, keys = ".".join(loc[:depth]), loc[depth:]
    if len(keys) == 2 and not isinstance(reduce(getitem, loc[:-1], document), dict):
        keys = keys[:1]  # the value of a plain number
    where = f"[{section}] {'.'.join(keys)}".removeprefix("[] ").rstrip()
    if kind == "setup":
        return f"{where}: {error['msg']}"
    if kind == "missing":
        return f"{where}: missing, {SECTIONS[section][keys[0]].range.describe_expected(0)}"
    if kind == "extra_forbidden":
        return f"{where}: {_describe_unknown(*loc)}"
    kinds = {"bool_type": "true or false", "string_type": "a name in quotes"}
    what = kinds.get(kind, "a table")
    return f"{where}: expected {what}, got {_format_given(given)}"


def _describe_unknown(*path: str) -> str:
    """What to say of a key that the file does not know."""
    *within, key = path
    section = ".".join(within)
    if section in SECTIONS and f"{within[-1]}.{key}" in catalogue.GIVEN:
        return "unknown key, the record of each push says it"
    if not within and key in _EFFECTS:
        return f"unknown table, expected [effects.{key}]"
    everywhere = [q.section for q in QUANTITIES if q.key == key]
    home = [x for x in everywhere if "." not in x] or everywhere
    if len(home) == 1 and home[0] != section:
        return f"unknown key here, it belongs in [{home[0]}]"
    known = {"": _TABLES, "effects": _EFFECTS, **SECTIONS}.get(section, _Entry.model_fields)
    close = difflib.get_close_matches(key, known, n=1)
    hint = f"did you mean {close[0]}?" if close else "known: " + ", ".join(known)
    return f"unknown {'effect' if section == 'effects' else 'key'}, {hint}"
