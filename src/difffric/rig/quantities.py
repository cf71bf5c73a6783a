"""The numbers that a setup.toml may hold: tables, ranges and units, and where a rig has them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from operator import attrgetter
from typing import Any

import numpy as np

from difffric import units
from difffric.rig import catalogue
from difffric.rig.catalogue import CATALOGUE, Effect, Key
from difffric.rig.contact import UnilateralSpringDamper
from difffric.rig.friction import ViscousCoulomb, innermost
from difffric.rig.parameters import PARAMETERS, range_of
from difffric.rig.pusher import ConstantSpeed
from difffric.rig.rig import Rig
from difffric.rig.sensors import ForceSensor, Probe
from difffric.value_ranges import POSITIVE, SCATTER, Range


@dataclass(frozen=True)
class Quantity:
    """A number of the file: its range, where it stands in a `Setup`, the file's unit in SI."""

    section: str
    key: str
    range: Range
    attribute: str
    """what messages on a rig call it"""
    unit: float = 1.0
    required: bool = False
    same_as: str | None = None
    """the key of (1) or (2) that it is another name of"""

    @property
    def name(self) -> str:
        """Its name among the parameters where it has one, else section.key."""
        key = self.same_as or self.key
        return key if key in PARAMETERS else f"{self.section}.{key}"

    def of(self, setup) -> Any:
        """What a set-up holds."""
        if not self.attribute.startswith("rig."):
            return getattr(setup, self.attribute)
        _, *part, field = self.attribute.split(".")
        return getattr(innermost(attrgetter(*part)(setup.rig)) if part else setup.rig, field)

    def of_rig(self, held) -> Any:
        """The value [SI] of what a rig holds, or the values of an array."""
        return held

    def to_si(self, number: Decimal) -> float:
        """The value [SI] of the file's number.

        In decimal the two turn into each other without loss, as units are powers of ten; in
        binary a length could come back one digit off.
        """
        value = float(number)
        return float(number * Decimal(repr(self.unit))) if math.isfinite(value) else value

    def text(self, held: float) -> str | None:
        """The file's number for what a rig holds; None: it goes without saying."""
        if not math.isfinite(held):
            return None if self is STROKE and held > 0 else repr(held)
        exact = Decimal(repr(held)) / Decimal(repr(self.unit))
        short = repr(float(exact))
        return short if Decimal(short) == exact else str(exact)


STROKE = Quantity("pusher", "stroke_mm", POSITIVE, "rig.pusher.stroke", units.MM)
"""Infinite in a rig it means none."""


def _parameter(key: str, attribute: str, required: bool = False) -> Quantity:
    """A parameter of the laws of (1) and (2), with what the table of parameters knows of it."""
    row = PARAMETERS[key]
    return Quantity(row.component, key, row.range, attribute, required=required)


PLAIN = (
    _parameter("mass_kg", "rig.mass", required=True),
    _parameter("mu_s", "rig.friction.mu_s", required=True),
    Quantity("friction", "mu_s_scatter", SCATTER, "mu_s_scatter"),
    _parameter("mu_k_over_mu_s", "rig.friction.mu_k_over_mu_s"),
    _parameter("k_v_N_s_per_m", "rig.friction.k_v"),
    _parameter("k_N_per_m", "rig.contact.k", required=True),
    _parameter("b_N_s_per_m", "rig.contact.b", required=True),
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
"""The numbers of a rig without effects. One that is neither there nor required takes its class's
default."""

_FLOAT_DIGITS = 17
"""No float needs more digits than these."""


@dataclass(frozen=True, kw_only=True)
class EffectQuantity(Quantity):
    """A number of an effect, which stands in a law around the laws of its component."""

    effect: Effect
    of_law: Key

    @property
    def name(self) -> str:
        """`id.key`, as the parameters have it."""
        return self.attribute

    def of(self, setup) -> Any:
        around = layers(getattr(setup.rig, self.effect.component))
        law = next(law for law in around if type(law) is self.effect.law)
        held = getattr(law, self.of_law.field)
        return self.of_law.null if held is None else held

    def of_rig(self, held) -> Any:
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


def _quantity(effect: Effect, key: Key) -> EffectQuantity:
    name = f"{effect.id}.{key.name}"
    range = range_of(name, key)
    needed = math.isinf(key.null) and not range.infinite
    return EffectQuantity(
        f"effects.{effect.id}", key.name, range, name, required=needed, effect=effect, of_law=key
    )


COMPONENTS = tuple(dict.fromkeys(effect.component for effect in CATALOGUE.values()))

OF_EFFECTS = {
    effect.id: tuple(_quantity(effect, key) for key in effect.keys) for effect in CATALOGUE.values()
}
"""id -> the numbers of the effect."""

MU_RATIO = Quantity(
    f"effects.{catalogue.RATIO}",
    "ratio",
    PARAMETERS["mu_k_over_mu_s"].range,
    "rig.friction.mu_k_over_mu_s",
    required=True,
    same_as="mu_k_over_mu_s",
)

QUANTITIES: tuple[Quantity, ...] = (
    *PLAIN,
    MU_RATIO,
    *(q for qs in OF_EFFECTS.values() for q in qs),
)
"""All numbers of the file. Of two that are the same one the latter counts."""

SECTIONS: dict[str, dict[str, Quantity]] = {
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
