"""setup.toml: read with all its problems named at once, and written back.

A number of the file is plain, `k_N_per_m = 8e5`, or a table that says more of it,
`k_N_per_m = { value = 8e5, standard_error = 2e3, free = true, lower = 1e5, upper = 1e7 }`.
"""

from __future__ import annotations

import difflib
import json
import math
import os
import tomllib
import uuid
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from decimal import Decimal
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
from jax.core import Tracer
from pydantic_core import PydanticCustomError

from difffric import units
from difffric.contact import UnilateralSpringDamper
from difffric.errors import InputError
from difffric.friction import ViscousCoulomb
from difffric.parameters import RIG_PARAMETERS
from difffric.pusher import ConstantSpeed
from difffric.rig import Rig
from difffric.sensors import ForceSensor, Probe


@dataclass(frozen=True)
class Range:
    """What a number may be; besides, it must be finite."""

    words: str
    holds: Callable[[Any], Any]

    def expected(self, found) -> str:
        """The range in words, for a message on what was found instead."""
        return f"expected a {'finite ' if np.isinf(found) else ''}number {self.words}".rstrip()


ANY = Range("", lambda x: x == x)
NOT_NEGATIVE = Range(">= 0", lambda x: x >= 0)
POSITIVE = Range("> 0", lambda x: x > 0)
RATIO = Range("> 0 and <= 1", lambda x: (x > 0) & (x <= 1))
SCATTER = Range(">= 0 and < 1", lambda x: (x >= 0) & (x < 1))


@dataclass(frozen=True)
class Quantity:
    """A number of the file: its range, where it stands in a `Setup`, the file's unit in SI."""

    section: str
    key: str
    range: Range
    attribute: str
    unit: float = 1.0
    required: bool = False

    @property
    def name(self) -> str:
        """Its name among the parameters where it has one, else section.key."""
        return self.key if self.key in RIG_PARAMETERS else f"{self.section}.{self.key}"

    def to_si(self, number: Decimal) -> float:
        """The value [SI] of the file's number.

        In decimal the two turn into each other without loss, as units are powers of ten; in
        binary a length could come back one digit off.
        """
        value = float(number)
        return float(number * Decimal(repr(self.unit))) if math.isfinite(value) else value

    def from_si(self, value: float) -> str:
        """The file's number for a value [SI]."""
        if not math.isfinite(value):
            return repr(value)
        exact = Decimal(repr(value)) / Decimal(repr(self.unit))
        short = repr(float(exact))
        return short if Decimal(short) == exact else str(exact)


STROKE = Quantity("pusher", "stroke_mm", POSITIVE, "rig.pusher.stroke", units.MM)
QUANTITIES = (
    Quantity("part", "mass_kg", POSITIVE, "rig.mass", required=True),
    Quantity("friction", "mu_s", POSITIVE, "rig.friction.mu_s", required=True),
    Quantity("friction", "mu_s_scatter", SCATTER, "mu_s_scatter"),
    Quantity("friction", "mu_k_over_mu_s", RATIO, "rig.friction.mu_k_over_mu_s"),
    Quantity("friction", "k_v_N_s_per_m", NOT_NEGATIVE, "rig.friction.k_v"),
    Quantity("contact", "k_N_per_m", POSITIVE, "rig.contact.k", required=True),
    Quantity("contact", "b_N_s_per_m", NOT_NEGATIVE, "rig.contact.b", required=True),
    STROKE,
    Quantity(
        "force_sensor", "sensitivity_mV_per_N", POSITIVE, "rig.force_sensor.sensitivity", units.MV
    ),
    Quantity("force_sensor", "range_N", POSITIVE, "rig.force_sensor.range"),
    Quantity("force_sensor", "rate_Hz", POSITIVE, "rig.force_sensor.rate"),
    Quantity("force_sensor", "noise_N", POSITIVE, "rig.force_sensor.noise"),
    Quantity("probe", "resolution_um", POSITIVE, "rig.probe.resolution", units.UM),
    Quantity("probe", "noise_um", POSITIVE, "rig.probe.noise", units.UM),
)
"""All numbers of the file. One that is neither there nor required takes its class's default."""

SECTIONS = {
    section: {q.key: q for q in QUANTITIES if q.section == section}
    for section in dict.fromkeys(q.section for q in QUANTITIES)
}
_LAWS = {"friction": ViscousCoulomb, "contact": UnilateralSpringDamper}
_NO_EFFECTS = "expected none, as this version of difffric has no effects yet"


@dataclass(frozen=True)
class Extras:
    """What a number's table says beside its value, in the file's own unit, which differs from
    SI only where its name says so (`pusher.stroke_mm`). None: not said."""

    standard_error: float | None = None
    free: bool | None = None
    lower: float | None = None
    upper: float | None = None


@dataclass(frozen=True)
class Setup:
    """What a setup.toml says. `extras` has an entry for each number given as a table."""

    rig: Rig
    mu_s_scatter: float | None = None
    """relative standard deviation of mu_s from push to push; None: not known"""
    extras: Mapping[str, Extras] = field(default_factory=dict)
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """always empty: no effect exists yet"""


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


def checked(rig: Rig) -> Rig:
    """The rig itself, or an `InputError` that names all its values out of range.

    It sees the mass, the numbers of equations (1) and (2) and the stroke, element by element;
    other laws, and values that JAX is tracing, pass.
    """
    problems = []
    for q in QUANTITIES:
        if q.section in ("force_sensor", "probe") or not _has_law(rig, q.section):
            continue
        value = attrgetter(q.attribute)(Setup(rig))
        if q.key == "mu_s_scatter" or isinstance(value, Tracer) or (q is STROKE and value is None):
            continue
        x = np.asarray(value)
        if x.dtype.kind not in "iuf":
            problems.append(f"{q.attribute}: {q.range.expected(0)}, got {value!r}")
            continue
        good = q.range.holds(x) & (np.isfinite(x) | (q is STROKE))  # infinite stroke: none
        if not good.all():
            at = np.unravel_index(np.argmin(good), x.shape)
            where = f" at index {', '.join(map(str, at))}" if x.ndim else ""
            problems.append(f"{q.attribute}: {q.range.expected(x[at])}, got {x[at]}{where}")
    if problems:
        raise InputError("\n".join(problems))
    return rig


