"""A fleet's diagnosis in words: the effects that rigs share, and the rigs that differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from difffric.fleet.meta_analysis import Pooled
from difffric.fleet.shared_effects import CAUSES, KNOWN, OWN, SIZE, Combined, Different, Shared
from difffric.number_text import format_number, format_pair
from difffric.rig.catalogue import CATALOGUE

_HETEROGENEOUS = 0.01
"""p-value of Cochran's Q below which a shared size is said to differ from rig to rig."""
LINES = 12
"""Differences that have a line of their own; more would not fit on a terminal."""
_MANY = 6
"""Rigs that a line names one by one; more would not fit in it."""


@dataclass(frozen=True)
class FleetDiagnosis:
    """What the rigs of a fleet share, and which of them differ."""

    folder: Path
    answers: dict[str, dict]
    """rig -> its answer, as `rigs/RIG/result.json` holds it"""
    found: Combined
    """effects over rigs, and the shared ones with their sizes"""
    excess: dict[tuple[str, str], float]
    """(effect, rig without it) -> by how much its -2 log likelihood grows with the others' size"""
    differ: tuple[Different, ...]
    bad: tuple[tuple[str, str], ...]
    """(rig, why) of those that could not be diagnosed"""
    fresh: int = 0
    """rigs that were diagnosed in this run; the others were known"""
    asked: int = 0
    """rigs that were held against a shared effect in this run"""

    def __str__(self) -> str:
        return "\n".join(["[[Fleet diagnosis]]", *(f"    {line}" for line in summarise(self))])


def summarise(found: FleetDiagnosis) -> list[str]:
    """Return the lines that a person reads first."""
    n, every = len(found.answers), list(found.found.shared)
    out = []
    if n == 1:
        (rig,) = found.answers
        out.append(f"One rig, {rig}: nothing can be compared. Two are needed to share an effect.")
        named = [c["id"] for c in found.answers[rig]["diagnosis"]["causes"]]
        if named:
            out.append(f"Its causes: {', '.join(named)}.")
    elif not every:
        out.append(f"{n} rigs share no effect that their pushes show.")
    out += [_describe_shared(one, n) for one in every]
    if n > 1:
        out += [
            f"Rig {x.rig} differs: {describe_difference(found, x)}." for x in found.differ[:LINES]
        ]
        if len(found.differ) > LINES:
            out.append(f"So do others, {len(found.differ) - LINES} times, listed below.")
        if not found.differ:
            out.append("No rig differs from the others.")
    elif found.found.unexplained:
        out.append("Its misfit is unexplained.")
    if found.bad:
        rigs = _list_rigs([rig for rig, _ in found.bad])
        count = "1 rig" if len(found.bad) == 1 else f"{len(found.bad)} rigs"
        out.append(f"{count} could not be diagnosed: {rigs}.")
    return out


def _describe_shared(one: Shared, n: int) -> str:
    """Return a sentence on a shared effect in a fleet of n rigs."""
    sizes = ", ".join(f"{key} = {_word_size(x)}" for key, x in one.parameters.items())
    effect = f"{one.effect}" + (f" ({sizes})" if sizes else "")
    if one.by == CAUSES:
        line = f"{len(one.rigs)} of {n} rigs share {effect}"
        if not one.common:
            line += f": {_list_rigs(one.rigs)}"
    else:
        line = (
            f"At least {one.row.at_least} of {n} rigs share {effect}, which all of them show "
            "together and too weakly to be named in each"
        )
    known = [rig for rig, mark in one.row.marks.items() if mark == KNOWN]
    if known:
        line += f"; it stands in the set-up of {_list_rigs(known)} already"
    if one.alike:
        line += f"; {' or '.join(one.alike)} would do as well"
    if any(x.p_value < _HETEROGENEOUS for x in one.parameters.values()):
        line += "; its size differs from rig to rig"
    return line + "."


def _word_size(x: Pooled) -> str:
    value, error = format_pair(x.value, x.standard_error)
    return f"{value} ± {error}"


def _list_rigs(rigs: Sequence[str]) -> str:
    """Name rigs in alphabetical order, and count those beyond `_MANY`."""
    rest = len(rigs) - _MANY
    return ", ".join(sorted(rigs)[:_MANY]) + (f" and {rest} more" if rest > 0 else "")


def describe_effect(effect: str) -> str:
    """Return what an effect is, in words."""
    return CATALOGUE[effect].text if effect in CATALOGUE else "mu_k / mu_s is not the set-up's"


def describe_difference(found: FleetDiagnosis, x: Different) -> str:
    """Return how a rig differs, in words."""
    if x.effect is None:
        location = found.answers[x.rig]["diagnosis"]["location"]
        where = f", and sits in: {location.replace('_', ' ')}" if location else ""
        return f"its misfit is unexplained{where}"
    if x.how == OWN:
        cause = next(c for c in found.answers[x.rig]["diagnosis"]["causes"] if c["id"] == x.effect)
        sizes = ", ".join(
            f"{key} = {' ± '.join(format_pair(p['value'], p['standard_error']))}"
            for key, p in cause["parameters"].items()
        )
        alike = " or ".join(cause["confusable_with"])
        return f"it alone has {x.effect} ({sizes})" + (f", or {alike}" if alike else "")
    one = next(s for s in found.found.shared if s.effect == x.effect)
    p = format_number(x.p_value, 2)
    if x.how == SIZE:
        key = min(one.odd[x.rig], key=lambda k: one.odd[x.rig][k])
        own = " ± ".join(format_pair(*one.sizes[key][x.rig]))
        others = _word_size(one.parameters[key])
        return f"its {key} of {x.effect} is {own}, the others' {others} (p = {p})"
    excess = format_number(found.excess[x.effect, x.rig], 3)
    return (
        f"it has no {x.effect}, and would have shown it: with the others' size -2 log L is "
        f"{excess} worse (p = {p})"
    )
