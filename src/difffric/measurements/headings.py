"""What a name in a file means: which quantity, in which unit, and what was converted.

A name may be the quantity's own (`peak_force_N`), have another unit (`peak_force_kN`, `Peak force
[kN]`, `F_p (lbf)`, `force / mN`), or be one that the reader was told the meaning of (`Kraft`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from difffric.measurements.quantities import (
    MeasuredQuantity,
    describe_unknown,
    find_meant,
    split_unit,
)
from difffric.units import Unit, find_unit, list_units

_BRACKETS = re.compile(r"(.*?)\s*[\[(<{]\s*([^\[\](){}<>]*?)\s*[\])>}]\s*\.?")
_AFTER = re.compile(r"(.*?)(?:\s+/\s*|\s*,\s*|\s+in\s+|\s+)(\S+(?:\s*/\s*\S+)?)")


@dataclass(frozen=True)
class Heading:
    """A name in a file, and what is meant by it."""

    quantity: MeasuredQuantity
    """its key is the name as the file has it, its unit the file's"""
    note: str = ""
    """what a person should know of it: a conversion, a unit that was taken for granted"""


class HeadingError(ValueError):
    """A name that cannot be used; the message says why. `near`: the attribute of the quantity
    that it seems to mean, if any."""

    def __init__(self, words: str, near: str | None = None):
        super().__init__(words)
        self.near = near


def read_heading(
    name: str,
    known: Sequence[MeasuredQuantity],
    unit: str = "",
    meant: str = "",
) -> Heading:
    """What a name in a file means; `unit` is what the file says of its unit elsewhere, `meant`
    the quantity's name, with or without a unit, where the reader was told it.

    Raises `HeadingError` for a name or unit that is not known.
    """
    exact = next((q for q in known if q.key == name), None)
    if exact and not meant and not unit:
        return Heading(exact)
    said = unit.strip() or separate_unit(name)[1]
    if meant:
        q, of_meaning = find_quantity(meant, known), separate_unit(meant)[1]
        if q is None:
            raise HeadingError(describe_unknown(meant, known))
        said = said if find_unit(said) else of_meaning or said
        if not said and q.own_unit is not None:
            own = q.own_unit.symbol
            note = f"no unit: taken as {own} (--channel {q.stem}_{_OTHER[own]}=... says another)"
            return Heading(replace(q, key=name), note)
    else:
        q = find_quantity(name, known)
        if q is None:
            close = find_meant(name, known)
            raise HeadingError(describe_unknown(name, known), close.attribute if close else None)
    if q.own_unit is None:
        if q.range is None or find_unit(said) is None:
            return Heading(replace(q, key=name))
        raise HeadingError(f"in {said}, expected {q.key}, which has no unit", q.attribute)
    if not said:
        raise HeadingError(describe_unknown(name, known), q.attribute)
    return _convert(name, q, said)


def _convert(name: str, q: MeasuredQuantity, said: str) -> Heading:
    """The heading of a quantity in the unit that the file says."""
    own, found = q.own_unit, find_unit(said)
    assert own is not None
    if found is None:
        raise HeadingError(
            f"unit {said!r} is not known, expected {list_units(own.of)}", q.attribute
        )
    if found.of != own.of:
        words = f"in {found.symbol}, expected {q.stem} in {list_units(own.of)}"
        raise HeadingError(words, q.attribute)
    read = replace(q, key=name, unit=found.factor, per=found.per)
    if (found.factor, found.per) == (q.unit, q.per):
        return Heading(read)
    return Heading(read, f"converted from {found.symbol}")


def find_quantity(name: str, known: Sequence[MeasuredQuantity]) -> MeasuredQuantity | None:
    """The quantity of a name, whatever unit the name has or lacks; capitals, blanks and
    underscores do not count."""
    for candidate in (name, separate_unit(name)[0]):
        plain = _squash(candidate)
        for q in known:
            if plain in {_squash(x) for x in (q.key, q.stem, *q.also)}:
                return q
    return None


def separate_unit(name: str) -> tuple[str, str]:
    """(a name without its unit, the unit as it stands there; empty where there is none)."""
    if found := _BRACKETS.fullmatch(name):
        return found[1], found[2]
    if (found := _AFTER.fullmatch(name)) and find_unit(found[2]):
        return found[1], found[2]
    stem, unit = split_unit(name)
    return stem, unit.symbol if unit else ""


