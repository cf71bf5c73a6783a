"""What may be said of a measured push: its names in files, their units and ranges."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal

from difffric.units import Unit, find_unit, list_units
from difffric.value_ranges import ANY, NOT_NEGATIVE, POSITIVE, AbstractQuantity

MANY = 10  # problems that are told one by one
LONGEST = 600  # characters of a line


@dataclass(frozen=True)
class MeasuredQuantity(AbstractQuantity):
    """A measured quantity, as tables and recordings name it."""

    also: tuple[str, ...] = ()
    """what else its name without the unit may be"""

    @property
    def stem(self) -> str:
        """The name without its unit."""
        return split_unit(self.key)[0]

    @property
    def own_unit(self) -> Unit | None:
        """The unit that the name has; None: a plain number or a text."""
        return split_unit(self.key)[1]

    @property
    def unit_name(self) -> str:
        """The unit as the name has it; empty: a plain number."""
        return self.key.removeprefix(self.stem).removeprefix("_")


def split_unit(name: str) -> tuple[str, Unit | None]:
    """(a name without its unit, the unit): of `velocity_mm_min`, `peak force kN`, `v_m_per_s`.
    The unit is None where the name ends with none."""
    words = re.split(r"[_\s]+", name.strip())
    for n in (3, 2, 1):
        tail = words[-n:]
        if len(words) <= n or (n == 3 and tail.pop(1) != "per"):
            continue
        unit = find_unit("/".join(tail))
        if unit is not None:
            rest = words[:-n]
            if len(rest) > 1 and rest[-1].lower() == "in":  # velocity in mm/min
                rest.pop()
            return "_".join(rest), unit
    return name, None


_LENGTH, _SMALL, _SPEED = ("0.001", 1), ("0.000001", 1), ("0.001", 60)
QUANTITIES = (
    MeasuredQuantity("velocity_mm_min", "velocity", POSITIVE, *_SPEED, also=("v", "speed")),
    MeasuredQuantity("peak_force_N", "peak_force", POSITIVE, also=("F_p", "force")),
    MeasuredQuantity(
        "sliding_distance_um", "sliding_distance", POSITIVE, *_SMALL, also=("d", "distance")
    ),
    MeasuredQuantity("mass_kg", "mass", POSITIVE, also=("m",)),
    MeasuredQuantity("stroke_mm", "stroke", POSITIVE, *_LENGTH),
    MeasuredQuantity("condition", "condition"),
    MeasuredQuantity("mu_s_gauge", "mu_s_gauge", POSITIVE),
    MeasuredQuantity("trial", "trial", ANY),
    MeasuredQuantity("order", "order", ANY),
    MeasuredQuantity("rest_before_s", "rest_before", NOT_NEGATIVE),
    MeasuredQuantity("peak_force_se_N", "peak_force_se", POSITIVE),
    MeasuredQuantity("sliding_distance_se_um", "sliding_distance_se", POSITIVE, *_SMALL),
    MeasuredQuantity("release_velocity_mm_min", "release_velocity", POSITIVE, *_SPEED),
    MeasuredQuantity("release_velocity_se_mm_min", "release_velocity_se", POSITIVE, *_SPEED),
)
"""All that a table may say, in its order."""

_OF_GROUP = ("velocity", "mass", "stroke", "condition", "mu_s_gauge", "order", "rest_before")
OF_RECORDING = tuple(q for q in QUANTITIES if q.attribute in _OF_GROUP)
"""What the properties of a recording may say."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?", re.ASCII)


def parse_decimal(text: str) -> Decimal | None:
    """The number that the text is, or None."""
    return Decimal(text) if _NUMBER.fullmatch(text) else None


def find_meant(
    name: str, known: Iterable[MeasuredQuantity], alike: float = 0.6
) -> MeasuredQuantity | None:
    """The quantity that an unknown name seems to mean, in a wrong unit or spelling. `alike`: how
    much two names must have in common, of 1."""
    known = list(known)
    plain = re.sub(r"\W+", "_", name.strip()).strip("_").lower()
    by_stem = [q for q in known if q.unit_name and f"{plain}_".startswith(f"{q.stem}_".lower())]
    exact = [q for q in known if plain == q.key.lower()]
    for found in (exact, sorted(by_stem, key=lambda q: -len(q.stem))):
        if found:
            return found[0]
    # Without units: names of one unit would be alike by it alone.
    stems = {q.stem.lower(): q for q in reversed(known)}
    close = difflib.get_close_matches(split_unit(plain)[0].lower(), stems, 1, alike)
    return stems[close[0]] if close else None


def describe_unknown(name: str, known: Sequence[MeasuredQuantity]) -> str:
    """What to say of a name that the file cannot have."""
    q = find_meant(name, known)
    if q is None:
        return f"unknown, known: {', '.join(q.key for q in known)}"
    if q.own_unit is None:
        return f"unknown, expected {q.key}?"
    return f"unknown, expected {q.key}, or {q.stem} [unit] with {list_units(q.own_unit.of)}"


def shorten_to_line(problem: str) -> str:
    """A problem as one line of bearable length, whatever the names in it hold."""
    line = " ".join(problem.splitlines())
    return line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."


def gather_alike(problems: Sequence[tuple[str, str]], n: int, of: str = "pushes") -> list[str]:
    """Problems (place, what is wrong) as lines; what is wrong in several of the n places is told
    once, with their number and the first of them."""
    places: dict[str, list[str]] = {}
    for place, words in problems:
        places.setdefault(words, []).append(place)
    return [
        f"{at[0]}{words}" + (f" (in {len(at)} of {n} {of})" if len(at) > 1 else "")
        for words, at in places.items()
    ]


def join_problems(problems: Sequence[str]) -> str:
    """The problems, a line each; no more than can be read."""
    lines = [shorten_to_line(problem) for problem in problems[:MANY]]
    if len(problems) > MANY:
        lines.append(f"and {len(problems) - MANY} more")
    return "\n".join(lines)
