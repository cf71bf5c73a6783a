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
from dataclasses import dataclass, field, fields
from decimal import Decimal, InvalidOperation
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError
from pydantic import create_model, model_validator
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
    """What a number [SI] may be; `hull` is what its bounds may be, where that differs."""

    words: str
    holds: Callable[[Any], Any]
    hull: Range | None = None

    def expected(self, finite=True) -> str:
        return f"a {'' if finite else 'finite '}number {self.words}"


NOT_NEGATIVE = Range(">= 0", lambda x: x >= 0)
POSITIVE = Range("> 0", lambda x: x > 0, NOT_NEGATIVE)
UP_TO_1 = Range("in [0, 1]", lambda x: (x >= 0) & (x <= 1))
RATIO = Range("> 0 and <= 1", lambda x: (x > 0) & (x <= 1), UP_TO_1)
SCATTER = Range(">= 0 and < 1", lambda x: (x >= 0) & (x < 1), UP_TO_1)


@dataclass(frozen=True)
class Quantity:
    """A number of the file, where it stands in a `Setup`, its range and the file's unit."""

    section: str
    key: str
    attribute: str
    range: Range
    unit: float = 1.0
    required: bool = False

    @property
    def name(self) -> str:
        """Its name among the parameters where it has one, else section.key."""
        return self.key if self.key in RIG_PARAMETERS else f"{self.section}.{self.key}"


QUANTITIES = (
    Quantity("part", "mass_kg", "rig.mass", POSITIVE, required=True),
    Quantity("friction", "mu_s", "rig.friction.mu_s", POSITIVE, required=True),
    Quantity("friction", "mu_s_scatter", "mu_s_scatter", SCATTER),
    Quantity("friction", "mu_k_over_mu_s", "rig.friction.mu_k_over_mu_s", RATIO),
    Quantity("friction", "k_v_N_s_per_m", "rig.friction.k_v", NOT_NEGATIVE),
    Quantity("contact", "k_N_per_m", "rig.contact.k", POSITIVE, required=True),
    Quantity("contact", "b_N_s_per_m", "rig.contact.b", NOT_NEGATIVE, required=True),
    Quantity("pusher", "stroke_mm", "rig.pusher.stroke", POSITIVE, units.MM),
    Quantity(
        "force_sensor", "sensitivity_mV_per_N", "rig.force_sensor.sensitivity", POSITIVE, units.MV
    ),
    Quantity("force_sensor", "range_N", "rig.force_sensor.range", POSITIVE),
    Quantity("force_sensor", "rate_Hz", "rig.force_sensor.rate", POSITIVE),
    Quantity("force_sensor", "noise_N", "rig.force_sensor.noise", POSITIVE),
    Quantity("probe", "resolution_um", "rig.probe.resolution", POSITIVE, units.UM),
    Quantity("probe", "noise_um", "rig.probe.noise", POSITIVE, units.UM),
)
"""All numbers of the file. What is missing and not required takes its law's or sensor's default."""

_SECTIONS = {
    section: [q for q in QUANTITIES if q.section == section]
    for section in dict.fromkeys(q.section for q in QUANTITIES)
}
_LAWS = {"friction": ViscousCoulomb, "contact": UnilateralSpringDamper}
_CHECKED = ("part", "friction", "contact", "pusher")


@dataclass(frozen=True)
class Extras:
    """What a number's table says beside its value; None: nothing. In the file's own unit,
    which differs from SI only where the name says so (`pusher.stroke_mm`)."""

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
    """no effect exists yet: always empty"""


def load_setup(path: str | os.PathLike) -> Rig:
    """The rig of a setup.toml. Raises `InputError` naming all that is wrong with the file."""
    return read_setup(path).rig


def read_setup(path: str | os.PathLike) -> Setup:
    """All that a setup.toml says. Raises `InputError` naming all that is wrong with the file."""
    file = Path(path)
    if file.is_dir():
        raise InputError(f"{path}: is a folder, expected a TOML file")
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {_reason(error)}") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: expected UTF-8 text, line {line} is something else") from None
    return _parse(text, path)


