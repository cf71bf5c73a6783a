"""Scales what is hidden: to a strength s, or to what it changes of F_p and d."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tests.hidden import simulate
from tests.hidden.case import RECORDINGS_ONLY, TABLE, TABLE_ONLY, Case, amplitude
from tests.hidden.signal import Base, Invisible, base, own_strength, settle

LOUDEST = 10.0
"""times the noise as drawn, where an effect's smallest size is more visible than wanted"""
FIRST = 0.01
"""of the size drawn: where a strength is looked for first"""
GROW = 2.0
"""the factor in the search for a bracket"""
MOST_CUTS, CLOSE = 40, 0.004
"""cuts of a bracket at most; the relative distance that is near enough"""
ACCEPTED = 0.1
"""relative deviation of s from what was asked"""
LEAST_APART = 0.3
"""of two effects' s, what is left of one beside the other: below, they count as inseparable"""


def _factor(
    size_at, wanted: float, least: float, most: float, first: float = 1.0, *, narrow: float
) -> float:
    """The factor within the limits for which size_at is as wanted; log over log."""
    low = high = min(max(first, least), most)
    at_low = at_high = size_at(low)
    while at_low > wanted and low > least:
        high, at_high, low = low, at_low, max(low / 4, least)
        at_low = size_at(low)
    while at_high < wanted and high < most:
        low, at_low, high = high, at_high, min(GROW * high, most)
        at_high = size_at(high)
    if not at_low <= wanted <= at_high:
        raise Invisible(f"between {at_low:.3g} and {at_high:.3g}, wanted {wanted:.3g}")
    for n in range(MOST_CUTS):
        share = 0.5
        if n % 3 < 2 and 0 < at_low < at_high < math.inf:
            share = math.log(wanted / at_low) / math.log(at_high / at_low)
            share = min(max(share, 0.02), 0.98)
        factor = low * (high / low) ** share
        found = size_at(factor)
        if abs(found / wanted - 1) <= CLOSE:
            return factor
        if found < wanted:
            low, at_low = factor, found
        else:
            high, at_high = factor, found
        if high / low < 1 + narrow:  # s jumps there: a sample came or went beside a jump
            break
    for factor, found in ((low, at_low), (high, at_high)):
        if abs(found / wanted - 1) <= ACCEPTED:
            return factor
    raise Invisible(f"{at_low:.3g} jumps to {at_high:.3g}, wanted {wanted:.3g}")


def with_strength(case: Case, s: float) -> Case:
    """Each hidden effect scaled so that its own s, beside the others, is as wanted.

    A lone effect that is more visible even at its smallest sensible size gets louder noise.
    Raises Invisible where nothing of that helps.
    """
    for name in case.hidden:
        case = _to_strength(case, name, s, base(case.only(name)))
    beside = {}
    if len(case.hidden) > 1:
        for name in case.hidden:
            alone, beside[name] = own_strength(case, name)
            if beside[name] < LEAST_APART * alone:
                raise Invisible(f"{name} beside the other: {beside[name]:.3g} of {alone:.3g}")
            case = _to_strength(case, name, s * alone / beside[name], base(case.only(name)))
    for name in case.hidden:  # looked at afresh, and where it ends
        found = own_strength(case, name)[1]
        if not abs(found / s - 1) <= ACCEPTED:
            raise Invisible(f"{name} comes to {found:.3g}, wanted {s:.3g}")
    return case


def _to_strength(case: Case, name: str, s: float, start: Base) -> Case:
    (least, most), alone, narrow = case.factors(name), case.only(name), amplitude(name).narrow
    seen: dict[float, np.ndarray] = {}

    def size_at(factor):
        near = min(seen, key=lambda x: abs(math.log(x / factor)), default=None)
        at = None if near is None else seen[near] * factor / near
        found = settle(alone.scaled(name, factor), start, at)
        if not found.settled:  # too far from any plain rig to say
            return math.inf
        seen[factor] = found.at
        return found.s

    if amplitude(name).least == 0 or (smallest := size_at(least)) <= s:
        first = max(least, min(most, FIRST))
        first = max(least, min(most, 1.0, first * s / max(size_at(first), 1e-3 * s)))
        return case.scaled(name, _factor(size_at, s, least, most, first, narrow=narrow))
    if len(case.hidden) > 1 or smallest > LOUDEST * s:
        raise Invisible(f"{name} is more visible than wanted at any size")
    small = case.scaled(name, least)

    def weakness_at(louder):
        return 1 / settle(with_noise(small, louder), start).s

    louder = _factor(weakness_at, 1 / s, 1.0, LOUDEST * (1 + CLOSE), narrow=narrow)
    return with_noise(small, louder)


def with_noise(case: Case, factor: float) -> Case:
    """With so many times the noise in both channels."""
    noise = case.noise
    louder = replace(noise, force=factor * noise.force, position=factor * noise.position)
    return replace(case, noise=louder)


def changes(case: Case) -> np.ndarray:
    """Relative changes of F_p and d of each push by what is hidden; NaN where there is no d."""
    return simulate.readings(case) / simulate.readings(case.plain()) - 1


def largest_change(case: Case) -> float:
    """Of F_p and d, over the pushes; infinite where a push loses or gains its d."""
    plain, read = simulate.readings(case.plain()), simulate.readings(case)
    if (np.isnan(plain) != np.isnan(read)).any():
        return math.inf
    return float(np.nanmax(np.abs(read / plain - 1)))


def typical_change(case: Case) -> float:
    """Root mean square over the pushes, of F_p or d, whichever is larger."""
    found = changes(case)
    return float(np.sqrt(np.nanmax(np.nanmean(found**2, axis=0))))


def with_change(case: Case, name: str, share: float, change=typical_change) -> Case:
    """One hidden effect scaled so that it alone changes F_p or d by a share."""

    def size_at(factor):
        return change(case.only(name).scaled(name, factor))

    narrow = amplitude(name).narrow
    return case.scaled(name, _factor(size_at, share, *case.factors(name), narrow=narrow))


def with_misfit(case: Case, name: str, times: float) -> Case:
    """One hidden effect scaled so that it alone moves the samples by so many times the noise, root
    mean square, all else as it is."""
    plain = simulate.record(case.plain(), noisy=False)

    def size_at(factor):
        moved = []
        for one, at in zip(
            simulate.record(case.only(name).scaled(name, factor), noisy=False), plain, strict=True
        ):
            n = min(len(one.force), len(at.force))
            moved.append((one.force[:n] - at.force[:n]) / case.noise.force)
            moved.append((one.position[:n] - at.position[:n]) / case.noise.position)
        return math.sqrt(np.mean(np.concatenate(moved) ** 2))

    narrow = amplitude(name).narrow
    return case.scaled(name, _factor(size_at, times, *case.factors(name), narrow=narrow))


def visible(case: Case, name: str) -> bool:
    """Whether such data can show an effect at all: recordings have nothing that is read off, and
    at one mass an extra normal force is a larger mu_s."""
    if name in (TABLE_ONLY if case.kind != TABLE else RECORDINGS_ONLY):
        return False
    return name != "normal_force" or len(case.masses) > 1
