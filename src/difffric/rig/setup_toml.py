"""setup.toml: read with all its problems named at once, and written back.

A number of the file is plain, `k_N_per_m = 8e5`, or a table that says more of it,
`k_N_per_m = { value = 8e5, standard_error = 2e3, free = true, lower = 1e5, upper = 1e7 }`.
A table `[effects.ID]` adds an effect of the catalogue.
"""

from __future__ import annotations

import json
import os
import tomllib
from contextlib import suppress
from dataclasses import asdict
from decimal import Context, Decimal
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from difffric.atomic_files import write_whole
from difffric.compute.number_tree import is_traced
from difffric.errors import InputError
from difffric.rig import catalogue
from difffric.rig.friction import innermost
from difffric.rig.quantities import (
    COMPONENTS,
    PLAIN,
    PLAIN_LAWS,
    SECTIONS,
    AbstractSetupQuantity,
    EffectQuantity,
    effects_of,
    has_plain_law,
    layers,
)
from difffric.rig.rig import Rig, spring_damper_rig
from difffric.rig.setup import Extras, Setup, refuse_recorded_motion
from difffric.rig.setup_schema import FILES, iterate_entries, validate_document

RECORDED = "recorded"
"""The word of a pusher whose motion is the recorded one."""


def load_setup(path: str | os.PathLike) -> Rig:
    """The rig of a setup.toml. Raises `InputError` naming all that is wrong with the file, and
    where the tip's motion is the recorded one, which a rig alone does not say."""
    setup = read_setup(path)
    refuse_recorded_motion(setup, f"{path}: `load_setup` gives the rig alone, take `read_setup`")
    return setup.rig


def read_setup(path: str | os.PathLike) -> Setup:
    """All that a setup.toml says. Raises `InputError` naming all that is wrong with the file."""
    try:
        if Path(path).is_dir():
            raise InputError(f"{path}: expected a TOML file, got a folder")
        return parse_setup(Path(path).read_bytes().decode("utf-8-sig"), str(path))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: expected text in UTF-8, line {line} is not") from None


def parse_setup(text: str, name: str = "setup.toml") -> Setup:
    """What the text of a setup.toml says.

    Raises `InputError` with a line for each thing that is wrong, led by the file's `name`.
    """
    try:
        document = tomllib.loads(text, parse_float=Decimal)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: not valid TOML: {error}") from None
    except ArithmeticError:
        raise InputError(f"{name}: an exponent is beyond all numbers") from None
    document = _read_older_keys(document, name)
    document, recorded = _take_motion(document, name)
    model = validate_document(document, name)
    values, extras, sizes, inverses = {}, {}, {}, {}
    for q, entry, is_table in iterate_entries(model, document):
        if isinstance(q, EffectQuantity):
            sizes.setdefault(q.effect.id, {})[q.of_law.name] = q.to_si(entry.value)
            if q.of_law.inverse:
                inverses[q.name] = q.inverse(entry.value)
        else:
            values[q.attribute] = q.to_si(entry.value)
        extras.pop(q.name, None)
        if is_table:
            extras[q.name] = Extras(**q.scale_extras(entry.model_dump(exclude={"value"})))

    def find_fields(part: str) -> dict[str, float]:
        start = f"rig.{part}."
        return {k.removeprefix(start): x for k, x in values.items() if k.startswith(start)}

    laws = {part: law(**find_fields(part)) for part, law in PLAIN_LAWS.items()}
    rig = catalogue.extended(Rig(mass=values["rig.mass"], **laws), sizes)
    if inverses:
        rig = catalogue.with_numbers(rig, inverses)
    names = dict(getattr(model, FILES))
    text = text.replace("\r\n", "\n")
    scatter = values.get("mu_s_scatter")
    return Setup(rig, scatter, extras, text, channels=names, recorded_motion=recorded)


