"""setup.toml: read with all its problems named at once, and written back.

A number of the file is plain, `k_N_per_m = 8e5`, or a table that says more of it,
`k_N_per_m = { value = 8e5, standard_error = 2e3, free = true, lower = 1e5, upper = 1e7 }`.
A table `[effects.ID]` adds an effect of the catalogue.
"""

from __future__ import annotations

import difflib
import json
import math
import os
import tomllib
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from decimal import Decimal
from functools import reduce
from itertools import pairwise
from operator import getitem
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
from jax.core import Tracer
from pydantic_core import PydanticCustomError

from difffric.errors import InputError
from difffric.rig import catalogue
from difffric.rig.friction import innermost
from difffric.rig.quantities import (
    COMPONENTS,
    PLAIN,
    PLAIN_LAWS,
    QUANTITIES,
    SECTIONS,
    EffectQuantity,
    Quantity,
    effects_of,
    has_plain_law,
    layers,
)
from difffric.rig.rig import Rig
from difffric.rig.setup import Extras, Setup
from difffric.value_ranges import ANY, NOT_NEGATIVE, Range


def load_setup(path: str | os.PathLike) -> Rig:
    """The rig of a setup.toml. Raises `InputError` naming all that is wrong with the file."""
    return read_setup(path).rig


def read_setup(path: str | os.PathLike) -> Setup:
    """All that a setup.toml says. Raises `InputError` naming all that is wrong with the file."""
    try:
        if Path(path).is_dir():
            raise InputError(f"{path}: expected a TOML file, got a folder")
        return _parse(Path(path).read_bytes().decode("utf-8-sig"), path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: expected text in UTF-8, line {line} is not") from None


def write_setup(setup: Setup | Rig, path: str | os.PathLike) -> None:
    """Write a set-up so that reading it gives the same numbers, to the last digit.

    The file appears whole or not at all; comments in one that it replaces are lost. Raises
    `InputError` for what the format cannot say, and where the path cannot be written.
    """
    text = _render(Setup(setup) if isinstance(setup, Rig) else setup, path)
    _parse(text, path)
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.name}.{uuid.uuid4().hex}")
    try:
        temporary.write_text(text, encoding="utf-8", newline="\n")
        os.replace(temporary, target)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def _parse(text: str, name) -> Setup:
    try:
        document = tomllib.loads(text, parse_float=Decimal)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: not valid TOML: {error}") from None
    except ArithmeticError:
        raise InputError(f"{name}: an exponent is beyond all numbers") from None
    try:
        model = _File.model_validate({table: {} for table in _TABLES} | document)
    except pydantic.ValidationError as error:
        problems = [_problem(e, document) for e in error.errors(include_url=False)]
        raise InputError("\n".join(f"{name}: {problem}" for problem in problems)) from None
    values, extras, sizes, inverses = {}, {}, {}, {}
    for q, entry, said in _entries(model, document):
        if isinstance(q, EffectQuantity):
            sizes.setdefault(q.effect.id, {})[q.key] = q.to_si(entry.value)
            if q.of_law.inverse:
                inverses[q.name] = q.inverse(entry.value)
        else:
            values[q.attribute] = q.to_si(entry.value)
        extras.pop(q.name, None)
        if said:
            extras[q.name] = Extras(**entry.model_dump(exclude={"value"}))

    def fields_of(part):
        start = f"rig.{part}."
        return {k.removeprefix(start): x for k, x in values.items() if k.startswith(start)}

    laws = {part: law(**fields_of(part)) for part, law in PLAIN_LAWS.items()}
    rig = catalogue.extended(Rig(mass=values["rig.mass"], **laws), sizes)
    if inverses:
        rig = catalogue.with_numbers(rig, inverses)
    return Setup(rig, values.get("mu_s_scatter"), extras)