def find_unit_of(name: str, unit: str = "") -> Unit | None:
    """The unit that a name, or the row of units below it, says."""
    return find_unit(unit or separate_unit(name)[1])


def resolve_channels(
    channels: Mapping[str, str], names: Sequence[str], known: Sequence[MeasuredQuantity]
) -> tuple[dict[str, str], list[str]]:
    """(name in the file -> what it was said to mean, what is wrong with `channels`).

    `channels` has the name in the file by our own name; a name in the file may be given without
    its unit, or, for a column, by its number from 1. What `known` has not is passed over:
    `find_unknown` tells it.
    """
    meanings: dict[str, str] = {}
    problems: list[str] = []
    for ours, theirs in channels.items():
        if find_quantity(ours, known) is None:
            continue
        found = _find_named(theirs, names)
        if found is None:
            listed = ", ".join(names) or "none"
            problems.append(f"channel {ours} = {theirs!r}: not there, found: {listed}")
        elif found in meanings:
            problems.append(f"channel {ours} = {theirs!r}: it is {meanings[found]} already")
        else:
            meanings[found] = ours
    return meanings, problems


def find_unknown(channels: Mapping[str, str], known: Sequence[MeasuredQuantity]) -> list[str]:
    """What is wrong with the names of `channels` that are to be ours: neither files with `known`
    quantities have them, nor other kinds of files."""
    problems = []
    for ours, theirs in channels.items():
        if find_quantity(ours, (*known, *OF_ANY_FILE)) is not None:
            continue
        if find_quantity(theirs, known) is not None:
            remedy = f"is not ours; write it as {theirs}={ours}?"
        else:
            remedy = f"is unknown, known: {', '.join(q.stem for q in known)}"
        problems.append(f"channel {ours} = {theirs!r}: {ours} {remedy}")
    return problems


def _find_named(theirs: str, names: Sequence[str]) -> str | None:
    """The name in the file that a person means: as it stands there, in other capitals, without
    its unit, or by its number."""
    ways = (str.strip, _squash, lambda x: _squash(separate_unit(x)[0]))
    for wanted, way in zip((theirs.strip(), _squash(theirs), _squash(theirs)), ways, strict=True):
        found = [name for name in names if way(name) == wanted]
        if len(found) == 1:
            return found[0]
    number = int(theirs) if theirs.strip().isdecimal() else 0
    return names[number - 1] if 0 < number <= len(names) else None


def ask_for_names(
    missing: Sequence[Sequence[MeasuredQuantity]], names: Sequence[str], units: Sequence[str]
) -> str:
    """The options that say which names in a file are the missing quantities: a message's remedy.
    Of each group one is missing at least; names whose units fit are proposed."""
    asked: list[str] = []
    taken: set[str] = set()
    for group in missing:
        fits: list[str] = []
        for q in group:
            of = q.own_unit.of if q.own_unit else None
            for name, unit in zip(names, units, strict=True):
                found = find_unit_of(name, unit)
                if name not in taken and found is not None and found.of == of:
                    taken.add(name)
                    fits.append(f"--channel {q.stem}={_quote(name)}")
                    break
        asked += fits or [f"--channel {group[0].stem}=NAME"]
    return " ".join(asked)


def _quote(name: str) -> str:
    return name if re.fullmatch(r"[\w.]+", name) else f"'{name}'"


def _squash(name: str) -> str:
    return re.sub(r"[\W_]+", "", name).casefold()


_OTHER = {
    "N": "kN",
    "V": "mV",
    "m": "mm",
    "um": "mm",
    "mm": "m",
    "s": "ms",
    "mm/min": "m_per_s",
    "m/s": "mm_min",
    "kg": "g",
}
"""A unit to show by that another one is possible."""

OF_ANY_FILE = tuple(
    MeasuredQuantity(key, key)
    for key in (
        *("velocity", "peak_force", "sliding_distance", "mass", "stroke", "condition"),
        *("mu_s_gauge", "trial", "order", "rest_before", "release_velocity", "force", "position"),
        *("pusher", "time", "drive", "stretch", "distance", "speed"),
    )
)
"""Names that files of one kind or another have: a set-up may say them for all of its files."""
