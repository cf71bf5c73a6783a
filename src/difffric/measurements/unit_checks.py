"""Units that are plainly wrong, said before anything is fitted: distances that look like mm.

Two numbers of a table tell, without a fit, how its columns agree with the physics and with the
set-up, which counts as an order of magnitude only:

- reach: the farthest slide of all pushes over that of a part let go at the pusher's speed.
  The contact gives back at most twice the speed, so the reach is at most 4, whatever k and b are;
  and it is far below 1 only where every push was let go at the edge of sticking.
- load: the forces over mu_s m g + v (sqrt(k m) + b), the order of what a push takes.

Where they are off, and one other unit in one column brings both back, it is said.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from difffric.errors import InputError
from difffric.measurements.checks import (
    describe_constant,
    find_only_value,
    refuse_constant_columns,
)
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.measurements.reduction.reduce import reduce_recordings
from difffric.rig.friction import innermost
from difffric.rig.rig import Rig
from difffric.units import GRAVITY

_REACH = (-2.1, 1.25)
"""log10 of a reach that may be: at most 4, with a mu_k that is a few times off; a hundredth is
below what pushes at several speeds can all have."""
_FITTING = (-0.95, 0.95)
"""log10 of reach or load that another unit has to lead to."""
_LOAD = (-2.0, 2.0)
"""log10 of a load that may be: the square root of a k that is four orders off."""
_LEAST_MU = 0.01
"""No sliding contact is so slippery, nor moves a part under less than this times its weight."""
_MOST_MU = 5.0
"""A mu_k that a slide let go at the pusher's speed does not have."""
_ROUND = 5.0
"""Angle [rad] of the contact's oscillation that a stroke is to last, so that the part, even at a
third of the frequency, comes to the pusher's speed."""
_SURE = 10.0
"""Times that the force of a stroke's whole compression exceeds what moves the part."""
_SPAN = 1.5
"""Speeds that differ by so much cannot all be at the edge of sticking."""
_FEW = 3
"""Pushes below which wrong units are only noted."""
_MOST_READ = 20
"""Recordings that are looked at: units are the same in all."""
_MASS_AGREES = 0.02
"""Relative: how well 1000 times a mass is the set-up's."""


@dataclass(frozen=True)
class Suspicion:
    """What seems to be wrong with the unit of a column, and what to do about it."""

    text: str
    impossible: bool
    """whether the data cannot be as they stand"""


@dataclass(frozen=True)
class _Guess:
    """A column in another unit than its heading's."""

    column: str
    """a field of `Pushes`"""
    factor: float
    """what the numbers as they were read are to be multiplied by"""
    seems: str
    """`distances look like mm`"""
    expected: str
    """the unit that goes without saying"""
    unit: str = ""
    """that the numbers seem to have"""

    def advise(self, of_recordings: bool) -> str:
        """What was expected, and what to do."""
        name = f"{self.column}_{self.unit.replace('/', '_per_')}"
        signal = {"sliding_distance": "position", "peak_force": "force"}.get(self.column)
        if not self.unit:
            return f"expected {self.expected}"
        if of_recordings and signal:
            do = f"give the channel {signal} the unit_string {self.unit}"
        else:
            do = f"call the {'property' if of_recordings else 'column'} {name}"
        return f"expected {self.expected}: {do}"


def _list_guesses() -> Iterator[_Guess]:
    """Other units that a column may be in, the usual ones."""
    for column, what, expected, units in (
        ("sliding_distance", "distances", "um", (("mm", 1e3), ("in", 25400.0), ("m", 1e6))),
        ("velocity", "speeds", "mm/min", (("mm/s", 60.0), ("m/s", 6e4), ("in/min", 25.4))),
        ("release_velocity", "speeds", "mm/min", (("mm/s", 60.0), ("m/s", 6e4))),
        ("peak_force", "forces", "N", (("kN", 1e3), ("mN", 1e-3))),
    ):
        for unit, factor in units:
            yield _Guess(column, factor, f"{what} look like {unit}", expected, unit)


def refuse_wrong_units(data: Pushes | Recordings, rig: Rig) -> tuple[str, ...]:
    """What is to be noted of the units of measured data, a line each.

    Raises `InputError` where the data cannot be as they stand, and another unit in one of their
    columns would make them agree.
    """
    source = data.source
    if isinstance(data, Recordings):
        few = data.select(np.unique(np.linspace(0, len(data) - 1, _MOST_READ).round().astype(int)))
        _refuse_no_force(few, source)
        try:
            reduction = reduce_recordings(
                few.in_newtons(rig.force_sensor.sensitivity), skip_bad=True
            )
        except InputError:  # which is told where it is asked for
            return ()
        found = find_wrong_units(reduction.pushes, rig, of_recordings=True)
    else:
        refuse_constant_columns(data)  # or their unit would be blamed
        found = find_wrong_units(data, rig)
    impossible = [x.text for x in found if x.impossible]
    if impossible:
        where = f"{source}: " if source else ""
        override = "(--trust-units takes them as they are)"
        raise InputError("\n".join(f"{where}{text} {override}" for text in impossible))
    return tuple(x.text for x in found)