def _entries(model, document: dict) -> Iterator[tuple[Quantity, Any, bool]]:
    """Each number of a file, and whether it is a table."""
    for q in QUANTITIES:
        table, given = model, document
        for name in q.section.split("."):
            table, given = getattr(table, name, None), given.get(name, {})
        entry = getattr(table, q.key, None)
        if entry is not None:
            yield q, entry, isinstance(given[q.key], dict)


def _render(setup: Setup, name) -> str:
    # The ratio of friction_ratio is written as the one of equation (1).
    tables = [*dict.fromkeys(q.section for q in PLAIN)]
    tables += [f"effects.{found}" for found in effects_of(setup.rig)]
    known = {q.name for table in tables for q in SECTIONS[table].values()}
    problems = [f"{x}: the file has no such number" for x in setup.extras if x not in known]
    problems += _disorder(setup.rig)
    text = ""
    for section in tables:
        if not has_plain_law(setup.rig, section):
            found = type(innermost(getattr(setup.rig, section))).__name__
            problems.append(f"[{section}]: expected {PLAIN_LAWS[section].__name__}, got {found}")
            continue
        lines = []
        for q in SECTIONS[section].values():
            try:
                lines += _assignment(q, q.of(setup), setup.extras.get(q.name))
            except InputError as error:
                problems.append(f"[{section}] {q.key}: {error}")
        if lines:
            text += "\n".join(["\n" * bool(text) + f"[{section}]", *lines, ""])
    if problems:
        raise InputError("\n".join(f"{name}: {problem}" for problem in problems))
    return text


def _disorder(rig: Rig) -> list[str]:
    """What is wrong with the laws around those of equations (1) and (2): when the file is read
    effects stand around each other in the catalogue's order."""
    order = [effect.law for effect in catalogue.CATALOGUE.values()]
    problems = []
    for part in COMPONENTS:
        around = [type(law) for law in layers(getattr(rig, part))][-2::-1]
        places = [order.index(law) if law in order else -1 for law in around]
        if -1 in places or any(inner >= outer for inner, outer in pairwise(places)):
            got = " within ".join(law.__name__ for law in around)
            problems.append(f"[{part}]: expected the catalogue's effects in its order, got {got}")
    return problems


def _assignment(q: Quantity, value, extras: Extras | None) -> list[str]:
    """`key = value` as the file has it; no line where there is nothing to say."""
    says = {}
    if value is not None:
        if np.ndim(value):
            raise InputError(f"expected one number, got an array of shape {np.shape(value)}")
        if isinstance(value, Tracer) or np.asarray(value).dtype.kind not in "iuf":
            raise InputError(f"expected a number, got {value!r}")
        number = q.text(float(value))
        if number is not None:
            says["value"] = number
    if extras is None:
        return [f"{q.key} = {number}" for number in says.values()]
    for key, x in asdict(extras).items():
        if x is not None:
            says[key] = json.dumps(x) if isinstance(x, bool) else repr(float(x))
    return [f"{q.key} = {{ {', '.join(f'{key} = {x}' for key, x in says.items())} }}"]


# The models of the file. Their validators say in words what pydantic says in its own.


def _error(words: str) -> PydanticCustomError:
    return PydanticCustomError("setup", "{words}", {"words": words})


def _shown(given) -> str:
    if isinstance(given, bool | str):
        return json.dumps(given, ensure_ascii=False)
    if isinstance(given, Decimal):
        return repr(float(given))
    return {dict: "a table", list: "a list"}.get(type(given), str(given))


def _number(range: Range, q: Quantity | None = None) -> pydantic.PlainValidator:
    """A number in a range: a quantity's value as the file has it, else a float."""

    def validate(given):
        is_number = isinstance(given, int | Decimal) and not isinstance(given, bool)
        exact = Decimal(given) if is_number else Decimal(0)
        value = q.to_si(exact) if q else float(exact)
        if not (is_number and range.allows(value)):
            raise _error(f"{range.expected(value)}, got {_shown(given)}")
        return exact if q else value

    return pydantic.PlainValidator(validate)


