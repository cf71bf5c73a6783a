"""What is known of an axis: its numbers, its effects, and what a fit may vary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from difffric.axis.effects import EFFECTS, list_effect_keys

MASS, COULOMB, VISCOUS, OFFSET = "mass_kg", "coulomb_N", "k_v_N_s_per_m", "offset_N"
PLAIN_NAMES = (MASS, COULOMB, VISCOUS, OFFSET)
"""The parameters of the equation of motion while it moves, as results write them."""
BREAKAWAY = "breakaway_N"


@dataclass(frozen=True)
class AxisExtras:
    """What a number's table says beside its value. None: not said."""

    standard_error: float | None = None
    free: bool | None = None
    lower: float | None = None
    upper: float | None = None


@dataclass(frozen=True)
class AxisSetup:
    """An axis as a set-up's file says it, SI units.

    m x'' = force + offset - friction, friction = (coulomb + k_v abs(u)) sign(u) while it moves,
    up to breakaway while it sticks.
    """

    mass: float
    coulomb: float
    breakaway: float | None = None
    """None: that of sliding"""
    k_v: float = 0.0
    scatter: float | None = None
    """relative standard deviation of the friction level from stretch to stretch; None: not known"""
    gain: float | None = None
    """[N/V] of the drive, where it is recorded in volts"""
    offset: float = 0.0
    resolution: float | None = None
    """[m] of the encoder"""
    noise: float | None = None
    """[m] standard deviation of one sample of the encoder"""
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """id -> key -> value"""
    extras: Mapping[str, AxisExtras] = field(default_factory=dict)
    """by parameter (`mass_kg`, `cogging.period_m`): what the file says beside its value"""
    channels: Mapping[str, str] = field(default_factory=dict)
    """what recordings call a column or channel, by our name, such as Kraft for force"""
    text: str = field(default="", compare=False, repr=False)
    """of the file that it was read from: a new file keeps its comments and layout"""

    @property
    def values(self) -> dict[str, float]:
        """All parameters of the equation of motion, those of effects as `id.key`."""
        plain = {
            "mass_kg": self.mass,
            "coulomb_N": self.coulomb,
            "breakaway_N": self.get_breakaway(),
            "k_v_N_s_per_m": self.k_v,
            "offset_N": self.offset,
        }
        for effect in [x for x in EFFECTS if x in self.effects]:
            for key, name in zip(EFFECTS[effect].keys, list_effect_keys(effect), strict=True):
                plain[name] = self.effects[effect].get(key.name, key.typical)
        return plain

    def get_breakaway(self) -> float:
        """Return the force at which the axis breaks away [N]."""
        return self.coulomb if self.breakaway is None else self.breakaway

    def replace_values(self, values: Mapping[str, float]) -> AxisSetup:
        """Return the same axis with other values of some parameters; effects among them are added
        where they are not there yet."""
        fields = {
            "mass_kg": "mass",
            "coulomb_N": "coulomb",
            "breakaway_N": "breakaway",
            "k_v_N_s_per_m": "k_v",
            "offset_N": "offset",
        }
        plain = {fields[k]: float(v) for k, v in values.items() if k in fields}
        effects = {name: dict(keys) for name, keys in self.effects.items()}
        for name, value in values.items():
            effect, dot, key = name.partition(".")
            if dot:
                effects.setdefault(effect, {})[key] = float(value)
        ordered = {name: effects[name] for name in EFFECTS if name in effects}
        return replace(self, **plain, effects=ordered)