def write_setup(setup: Setup | Rig, path: str | os.PathLike) -> None:
    """Write a set-up so that reading it gives the same numbers, to the last digit.

    The file appears whole or not at all; the comments of one that it replaces are lost. Raises
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
        raise InputError(f"{path}: cannot be written: {_reason(error)}") from None
    finally:
        temporary.unlink(missing_ok=True)


def checked(rig: Rig) -> Rig:
    """The rig itself, or an `InputError` that names all its values out of range.

    For equations (1) and (2) and the stroke, element by element; other laws and values that
    JAX is tracing pass unseen.
    """
    problems = []
    for q in QUANTITIES:
        law = _LAWS.get(q.section)
        if q.section not in _CHECKED or (law and not isinstance(getattr(rig, q.section), law)):
            continue
        value, endless = attrgetter(q.attribute)(Setup(rig)), q.attribute == "rig.pusher.stroke"
        if isinstance(value, jax.core.Tracer) or (value is None and not q.required):
            continue
        x = np.asarray(value)
        if x.dtype.kind not in "iuf":
            problems.append(f"{q.attribute}: expected {q.range.expected()}, got {value!r}")
            continue
        good = q.range.holds(x) & (np.isfinite(x) | (endless & ~np.isnan(x)))
        if not good.all():
            at = np.unravel_index(np.argmin(good), x.shape)
            where = f" at index {', '.join(map(str, at))}" if x.ndim else ""
            expected = q.range.expected(finite=bool(np.isfinite(x[at])))
            problems.append(f"{q.attribute}: expected {expected}, got {x[at]}{where}")
    if problems:
        raise InputError("\n".join(problems))
    return rig


def _parse(text: str, name) -> Setup:
    try:
        document = tomllib.loads(text, parse_float=_literal)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: not valid TOML: {error}") from None
    try:
        model = _DOCUMENT.model_validate({section: {} for section in _SECTIONS} | document)
    except ValidationError as error:
        lines = [f"{name}: {_problem(e, document)}" for e in error.errors(include_url=False)]
        raise InputError("\n".join(lines)) from None
    values, extras = {}, {}
    for q in QUANTITIES:
        entry = getattr(getattr(model, q.section), q.key)
        if entry is not None:
            values[q.attribute] = entry.value
            if isinstance(document[q.section][q.key], dict):
                extras[q.name] = Extras(**{f.name: getattr(entry, f.name) for f in fields(Extras)})

    def part(name):
        start = f"rig.{name}."
        return {a.removeprefix(start): v for a, v in values.items() if a.startswith(start)}

    rig = Rig(
        mass=values["rig.mass"],
        friction=ViscousCoulomb(**part("friction")),
        contact=UnilateralSpringDamper(**part("contact")),
        pusher=ConstantSpeed(**part("pusher")),
        force_sensor=ForceSensor(**part("force_sensor")),
        probe=Probe(**part("probe")),
    )
    return Setup(rig, values.get("mu_s_scatter"), extras)


def _render(setup: Setup, name) -> str:
    if setup.effects:
        raise InputError(f"{name}: {_no_effects_yet(setup.effects)}")
    unknown = sorted(set(setup.extras) - {q.name for q in QUANTITIES})
    problems = [f"{name}: extras for {u}: the file has no such number" for u in unknown]
    for section, law in _LAWS.items():
        if not isinstance(found := getattr(setup.rig, section), law):
            problems.append(f"{name}: [{section}]: expected {law.__name__}, got {found!r}")
    if problems:
        raise InputError("\n".join(problems))
    blocks = []
    for section, quantities in _SECTIONS.items():
        lines = [line for q in quantities if (line := _assignment(setup, q, name))]
        if lines:
            blocks.append("\n".join([f"[{section}]", *lines, ""]))
    return "\n".join(blocks)


def _assignment(setup: Setup, q: Quantity, name) -> str | None:
    """`key = value` as the file has it; None where there is nothing to say."""
    value, extras = attrgetter(q.attribute)(setup), setup.extras.get(q.name)
    text = None
    if value is not None:
        try:
            number = float(value) if np.ndim(value) == 0 else None
        except (TypeError, ValueError):  # traced, or no number at all
            number = None
        if number is None:
            raise InputError(f"{name}: [{q.section}] {q.key}: expected one number, got {value!r}")
        if not (q.attribute == "rig.pusher.stroke" and number == math.inf):  # which means none
            text = _in_unit(number, q.unit)
    if extras is None:
        return None if text is None else f"{q.key} = {text}"
    says = {f.name: getattr(extras, f.name) for f in fields(extras)}
    items = [] if text is None else [f"value = {text}"]
    items += [
        f"{key} = {json.dumps(x) if isinstance(x, bool) else repr(float(x))}"
        for key, x in says.items()
        if x is not None
    ]
    return f"{q.key} = {{ {', '.join(items)} }}"


# Units are powers of ten, so in decimal the file's number and the SI one convert into each other
# without loss; in binary a length could come back one digit off.


def _literal(text: str) -> Decimal:
    try:
        return Decimal(text)
    except InvalidOperation:  # an exponent beyond even a Decimal
        return Decimal(repr(float(text)))


def _to_si(number: int | Decimal, unit: float) -> float:
    as_float = float(Decimal(number))
    if not math.isfinite(as_float):
        return as_float
    return float(Decimal(number) * Decimal(repr(unit)))


def _in_unit(value: float, unit: float) -> str:
    if not math.isfinite(value):
        return repr(value)
    exact = Decimal(repr(value)) / Decimal(repr(unit))
    short = repr(float(exact))
    return short if Decimal(short) == exact else str(exact)


# The models of the file. Validators say in words what pydantic would say in its own.


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid")


def _number(range: Range, unit: float = 1.0):
    """A finite number of the file in a range, as SI."""

    def validate(given):
        is_number = isinstance(given, int | Decimal) and not isinstance(given, bool)
        value = _to_si(given, unit) if is_number else math.nan
        if not (is_number and math.isfinite(value) and range.holds(value)):
            expected = range.expected(finite=not is_number or math.isfinite(value))
            raise _error(f"expected {expected}, got {_shown(given)}")
        return value

    return Annotated[float, BeforeValidator(validate)]


def _flag(given):
    if not isinstance(given, bool):
        raise _error(f"expected true or false, got {_shown(given)}")
    return given


def _entry(q: Quantity) -> Any:
    """The model of one number, which takes it plain as well."""

    def consistent(entry):
        value, lower, upper = entry.value / q.unit, entry.lower, entry.upper
        if lower is not None and upper is not None and not lower < upper:
            raise _error(f"expected lower < upper, got lower = {lower}, upper = {upper}")
        # A fit that ends at a bound may pass it by a rounding error.
        low, high = (value if bound is None else bound for bound in (lower, upper))
        if value < low and not math.isclose(value, low):
            raise _error(f"expected value >= lower, got value = {value:.17g}, lower = {lower}")
        if value > high and not math.isclose(value, high):
            raise _error(f"expected value <= upper, got value = {value:.17g}, upper = {upper}")
        return entry

    bound = _number(q.range.hull or q.range)
    model = create_model(
        q.key,
        __base__=_Table,
        __validators__={"consistent": model_validator(mode="after")(consistent)},
        value=(_number(q.range, q.unit), ...),
        standard_error=(_number(NOT_NEGATIVE), None),
        free=(Annotated[bool, BeforeValidator(_flag)], None),
        lower=(bound, None),
        upper=(bound, None),
    )
    as_table = BeforeValidator(lambda given: given if isinstance(given, dict) else {"value": given})
    return (Annotated[model, as_table], ... if q.required else None)


def _no_effects_yet(effects) -> str:
    ids = ", ".join(effects)
    return f"[effects]: expected none, since this version has no effects yet, got {ids}"
