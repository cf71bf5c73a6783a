"""Units at the edges: SI inside the library, everywhere. The only place that converts."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

GRAVITY = 9.80665
"""Standard gravity g [m/s^2] (ISO 80000-3)."""

MM = 1e-3  # 1 mm in m
UM = 1e-6  # 1 µm in m
MV = 1e-3  # 1 mV in V
MM_PER_MIN = 1e-3 / 60.0  # 1 mm/min in m/s


def from_mm_min(velocity_mm_min: Any) -> Any:
    """mm/min to m/s, of a float or of an array, as all of these."""
    return velocity_mm_min * MM_PER_MIN


def to_mm_min(velocity: Any) -> Any:
    """m/s to mm/min."""
    return velocity / MM_PER_MIN


def from_um(length_um: Any) -> Any:
    """µm to m."""
    return length_um * UM


def to_um(length: Any) -> Any:
    """m to µm."""
    return length / UM


def from_mm(length_mm: Any) -> Any:
    """mm to m."""
    return length_mm * MM


def to_mm(length: Any) -> Any:
    """m to mm."""
    return length / MM


@dataclass(frozen=True)
class Unit:
    """A unit as people write it: what it is of, and what one of it is in SI: `factor / per`.

    The factor is a decimal text, so that a number of a file turns into SI with one rounding.
    """

    symbol: str
    of: str
    """what is measured in it: `force`, `voltage`, `length`, `speed`, `time` or `mass`"""
    factor: str = "1"
    per: int = 1
    spellings: tuple[str, ...] = ()
    """other ways to write it"""

    @property
    def in_si(self) -> float:
        """One of it, in SI."""
        return float(Decimal(self.factor) / self.per)


UNITS = (
    Unit("N", "force", spellings=("n", "newton", "newtons", "Newton")),
    Unit("mN", "force", "0.001"),
    Unit("kN", "force", "1000", spellings=("KN", "kn")),
    Unit("MN", "force", "1000000"),
    Unit("lbf", "force", "4.4482216152605", spellings=("lbs", "LBF", "Lbf")),
    Unit("kgf", "force", "9.80665", spellings=("kp",)),
    Unit("V", "voltage", spellings=("v", "volt", "volts", "Volt", "Volts")),
    Unit("mV", "voltage", "0.001"),
    Unit("m", "length", spellings=("metre", "meter")),
    Unit("cm", "length", "0.01"),
    Unit("mm", "length", "0.001", spellings=("MM", "Mm", "millimetre", "millimeter")),
    Unit("um", "length", "0.000001", spellings=("UM", "micron", "microns", "micrometer")),
    Unit("nm", "length", "0.000000001"),
    Unit("in", "length", "0.0254", spellings=("inch", "inches", "Inch", "IN", '"', "′′")),
    Unit("s", "time", spellings=("S", "sec", "secs", "second", "seconds", "Sekunden")),
    Unit("ms", "time", "0.001", spellings=("msec", "MS")),
    Unit("us", "time", "0.000001", spellings=("usec",)),
    Unit("min", "time", "60", spellings=("minute", "minutes")),
    Unit("m/s", "speed", spellings=("M/S", "m/sec")),
    Unit("mm/s", "speed", "0.001", spellings=("MM/S", "mm/sec")),
    Unit("um/s", "speed", "0.000001"),
    Unit("cm/s", "speed", "0.01"),
    Unit("mm/min", "speed", "0.001", 60, ("MM/MIN", "mm/Min")),
    Unit("m/min", "speed", "1", 60, ("M/MIN",)),
    Unit("in/s", "speed", "0.0254", spellings=("ips", "inch/s")),
    Unit("in/min", "speed", "0.0254", 60, ("ipm", "inch/min")),
    Unit("kg", "mass", spellings=("KG", "Kg", "kilogram", "kilograms")),
    Unit("g", "mass", "0.001", spellings=("gram", "grams")),
    Unit("lb", "mass", "0.45359237", spellings=("lbm",)),
)
"""Units that files may have; the first of each quantity is SI's own."""


def find_unit(text: str) -> Unit | None:
    """The unit that a text is, or None: `kN`, `µm`, `mm/min`, `m s^-1`, `m_per_s`.

    `mN` and `MN` differ by nine powers of ten, so capitals count wherever two units need them.
    """
    plain = unicodedata.normalize("NFKC", text).replace("μ", "u").strip().rstrip(".")
    plain = re.sub(r"(\s+|_)per(\s+|_)|\s*/\s*", "/", plain)
    plain = re.sub(r"[\s*·.]+(s|min|sec)\^?[-−]1$", r"/\1", plain)
    return next((u for u in UNITS if plain == u.symbol or plain in u.spellings), None)


def list_units(of: str) -> str:
    """The units of a quantity as a message names them: `m, cm, mm, um, nm or in`."""
    *first, last = [u.symbol for u in UNITS if u.of == of]
    return f"{', '.join(first)} or {last}" if first else last