def _take_motion(document: dict[str, Any], name: str) -> tuple[dict[str, Any], bool]:
    """The document without the word of how the pusher moves, and whether it moves as recorded.

    Raises `InputError`, led by the file's `name`, for another word, and for an effect of the pusher
    beside a motion that was recorded.
    """
    pusher = document.get("pusher")
    if not isinstance(pusher, dict) or "motion" not in pusher:
        return document, False
    if pusher["motion"] != RECORDED:
        got = pusher["motion"]
        said = json.dumps(got, ensure_ascii=False) if isinstance(got, str | bool) else got
        raise InputError(f'{name}: [pusher] motion: expected "{RECORDED}", got {said}')
    effects = document.get("effects")
    own = [e.id for e in catalogue.CATALOGUE.values() if e.component == catalogue.PUSHER]
    beside = [f"[effects.{e}]" for e in own if isinstance(effects, dict) and e in effects]
    beside += ["[pusher] duration_ms"] if "duration_ms" in pusher else []
    if beside:
        raise InputError(
            f'{name}: [pusher] motion = "{RECORDED}" is the whole motion, leave out '
            f"{' and '.join(beside)}"
        )
    rest = {key: x for key, x in pusher.items() if key != "motion"}
    return document | {"pusher": rest}, True


def _read_older_keys(document: dict[str, Any], name: str) -> dict[str, Any]:
    """The document with the share of b that once damped the rebound as the coefficient that it
    was. Raises `InputError`, led by the file's `name`, for what is no share."""
    effects, contact = document.get("effects"), document.get("contact")
    older = effects.get("rebound_damping") if isinstance(effects, dict) else None
    if not isinstance(older, dict) or "share" not in older or "b_N_s_per_m" in older:
        return document
    b = _find_value(contact.get("b_N_s_per_m") if isinstance(contact, dict) else None)
    if not _is_number(b):
        return document  # whose other faults are told
    share = older["share"]
    value = _find_value(share)
    if not (_is_number(value) and not Decimal(value).is_nan() and 0 <= value <= 1):
        raise InputError(
            f"{name}: [effects.rebound_damping] share: expected a number >= 0 and <= 1, of b; got "
            f"{value}"
        )
    new = {k: _times(x, b) for k, x in share.items()} if isinstance(share, dict) else share
    damping = {key: x for key, x in older.items() if key != "share"}
    damping["b_N_s_per_m"] = _times(new, b)
    return document | {"effects": dict(effects or {}, rebound_damping=damping)}


def _find_value(entry: Any) -> Any:
    return entry.get("value") if isinstance(entry, dict) else entry


def _is_number(x: Any) -> bool:
    return isinstance(x, int | Decimal) and not isinstance(x, bool)


def _times(x: Any, b: Any) -> Any:
    """The product of numbers, which may come out as none; what is not a number stays."""
    return Context(traps=[]).multiply(Decimal(x), Decimal(b)) if _is_number(x) else x


def write_setup(setup: Setup | Rig, path: str | os.PathLike) -> None:
    """Write a set-up so that reading it gives the same numbers, to the last digit.

    Comments and layout stay those of the file that the set-up was read from; if there was none,
    those of a file that the new one replaces. The file appears whole or not at all. Raises
    `InputError` for what the format cannot say, and where the path cannot be written.
    """
    whole = Setup(setup) if isinstance(setup, Rig) else setup
    replaced = ""
    if not whole.text:
        with suppress(OSError, UnicodeDecodeError):
            replaced = Path(path).read_text(encoding="utf-8-sig")
    text = format_setup(whole, str(path), replaced)
    write_whole(path, lambda file: file.write(text.encode("utf-8")))


