"""Data held against the rig they are said to come from: mass, unit of force, saturation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from difffric.errors import InputError
from difffric.measurements.pushes import Pushes
from difffric.measurements.quantities import gather_alike, join_problems, shorten_to_line
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.rig.rig import Rig
from difffric.rig.sensors import ForceSensor

MASS_TOLERANCE = 0.01
"""Relative: a workshop's scale is better than that, another part is not."""
_CHANCE = 1e-6  # of taking noise for saturation
_SHORTEST = 3  # samples
_FEWEST_ALIKE = 4
"""Pushes with one and the same number from which on that is no accident."""
_FASTER = 1.2
"""Speeds that differ by so much have other forces and distances."""
_FEWEST_SAMPLES = 16
"""Samples below which a channel that stays at one value is not told: it may be short."""

Data = TypeVar("Data", Pushes, Recordings)


def check_data(
    data: Data,
    rig: Rig,
    *,
    use_data_mass: bool = False,
    skip_bad: bool = False,
    keep_saturated: bool = False,
) -> Data:
    """The data, forces in newtons, that can be used with the rig.

    A push's mass must be within 1 % of the rig's, unless `use_data_mass`; then, as always, the
    push's wins. A force is not to be saturated (see `find_saturation`), unless `keep_saturated`.
    Recordings are read through once, by chunks; samples that are not finite are found so. With
    `skip_bad` pushes that fail are left out and told in `.skipped`.

    Raises `InputError` naming the pushes that fail, what is alike once with their number; and where
    none is left.
    """
    problems: dict[int, list[str]] = {}
    if not use_data_mass:
        masses = data.mass if isinstance(data, Pushes) else [push.mass for push in data]
        own = float(rig.mass)
        for i, mass in enumerate(masses):
            if abs(mass - own) > MASS_TOLERANCE * own:
                problems.setdefault(i, []).append(
                    f"mass {mass:.6g} kg, the set-up's is {own:.6g} kg: expected within 1 % "
                    "(--use-data-mass takes the data's)"
                )
    if isinstance(data, Pushes):
        refuse_constant_columns(data)
    else:
        data = data.in_newtons(rig.force_sensor.sensitivity)
        for i, push in enumerate(data):
            problems.setdefault(i, []).extend(_bad_samples(push, rig.force_sensor, keep_saturated))
    told = [(_place(data, i), f": {words}") for i in sorted(problems) for words in problems[i]]
    good = [i for i in range(len(data)) if not problems.get(i)]
    if told and not (skip_bad and good):
        raise InputError(join_problems(gather_alike(told, len(data))))
    lines = [place + words for place, words in told]
    return (
        replace(data.select(good), skipped=(*data.skipped, *map(shorten_to_line, lines)))
        if lines
        else data
    )


def refuse_constant_columns(pushes: Pushes) -> None:
    """Raise `InputError` for forces or distances that are one and the same number at several
    speeds, as of a sensor that is stuck."""
    if pushes.free_slides:
        speeds, columns = pushes.release_velocity, ("sliding_distance",)
    else:
        speeds, columns = pushes.velocity, ("peak_force", "sliding_distance")
    for name in columns:
        values = getattr(pushes, name)
        known = np.isfinite(values)
        if np.count_nonzero(known) < _FEWEST_ALIKE or len(set(values[known])) > 1:
            continue
        if speeds[known].max() > _FASTER * speeds[known].min():
            key = {"peak_force": "peak_force_N", "sliding_distance": "sliding_distance_um"}[name]
            value = values[known][0] * (1.0 if name == "peak_force" else 1e6)
            n = f"{np.count_nonzero(known)} of {len(pushes)}"
            where = f"{pushes.source}: " if pushes.source else ""
            raise InputError(
                f"{where}{key} is {value:.6g} in {n} pushes, at speeds that differ: a sensor that "
                "was stuck? Then leave the column out"
            )


