"""The numbers that a setup.toml may hold: tables, ranges and units, and where a rig has them."""

from __future__ import annotations

import abc
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from operator import attrgetter
from typing import Any

import numpy as np

from difffric.rig import catalogue
from difffric.rig.catalogue import CATALOGUE, KEYS, Effect, Key
from difffric.rig.contact import UnilateralSpringDamper
from difffric.rig.friction import ViscousCoulomb, innermost
from difffric.rig.parameters import PARAMETERS, range_of
from difffric.rig.pusher import ConstantSpeed
from difffric.rig.rig import Rig
from difffric.rig.sensors import ForceSensor, Probe
from difffric.value_ranges import ANY, POSITIVE, SCATTER, AbstractQuantity, Range


@dataclass(frozen=True, kw_only=True)
class AbstractSetupQuantity(AbstractQuantity):
    """A number of the file, and where it stands in a `Setup`; `attribute` is what messages on a
    rig call it."""

    range: Range = ANY
    section: str
    """the table that it stands in"""
    required: bool = False
    written: bool = True
    """whether it is written back here, and not under its other name"""

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """Its name among the parameters where it has one, else section.key."""

    @abc.abstractmethod
    def of(self, setup: Any) -> Any:
        """What a set-up holds."""

    def of_rig(self, held: Any) -> Any:
        """The value [SI] of what a rig holds, or the values of an array."""
        return held

    def text(self, held: float) -> str | None:
        """The file's number for what a rig holds; None: it goes without saying."""
        return self.from_si(held) if math.isfinite(held) else repr(held)

    def scale_extras(self, said: Mapping[str, Any]) -> dict[str, Any]:
        """What a table says beside the value, as results have it: in the file's own unit."""
        return dict(said)


@dataclass(frozen=True, kw_only=True)
class PlainQuantity(AbstractSetupQuantity):
    """A number of a rig without effects."""

    same_as: str | None = None
    """the key of (1) or (2) that it is another name of"""
    infinite_is_none: bool = False
    """whether an infinite value in a rig means that there is none"""

    @property
    def name(self) -> str:
        key = self.same_as or self.key
        return key if key in PARAMETERS else f"{self.section}.{key}"

    def of(self, setup: Any) -> Any:
        if not self.attribute.startswith("rig."):
            return getattr(setup, self.attribute)
        _, *part, field = self.attribute.split(".")
        return getattr(innermost(attrgetter(*part)(setup.rig)) if part else setup.rig, field)

    def text(self, held: float) -> str | None:
        return None if self.infinite_is_none and held == math.inf else super().text(held)


def _plain(
    section: str, key: str, attribute: str, range: Range = POSITIVE, unit: str = "1", **more: Any
) -> PlainQuantity:
    return PlainQuantity(
        key=key, attribute=attribute, range=range, unit=unit, section=section, **more
    )


_MILLI, _MICRO = "0.001", "0.000001"  # of the SI unit; decimal, as `AbstractQuantity` computes

STROKE = _plain("pusher", "stroke_mm", "rig.pusher.stroke", unit=_MILLI, infinite_is_none=True)


def _parameter(key: str, attribute: str, required: bool = False) -> PlainQuantity:
    """A parameter of the laws of (1) and (2), with what the table of parameters knows of it."""
    row = PARAMETERS[key]
    return _plain(row.component, key, attribute, row.range, required=required)


PLAIN = (
    _parameter("mass_kg", "rig.mass", required=True),
    _parameter("mu_s", "rig.friction.mu_s", required=True),
    _plain("friction", "mu_s_scatter", "mu_s_scatter", SCATTER),
    _parameter("mu_k_over_mu_s", "rig.friction.mu_k_over_mu_s"),
    _parameter("k_v_N_s_per_m", "rig.friction.k_v"),
    _parameter("k_N_per_m", "rig.contact.k", required=True),
    _parameter("b_N_s_per_m", "rig.contact.b", required=True),
    STROKE,
    _plain("force_sensor", "sensitivity_mV_per_N", "rig.force_sensor.sensitivity", unit=_MILLI),
    _plain("force_sensor", "range_N", "rig.force_sensor.range"),
    _plain("force_sensor", "rate_Hz", "rig.force_sensor.rate"),
    _plain("force_sensor", "noise_N", "rig.force_sensor.noise"),
    _plain("probe", "resolution_um", "rig.probe.resolution", unit=_MICRO),
    _plain("probe", "noise_um", "rig.probe.noise", unit=_MICRO),
)
"""The numbers of a rig without effects. One that is neither there nor required takes its class's
default."""

_FLOAT_DIGITS = 17
"""No float needs more digits than these."""