def format_setup(
    setup: Setup, name: str = "setup.toml", template: str = "", signed: str = ""
) -> str:
    """The text of a set-up's file, with the comments and the layout of the text that the set-up
    was read from, or else of `template`.

    With `signed`, the line in which a command that fits signs for the numbers, each number that
    differs from that text is said to be fitted, whatever was said of the one that it replaces.

    Raises `InputError` for what the format cannot say, a line each, led by the file's `name`.
    """
    # Not at the top: to read a set-up, as most commands do, takes no tomlkit (60 ms).
    from difffric.rig.toml_layout import lay_out, mark_fitted, sign

    tables, text = _format_tables(setup, name), setup.text or template
    parse_setup(lay_out(tables), name)
    if text:
        tables = _leave_out_usual(tables, text)
    if not signed:
        return lay_out(tables, text)
    before = _format_tables(parse_setup(text), name) if text else {}
    return sign(lay_out(tables, text, mark_fitted(tables, before)), signed)


def _leave_out_usual(tables: dict[str, dict[str, str]], text: str) -> dict[str, dict[str, str]]:
    """The tables without what goes without saying, and was not said in an earlier text either."""
    try:
        said = tomllib.loads(text)
    except ValueError:  # it is no TOML
        return tables
    usual = _format_tables(Setup(spring_damper_rig(mass=1.0, mu_s=1.0, k=1.0, b=0.0)), "")

    def is_said(section: str, key: str) -> bool:
        home: Any = said
        for part in section.split("."):
            home = home.get(part, {}) if isinstance(home, dict) else {}
        return isinstance(home, dict) and key in home

    kept = {
        section: {
            key: x
            for key, x in table.items()
            if is_said(section, key) or usual.get(section, {}).get(key) != x
        }
        for section, table in tables.items()
    }
    return {section: table for section, table in kept.items() if table}


def _format_tables(setup: Setup, name: str) -> dict[str, dict[str, str]]:
    """Table -> key -> the value's text."""
    # The ratio of friction_ratio is written as the one of equation (1).
    sections = [*dict.fromkeys(q.section for q in PLAIN)]
    sections += [f"effects.{effect}" for effect in effects_of(setup.rig)]
    known = {q.name for section in sections for q in SECTIONS[section].values()}
    problems = [f"{x}: the file has no such number" for x in setup.extras if x not in known]
    problems += _find_disorder(setup.rig)
    tables: dict[str, dict[str, str]] = {}
    for section in sections:
        if not has_plain_law(setup.rig, section):
            law = type(innermost(getattr(setup.rig, section))).__name__
            problems.append(f"[{section}]: expected {PLAIN_LAWS[section].__name__}, got {law}")
            continue
        tables[section] = {}
        for q in filter(lambda q: q.written, SECTIONS[section].values()):
            try:
                text = _format_value(q, q.of(setup), setup.extras.get(q.name))
            except InputError as error:
                problems.append(f"[{section}] {q.key}: {error}")
                continue
            if text is not None:
                tables[section][q.key] = text
    if problems:
        raise InputError("\n".join(f"{name}: {problem}" for problem in problems))
    if setup.recorded_motion:
        tables["pusher"]["motion"] = json.dumps(RECORDED)
    tables[FILES] = {k: json.dumps(x, ensure_ascii=False) for k, x in setup.channels.items()}
    return {section: table for section, table in tables.items() if table}


def _find_disorder(rig: Rig) -> list[str]:
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


def _format_value(q: AbstractSetupQuantity, value: Any, extras: Extras | None) -> str | None:
    """The value of a number's key, or None where there is nothing to say."""
    number = None
    if value is not None:
        if np.ndim(value):
            raise InputError(f"expected one number, got an array of shape {np.shape(value)}")
        if is_traced(value) or np.asarray(value).dtype.kind not in "iuf":
            raise InputError(f"expected a number, got {value!r}")
        number = q.text(float(value))
    if extras is None:
        return number
    entries = {} if number is None else {"value": number}
    for key, x in asdict(extras).items():
        if x is not None:
            entries[key] = json.dumps(x) if isinstance(x, bool) else repr(float(x))
    return f"{{ {', '.join(f'{key} = {x}' for key, x in entries.items())} }}"