def find_saturation(force: Channel, limit: float) -> float | None:
    """The level [N] at which a force is saturated, or None.

    It is where a sample reaches the sensor's `limit`, and where the extreme value stands in so
    many consecutive samples that noise would do that once in a million recordings: three where
    no other neighbours are equal, more where quantisation makes equal neighbours frequent.
    """
    seen = _Extreme()
    for samples in force.chunks():
        seen.add(samples)
    if seen.level >= limit:
        return seen.level
    # The share of equal neighbours elsewhere is the chance that a run goes on.
    share = min((seen.equal - seen.equal_at_level + 1) / (force.n + 1), 1 - 1e-9)
    needed = max(_SHORTEST, 1 + math.ceil(math.log(_CHANCE) / math.log(share)))
    return seen.level if seen.level > 0 and seen.longest >= needed else None


@dataclass
class _Extreme:
    """The largest magnitude of samples that come by chunks, and how long they stay there."""

    level: float = -1.0
    longest: int = 0
    """consecutive samples at the level, with one sign"""
    equal: int = 0
    """pairs of equal neighbours"""
    equal_at_level: int = 0
    last: float = math.nan
    running: int = 0
    """samples at the level up to the last one"""

    def add(self, samples: NDArray) -> None:
        if len(samples) == 0:
            return
        high, low = float(samples.max()), float(samples.min())
        top = max(high, -low)
        if top > self.level:
            self.level, self.longest, self.equal_at_level, self.running = top, 0, 0, 0
        same = np.concatenate([[samples[0] == self.last], samples[1:] == samples[:-1]])
        self.equal += int(np.count_nonzero(same))
        at = np.abs(samples) == self.level if top == self.level else np.zeros(len(samples), bool)
        self.equal_at_level += int(np.count_nonzero(same & at))
        if at.any() or self.running:
            # Each position at which a run is broken; a run lasts from one to the next.
            breaks = np.flatnonzero(~at | ~same)
            first = int(breaks[0]) if len(breaks) else len(samples)
            self.longest = max(self.longest, self.running + first)
            starts = breaks[at[breaks]]
            ends = np.append(breaks, len(samples))
            lengths = ends[np.searchsorted(ends, starts, side="right")] - starts
            if len(lengths):
                self.longest = max(self.longest, int(lengths.max()))
            if not at[-1]:
                self.running = 0
            elif len(breaks):
                self.running = len(samples) - int(breaks[-1])
            else:
                self.running += len(samples)
        self.last = float(samples[-1])


def _bad_samples(push: Recording, sensor: ForceSensor, keep_saturated: bool) -> list[str]:
    """What is wrong with the samples of a recording; all are read."""
    problems = []
    for channel in (push.position, push.pusher, push.force):
        try:
            value = None if channel is None else find_only_value(channel)
            if channel is not None and value is not None and (value or channel is not push.force):
                problems.append(describe_constant(push, channel, value))
            elif channel is push.force and channel is not None and not keep_saturated:
                level = find_saturation(channel, float(sensor.range))
                if level is not None:
                    problems.append(
                        f"force saturated at {level:.6g} N (the sensor's range is "
                        f"{float(sensor.range):g} N): expected a force that stays below"
                    )
        except InputError as error:
            problems.append(str(error))
    return problems


def find_only_value(channel: Channel) -> float | None:
    """The value of all samples of a channel, or None where they differ; all are read."""
    low, high = math.inf, -math.inf
    for samples in channel.chunks():
        if len(samples):
            low, high = min(low, float(samples.min())), max(high, float(samples.max()))
    return low + 0.0 if low == high and channel.n >= _FEWEST_SAMPLES else None  # no -0


def describe_constant(push: Recording, channel: Channel, value: float) -> str:
    """What to say of a channel that stays at one value."""
    if channel is push.force:
        return f"force is {value:.6g} {channel.unit} throughout: is the sensor connected?"
    name = "position" if channel is push.position else "pusher"
    why = "the probe never moved: leave the channel out" if name == "position" else "it never moved"
    return f"{name} is {value * 1e6:.6g} um throughout: {why}"


def _place(data: Pushes | Recordings, i: int) -> str:
    where = f"{data.source}: " if data.source else ""
    if isinstance(data, Recordings) and data[i].name:
        return f"{where}group {data[i].name!r}"
    return f"{where}push {i + 1} of {len(data)}"