def _refuse_no_force(data: Recordings, source: str) -> None:
    """Raise `InputError` where the force stays at one value in every recording: a push or two
    without a force may be, a file of them has no sensor."""
    values = [None if r.force is None else find_only_value(r.force) for r in data]
    if all(value is not None for value in values):
        (first, *_), (value, *_) = data, values
        assert first.force is not None and value is not None
        words = describe_constant(first, first.force, value)
        raise InputError(f"{source}: {words} (in {len(data)} of {len(data)} pushes looked at)")


def find_wrong_units(data: Pushes, rig: Rig, *, of_recordings: bool = False) -> list[Suspicion]:
    """Columns of a table whose unit seems to be wrong, by the physics and the set-up.

    A mass in grams, of the data or of the set-up; else, where reach or load are off, the other unit
    of a column that brings both back, in one line, with what else would do. `of_recordings`: the
    numbers are taken off recordings, whose remedy is another.
    """
    own = float(rig.mass)
    masses = data.mass[np.isfinite(data.mass)]
    for factor, words in (
        (1e-3, "masses look like g, expected kg: call it mass_g"),
        (
            1e3,
            "the set-up's mass looks like g, expected kg: write mass_kg = "
            f"{masses[0] if len(masses) else own:.6g}",
        ),
    ):
        if len(masses) and np.all(abs(masses * factor - own) <= _MASS_AGREES * own):
            other = "the set-up's is" if factor < 1 else "those of the data are"
            said = f"the data have {masses[0]:.6g} kg and the set-up mass_kg = {own:.6g}"
            return [Suspicion(f"{words}, unless {other} in t ({said})", True)]
    reach, load = _measure(data, rig)
    low, high = _find_friction_bounds(data)
    far = reach > _REACH[1] and high < _LEAST_MU
    near = reach < _REACH[0] and low > _MOST_MU and _tells_short_slides(data, rig)
    heavy = not _is_within(load, _LOAD)
    if not (far or near or heavy):
        return []
    fits = []
    for guesses, other, lighter in _try_others(data, rig):
        new_reach, new_load = _measure(other, lighter)
        reach_fits = _is_within(new_reach, _FITTING if far or near else _REACH)
        if reach_fits and _is_within(new_load, _FITTING if heavy else _LOAD):
            off = abs(np.nan_to_num(new_reach)) + abs(np.nan_to_num(new_load))
            fits.append((len(guesses), off, guesses))
    if not fits:
        return []
    fits.sort(key=lambda fit: fit[:2])
    count, _, best = fits[0]
    others = ["".join(g.seems for g in one) for n, _, one in fits[1:3] if n == count == 1]
    words = "; ".join(f"{guess.seems}, {guess.advise(of_recordings)}" for guess in best)
    doubt = f" (or {' or '.join(others)})" if others else ""
    why = _describe(data, rig, reach if far or near else math.nan, load)
    impossible = far or near or _find_least_force(data, rig) < _LEAST_MU
    return [Suspicion(f"{words}{doubt}; as they stand {why}", impossible and len(data) >= _FEW)]


def _try_others(data: Pushes, rig: Rig) -> Iterator[tuple[list[_Guess], Pushes, Rig]]:
    """(what is guessed, the data then, the rig then): one column in another unit, the set-up's
    mass in grams where the data say none, and a force in another unit beside another column."""
    guesses = [g for g in _list_guesses() if np.isfinite(getattr(data, g.column)).any()]
    for guess in guesses:
        other = replace(data, **{guess.column: getattr(data, guess.column) * guess.factor})
        yield [guess], other, rig
        for force in guesses:
            if force.column == "peak_force" != guess.column:
                both = replace(other, peak_force=data.peak_force * force.factor)
                yield [force, guess], both, rig
    if not np.isfinite(data.mass).any():
        own = float(rig.mass)
        guess = _Guess("mass", 1.0, f"the set-up's mass_kg = {own:g} looks like g", "kg")
        yield [guess], data, replace(rig, mass=own / 1000.0)


def _is_within(value: float, bounds: tuple[float, float]) -> bool:
    """Whether a number is within bounds; one that nothing was measured of is."""
    return math.isnan(value) or bounds[0] <= value <= bounds[1]