def _has_law(rig: Rig, section: str) -> bool:
    return section not in _LAWS or isinstance(getattr(rig, section), _LAWS[section])


def _parse(text: str, name) -> Setup:
    try:
        document = tomllib.loads(text, parse_float=Decimal)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: not valid TOML: {error}") from None
    except ArithmeticError:
        raise InputError(f"{name}: an exponent is beyond all numbers") from None
    try:
        model = _File.model_validate({section: {} for section in SECTIONS} | document)
    except pydantic.ValidationError as error:
        problems = [_problem(e, document) for e in error.errors(include_url=False)]
        raise InputError("\n".join(f"{name}: {problem}" for problem in problems)) from None
    values, extras = {}, {}
    for q in QUANTITIES:
        entry = getattr(getattr(model, q.section), q.key)
        if entry is not None:
            values[q.attribute] = q.to_si(entry.value)
            if isinstance(document[q.section][q.key], dict):
                extras[q.name] = Extras(**entry.model_dump(exclude={"value"}))

    def fields_of(part):
        start = f"rig.{part}."
        return {k.removeprefix(start): x for k, x in values.items() if k.startswith(start)}

    rig = Rig(
        mass=values["rig.mass"],
        friction=ViscousCoulomb(**fields_of("friction")),
        contact=UnilateralSpringDamper(**fields_of("contact")),
        pusher=ConstantSpeed(**fields_of("pusher")),
        force_sensor=ForceSensor(**fields_of("force_sensor")),
        probe=Probe(**fields_of("probe")),
    )
    return Setup(rig, values.get("mu_s_scatter"), extras)


def _render(setup: Setup, name) -> str:
    known = {q.name for q in QUANTITIES}
    problems = [f"{x}: the file has no such number" for x in setup.extras if x not in known]
    problems += [f"[effects.{x}]: {_NO_EFFECTS}" for x in setup.effects]
    text = ""
    for section, quantities in SECTIONS.items():
        if not _has_law(setup.rig, section):
            found = type(getattr(setup.rig, section)).__name__
            problems.append(f"[{section}]: expected {_LAWS[section].__name__}, got {found}")
            continue
        lines = []
        for q in quantities.values():
            try:
                lines += _assignment(q, attrgetter(q.attribute)(setup), setup.extras.get(q.name))
            except InputError as error:
                problems.append(f"[{section}] {q.key}: {error}")
        if lines:
            text += "\n".join(["\n" * bool(text) + f"[{section}]", *lines, ""])
    if problems:
        raise InputError("\n".join(f"{name}: {problem}" for problem in problems))
    return text


def _assignment(q: Quantity, value, extras: Extras | None) -> list[str]:
    """`key = value` as the file has it; no line where there is nothing to say."""
    says = {}
    if value is not None:
        if np.ndim(value):
            raise InputError(f"expected one number, got an array of shape {np.shape(value)}")
        if isinstance(value, Tracer) or np.asarray(value).dtype.kind not in "iuf":
            raise InputError(f"expected a number, got {value!r}")
        if not (q is STROKE and float(value) == math.inf):  # which means none
            says["value"] = q.from_si(float(value))
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
        if not (is_number and math.isfinite(value) and range.holds(value)):
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


def _section(quantities: dict[str, Quantity]) -> Any:
    entries: Any = {key: _entry(q) for key, q in quantities.items()}
    return (pydantic.create_model("_Section", __base__=_Table, **entries), ...)


def _no_effects(given):
    if given:
        raise _error(f"{_NO_EFFECTS}, got {', '.join(given)}")
    return given


_FIELDS: Any = {section: _section(quantities) for section, quantities in SECTIONS.items()}
_FIELDS["effects"] = (Annotated[dict, pydantic.AfterValidator(_no_effects)], {})
_File: Any = pydantic.create_model("_File", __base__=_Table, **_FIELDS)


def _problem(error: Mapping[str, Any], document: dict) -> str:
    """`[section] key: what was expected, what was got`."""
    section, *keys = error["loc"]
    kind, given = error["type"], error["input"]
    if len(keys) == 2 and not isinstance(document[section][keys[0]], dict):
        keys.pop()  # the value of a plain number
    where = f"[{section}] {'.'.join(keys)}".rstrip()
    if kind == "setup":
        return f"{where}: {error['msg']}"
    if kind == "missing":
        return f"{where}: missing, {SECTIONS[section][keys[0]].range.expected(0)}"
    if kind == "extra_forbidden":
        outside = not keys and not isinstance(given, dict)
        return f"{section if outside else where}: {_unknown(section, *keys)}"
    what = "true or false" if kind == "bool_type" else "a table"
    return f"{where}: expected {what}, got {_shown(given)}"


def _unknown(*path: str) -> str:
    """What to say of a key that the file does not know."""
    home = [q.section for q in QUANTITIES if q.key == path[-1]]
    if home:
        return f"unknown key here, it belongs in [{home[0]}]"
    known = ([*SECTIONS], [*SECTIONS.get(path[0], ())], [*_Entry.model_fields])[len(path) - 1]
    close = difflib.get_close_matches(path[-1], known, n=1)
    return f"unknown key, {f'did you mean {close[0]}?' if close else 'known: ' + ', '.join(known)}"