class _Table(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid", strict=True)


class _Entry(_Table):
    """A number with its extras."""

    value: Any  # each quantity has its own range
    standard_error: Annotated[float | None, _number(NOT_NEGATIVE)] = None
    free: bool = None  # type: ignore[assignment]
    lower: Annotated[float | None, _number(ANY)] = None
    upper: Annotated[float | None, _number(ANY)] = None

    @pydantic.model_validator(mode="after")
    def _ordered(self):
        value = float(self.value)
        lower = -math.inf if self.lower is None else self.lower
        upper = math.inf if self.upper is None else self.upper
        # A fit that ends at a bound may pass it by a rounding error.
        at_bound = math.isclose(value, lower) or math.isclose(value, upper)
        if lower >= upper or not (lower <= value <= upper or at_bound):
            said = {"lower": self.lower, "value": value, "upper": self.upper}
            got = ", ".join(f"{key} = {x}" for key, x in said.items() if x is not None)
            raise _error(f"expected lower < upper and the value between them, got {got}")
        return self


def _entry(q: Quantity) -> Any:
    """The field of one quantity, which may be plain too."""
    value: Any = (Annotated[Any, _number(q.range, q)], ...)
    model: Any = pydantic.create_model(q.key, __base__=_Entry, value=value)
    as_table = pydantic.BeforeValidator(lambda x: x if isinstance(x, dict) else {"value": x})
    return (Annotated[model, as_table], ... if q.required else None)


class _Effect(_Table):
    """The numbers of an effect."""

    @pydantic.model_validator(mode="after")
    def _not_empty(self):
        if not self.model_fields_set:
            raise _error(f"expected some of its keys: {', '.join(type(self).model_fields)}")
        return self


def _section(section: str) -> Any:
    of_effect = "." in section
    entries: Any = {key: _entry(q) for key, q in SECTIONS[section].items()}
    model = pydantic.create_model("_Section", __base__=_Effect if of_effect else _Table, **entries)
    return (model, None if of_effect else ...)


_EFFECTS = [section.removeprefix("effects.") for section in SECTIONS if "." in section]
_FIELDS: Any = {section: _section(section) for section in SECTIONS if "." not in section}
_EACH: Any = {name: _section(f"effects.{name}") for name in _EFFECTS}
_FIELDS["effects"] = (pydantic.create_model("_Effects", __base__=_Table, **_EACH), ...)
_TABLES = [*_FIELDS]
_File: Any = pydantic.create_model("_File", __base__=_Table, **_FIELDS)


def _problem(error: Mapping[str, Any], document: dict) -> str:
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
        return f"{where}: missing, {SECTIONS[section][keys[0]].range.expected(0)}"
    if kind == "extra_forbidden":
        return f"{where}: {_unknown(*loc)}"
    what = "true or false" if kind == "bool_type" else "a table"
    return f"{where}: expected {what}, got {_shown(given)}"


def _unknown(*path: str) -> str:
    """What to say of a key that the file does not know."""
    *within, key = path
    section = ".".join(within)
    if section in SECTIONS and f"{within[-1]}.{key}" in catalogue.GIVEN:
        return "unknown key, the record of each push says it"
    if not within and key in _EFFECTS:
        return f"unknown table, expected [effects.{key}]"
    home = [q.section for q in QUANTITIES if q.key == key]
    if len(home) == 1:
        return f"unknown key here, it belongs in [{home[0]}]"
    known = {"": _TABLES, "effects": _EFFECTS, **SECTIONS}.get(section, _Entry.model_fields)
    close = difflib.get_close_matches(key, known, n=1)
    hint = f"did you mean {close[0]}?" if close else "known: " + ", ".join(known)
    return f"unknown {'effect' if section == 'effects' else 'key'}, {hint}"