def _find_friction_bounds(data: Pushes) -> tuple[float, float]:
    """Bounds of mu_k by the slides alone, whatever k, b and the set-up are: the least that a part
    let go at the pusher's speed has, and the most of one that was let go at twice the speed."""
    v = _read_speeds(data)
    with np.errstate(all="ignore"):
        mu = v**2 / (2.0 * GRAVITY * data.sliding_distance)
    known = mu[np.isfinite(mu)]
    return (float(known.min()), 4.0 * float(known.min())) if len(known) else (math.nan, math.nan)


def _tells_short_slides(data: Pushes, rig: Rig) -> bool:
    """Whether slides that are all far too short cannot be: those of several pushes, at speeds that
    are not all at the edge of sticking, and whose strokes lasted long enough to speed the part up,
    even were the contact ten times softer than the set-up's."""
    v, known = _read_speeds(data), np.isfinite(data.sliding_distance)
    if not data.free_slides:
        m, (k, _), stroke = _read_masses(data, rig), _read_contact(rig), _read_strokes(data, rig)
        known &= np.sqrt(k / m) * stroke > _ROUND * v
    fast = v[known]
    return len(fast) >= _FEW and fast.max() >= _SPAN * fast.min()


def _describe(data: Pushes, rig: Rig, reach: float, load: float) -> str:
    """What is off as the data stand, in words."""
    words = []
    if not _is_within(reach, _REACH):
        how = f"{10**reach:.2g} times as far as a part let go at the pusher's speed"
        words.append(f"the farthest slide goes {how}")
    least = _find_least_force(data, rig)
    if least < _LEAST_MU:
        words.append(f"the part moved under {least:.2g} times its weight")
    elif not _is_within(load, _LOAD):
        words.append(f"forces are {10**load:.2g} times what the set-up leads to")
    return " and ".join(words)


def _measure(data: Pushes, rig: Rig) -> tuple[float, float]:
    """(log10 of the reach, log10 of the load), NaN where nothing tells."""
    v, d, m = _read_speeds(data), data.sliding_distance, _read_masses(data, rig)
    friction = innermost(rig.friction)
    mu_s = float(getattr(friction, "mu_s", np.nan))
    ratio = float(getattr(friction, "mu_k_over_mu_s", 1.0))
    k_v = float(getattr(friction, "k_v", 0.0))
    k, b = _read_contact(rig)
    with np.errstate(all="ignore"):
        reach = d / _slide(v, m, mu_s * ratio, k_v)
        moved = np.isfinite(d)
        if not moved.any():  # by force alone only where the stroke is sure to have moved the part
            moved = k * _read_strokes(data, rig) > _SURE * mu_s * m * GRAVITY
        expected = mu_s * m * GRAVITY + np.nan_to_num(v) * (np.sqrt(k * m) + b)
        load = np.where(moved, data.peak_force / expected, np.nan)
    return _log10_of(np.max, reach), _log10_of(np.median, load)


def _read_masses(data: Pushes, rig: Rig) -> NDArray:
    return np.where(np.isfinite(data.mass), data.mass, float(rig.mass))


def _read_contact(rig: Rig) -> tuple[float, float]:
    """(k, b) of a set-up; k is NaN where its law has none."""
    contact = innermost(rig.contact)
    return float(getattr(contact, "k", np.nan)), float(getattr(contact, "b", 0.0))


def _read_strokes(data: Pushes, rig: Rig) -> NDArray:
    """(n,) strokes [m]; infinite where none is known."""
    own = getattr(innermost(rig.pusher), "stroke", None)
    return np.where(np.isfinite(data.stroke), data.stroke, np.inf if own is None else float(own))


def _log10_of(summary, values: NDArray) -> float:
    known = values[np.isfinite(values) & (values > 0)]
    return float(np.log10(summary(known))) if len(known) else math.nan


def _slide(v: NDArray, m: NDArray, mu_k: float, k_v: float) -> NDArray:
    """(n,) how far [m] a part slides that is let go at a speed [m/s]: the integral of
    u du / (mu_k g + k_v u / m)."""
    free = v**2 / (2.0 * mu_k * GRAVITY)
    x = k_v * v / (mu_k * m * GRAVITY)
    series = 1.0 - 2.0 * x / 3.0
    whole = 2.0 * (x - np.log1p(x)) / np.where(x > 0, x, 1.0) ** 2
    return free * np.where(x < 1e-3, series, whole)


def _read_speeds(data: Pushes) -> NDArray:
    return np.where(np.isfinite(data.velocity), data.velocity, data.release_velocity)


def _find_least_force(data: Pushes, rig: Rig) -> float:
    """The least force that moved the part, over its weight; infinite where none is known to."""
    share = data.peak_force / (_read_masses(data, rig) * GRAVITY)
    return float(np.nanmin(np.append(share[np.isfinite(data.sliding_distance)], np.inf)))