@dataclass(frozen=True, kw_only=True)
class EffectQuantity(AbstractSetupQuantity):
    """A number of an effect, which stands in a law around the laws of its component."""

    effect: Effect
    of_law: Key

    @property
    def name(self) -> str:
        """`id.key`, as the parameters have it."""
        return self.attribute

    def of(self, setup: Any) -> Any:
        around = layers(getattr(setup.rig, self.effect.component))
        law = next(law for law in around if type(law) is self.effect.law)
        held = getattr(law, self.of_law.field)
        return self.of_law.null if held is None else held

    def of_rig(self, held: Any) -> Any:
        if not self.of_law.inverse:
            return held
        with np.errstate(divide="ignore"):
            return 1.0 / np.asarray(held, float)

    def inverse(self, number: Decimal) -> float:
        """What a law that holds the inverse holds for the file's number."""
        if len(number.as_tuple().digits) <= _FLOAT_DIGITS:
            return self.of_law.to_law(float(number))
        return float(1 / number)

    def text(self, held: float) -> str | None:
        if not self.of_law.inverse or not math.isfinite(held):
            return super().text(held)
        if held == 0:
            return "inf"
        for digits in range(15, _FLOAT_DIGITS + 1):
            short = repr(float(f"{1 / held:.{digits}g}"))
            if self.inverse(Decimal(short)) == held:
                return short
        # Not every float is the inverse of one: such a number has more digits than a float.
        return f"{1 / Decimal(held):.{_FLOAT_DIGITS + 7}e}"


@dataclass(frozen=True, kw_only=True)
class DurationQuantity(EffectQuantity):
    """The pusher's duration beside its stroke, in milliseconds: another name of its effect's
    number, in whose table it is written."""

    written: bool = False

    def inverse(self, number: Decimal) -> float:
        return super().inverse(number * Decimal(self.unit))

    def scale_extras(self, said: Mapping[str, Any]) -> dict[str, Any]:
        return {
            key: x if x is None or isinstance(x, bool) else x * float(self.unit)
            for key, x in said.items()
        }


def _quantity(effect: Effect, key: Key) -> EffectQuantity:
    name = f"{effect.id}.{key.name}"
    range = range_of(name, key)
    needed = math.isinf(key.null) and not range.infinite
    return EffectQuantity(
        key=key.name,
        attribute=name,
        range=range,
        section=f"effects.{effect.id}",
        required=needed,
        effect=effect,
        of_law=key,
    )


COMPONENTS = tuple(dict.fromkeys(effect.component for effect in CATALOGUE.values()))

OF_EFFECTS = {
    effect.id: tuple(_quantity(effect, key) for key in effect.keys) for effect in CATALOGUE.values()
}
"""id -> the numbers of the effect."""

MU_RATIO = _plain(
    f"effects.{catalogue.RATIO}",
    "ratio",
    "rig.friction.mu_k_over_mu_s",
    PARAMETERS["mu_k_over_mu_s"].range,
    required=True,
    same_as="mu_k_over_mu_s",
)

_DURATION, _DURATION_KEY = KEYS["pusher_duration.duration_s"]
DURATION = DurationQuantity(
    key="duration_ms",
    attribute="pusher_duration.duration_s",
    range=range_of("pusher_duration.duration_s", _DURATION_KEY),
    unit=_MILLI,
    section="pusher",
    effect=_DURATION,
    of_law=_DURATION_KEY,
)

QUANTITIES: tuple[AbstractSetupQuantity, ...] = (
    *PLAIN,
    DURATION,
    MU_RATIO,
    *(q for qs in OF_EFFECTS.values() for q in qs),
)
"""All numbers of the file. Of two that are the same one the latter counts."""

SECTIONS: dict[str, dict[str, AbstractSetupQuantity]] = {
    section: {q.key: q for q in QUANTITIES if q.section == section}
    for section in dict.fromkeys(q.section for q in QUANTITIES)
}
"""Name of a table -> its keys."""


def layers(law: Any) -> Iterator[Any]:
    """A law and those that it stands around, the innermost one last."""
    yield law
    while hasattr(law, "law"):
        law = law.law
        yield law


def effects_of(rig: Rig) -> list[str]:
    """The effects that a rig has, in the catalogue's order."""
    kinds = {type(law) for part in COMPONENTS for law in layers(getattr(rig, part))}
    return [effect.id for effect in CATALOGUE.values() if effect.law in kinds]


PLAIN_LAWS = {
    "friction": ViscousCoulomb,
    "contact": UnilateralSpringDamper,
    "pusher": ConstantSpeed,
    "force_sensor": ForceSensor,
    "probe": Probe,
}
"""Component -> the law that the file's numbers are of; effects stand around it."""


def has_plain_law(rig: Rig, section: str) -> bool:
    """Whether the rig's law of a table's component is the one that the file can say."""
    kind = PLAIN_LAWS.get(section)
    return kind is None or isinstance(innermost(getattr(rig, section)), kind)
