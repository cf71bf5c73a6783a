"""What may be said of a measured push: its names in files, their units and ranges."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal

from difffric.value_ranges import ANY, NOT_NEGATIVE, POSITIVE, Range

MANY = 10  # problems that are told one by one
LONGEST = 600  # characters of a line


@dataclass(frozen=True)
class Measured:
    """A quantity of a push: its name in files, its name in SI, its range, its unit in SI, which
    is `unit / per`. No range: text."""

    key: str
    attribute: str
    range: Range | None = None
    unit: str = "1"
    per: int = 1

    @property
    def stem(self) -> str:
        """The name without its unit."""
        return self.key.removesuffix(f"_{self.unit_name}")

    @property
    def unit_name(self) -> str:
        """The unit as the name has it; empty: a plain number."""
        return next((u for u in ("mm_min", "um", "mm", "kg", "N", "s") if self._ends(u)), "")

    def _ends(self, unit: str) -> bool:
        return self.key.endswith(f"_{unit}")

    def to_si(self, number: Decimal) -> float:
        """The value [SI] of the file's number, rounded once; beyond all floats it is infinite."""
        value = float(number)
        if not math.isfinite(value) or value == 0.0:
            return value
        return float(number * Decimal(self.unit) / self.per)

    def from_si(self, value: float) -> str:
        """The shortest number of the file that reads as the value [SI]."""
        if not math.isfinite(value):
            raise ValueError(f"{self.key} is {value}")
        exact = Decimal(repr(value)) / Decimal(self.unit) * self.per
        for digits in (15, 16, 17):
            short = repr(float(f"{exact:.{digits}g}"))
            if self.to_si(Decimal(short)) == value:
                return short
        return str(exact)


_LENGTH, _SMALL, _SPEED = ("0.001", 1), ("0.000001", 1), ("0.001", 60)
QUANTITIES = (
    Measured("velocity_mm_min", "velocity", POSITIVE, *_SPEED),
    Measured("peak_force_N", "peak_force", POSITIVE),
    Measured("sliding_distance_um", "sliding_distance", POSITIVE, *_SMALL),
    Measured("mass_kg", "mass", POSITIVE),
    Measured("stroke_mm", "stroke", POSITIVE, *_LENGTH),
    Measured("condition", "condition"),
    Measured("mu_s_gauge", "mu_s_gauge", POSITIVE),
    Measured("trial", "trial", ANY),
    Measured("order", "order", ANY),
    Measured("rest_before_s", "rest_before", NOT_NEGATIVE),
    Measured("peak_force_se_N", "peak_force_se", POSITIVE),
    Measured("sliding_distance_se_um", "sliding_distance_se", POSITIVE, *_SMALL),
    Measured("release_velocity_mm_min", "release_velocity", POSITIVE, *_SPEED),
    Measured("release_velocity_se_mm_min", "release_velocity_se", POSITIVE, *_SPEED),
)
"""All that a table may say, in its order."""

_OF_GROUP = ("velocity", "mass", "stroke", "condition", "mu_s_gauge", "order", "rest_before")
OF_RECORDING = tuple(q for q in QUANTITIES if q.attribute in _OF_GROUP)
"""What the properties of a recording may say."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?", re.ASCII)


def decimal(text: str) -> Decimal | None:
    """The number that the text is, or None."""
    return Decimal(text) if _NUMBER.fullmatch(text) else None


def meant(name: str, known: Iterable[Measured], alike: float = 0.6) -> Measured | None:
    """The quantity that an unknown name seems to mean, in a wrong unit or spelling. `alike`: how
    much two names must have in common, of 1."""
    known = list(known)
    plain = re.sub(r"\W+", "_", name.strip()).strip("_").lower()
    by_stem = [q for q in known if q.unit_name and f"{plain}_".startswith(f"{q.stem}_".lower())]
    exact = [q for q in known if plain == q.key.lower()]
    for found in (exact, sorted(by_stem, key=lambda q: -len(q.stem))):
        if found:
            return found[0]
    close = difflib.get_close_matches(plain, [q.key.lower() for q in known], 1, alike)
    return next((q for q in known if [q.key.lower()] == close), None)


def unknown(name: str, known: Sequence[Measured]) -> str:
    """What to say of a name that the file cannot have."""
    q = meant(name, known)
    if q is None:
        return f"unknown, known: {', '.join(q.key for q in known)}"
    in_unit = f" (in {q.unit_name.replace('mm_min', 'mm/min')})" if q.unit_name else ""
    return f"unknown, expected {q.key}{in_unit}?"


def one_line(problem: str) -> str:
    """A problem as one line of bearable length, whatever the names in it hold."""
    line = " ".join(problem.splitlines())
    return line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."


def told(problems: Sequence[str]) -> str:
    """The problems, a line each; no more than can be read."""
    lines = [one_line(problem) for problem in problems[:MANY]]
    if len(problems) > MANY:
        lines.append(f"and {len(problems) - MANY} more")
    return "\n".join(lines)
