"""The combination of causes that explains a table best, looked for on many sides at once.

From the barest contact, a spring, one part is added after the other: the dampers of equations (1)
and (2), which count like any other, and the effects of the catalogue. At each stage the best few
combinations go on, each with every part that it lacks, from every size that this may have.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.combinations.robust_descent import KnownFriction, Points
from difffric.diagnosis.starting_values import find_contact_time, list_starting_values
from difffric.estimation.effect_coordinates import PLAIN
from difffric.progress import Tell, silent
from difffric.rig.catalogue import RATIO, numbers_of
from difffric.rig.scales import Scales

DAMPING, VISCOSITY = "b_N_s_per_m", "k_v_N_s_per_m"
"""The parts of the plain model that may be missing."""
STIFFNESS = "k_N_per_m"
MOST = 4
"""Parts beside the spring at most."""
_BEAM = 8
"""Combinations that go on to the next stage."""
_PAIRED, _PAIRS_UP_TO = 3, 3
"""Combinations that are also tried with two parts more at once, as one may show only beside another
and up to how many parts."""
_FEW = 4
"""Sizes of a part that are tried beside another one."""
_SURE = 2
"""Combinations of which every extension is followed."""
_RANKED, _EACH = 32, 2
"""Points of a stage that are worth a descent, and how many of one combination."""
_FIRST, _LAST = 4, 10
"""Steps of it, and of the best ones' after that."""
_FINALISTS = 14
"""Combinations that get those."""
_SOFTER = (0.7, 0.85, 1.0, 1.2)
"""Shares of the given stiffness from which the search starts."""
_STIFFER = np.log(1.5)
"""By how much the contact is stiffer at a second start with a damper on approach."""
_LONGEST = 5.0
"""Contact times that a tip goes on for, at most."""
_NONE = -30.0
"""The logarithm of a damping that is none."""


@dataclass(frozen=True)
class CauseCombination:
    """A spring with some parts, where it fits best."""

    parts: frozenset[str]
    """effects of the catalogue, and the plain model's own dampers"""
    points: Points
    """the one where it fits best"""
    cost: float
    penalised: float
    """with what its numbers would buy in any case"""


class _Start(NamedTuple):
    """Where a combination is looked for."""

    parts: frozenset[str]
    c: NDArray
    """(K,)"""
    free: tuple[int, ...]


@dataclass(frozen=True)
class BeamSearch:
    """What a search is given."""

    table: KnownFriction
    scales: Scales
    effects: Sequence[str]
    """those that are looked for"""
    base: NDArray
    """(K,) coordinates of the plain rig as it was given"""
    tell: Tell = silent

    @property
    def price(self) -> float:
        """What one number must buy (Schwarz's criterion)."""
        return float(np.log(2 * len(self.table.log_mu)))

    def run(self) -> list[list[CauseCombination]]:
        """The combinations of each stage, the best first: the spring alone, one part, two, ..."""
        stages = [self._start()]
        for count in range(1, MOST + 1):
            # There are more of them the more parts they have, and each takes longer.
            self.tell(f"combinations of {count}", 0.9 * ((count - 1) / MOST) ** 2)
            starts = self._add_parts(stages[-1], 1)
            if 1 < count <= _PAIRS_UP_TO:
                starts += self._add_parts(stages[-2][:_PAIRED], 2)
            best = [one.parts for one in stages[-1][:_SURE]]
            sure = {s.parts for s in starts if any(s.parts > x for x in best)}
            stages.append(self._choose(starts, sure))
        return stages

    def refine(self, one: CauseCombination) -> CauseCombination:
        """The combination at its optimum, as far as a longer descent leads."""
        points, cost = self.table.descend(one.points, 3 * _LAST)
        return self._make(one.parts, points, float(cost[0]))

    def leave_out_each(self, one: CauseCombination) -> dict[str, CauseCombination]:
        """The combination without each of its parts, all else fitted anew."""
        if not one.parts:
            return {}
        parts, rows, free = sorted(one.parts), [], []
        for part in parts:
            index = self._list_numbers(part)
            c = one.points.c[0].copy()
            c[index] = self._find_none(part)
            rows.append(c)
            free.append(tuple(i for i in one.points.free[0] if i not in index))
        points, cost = self.table.descend(Points(np.array(rows), tuple(free)), 2 * _LAST)
        return {
            part: self._make(one.parts - {part}, points.pick(np.array([j])), float(cost[j]))
            for j, part in enumerate(parts)
        }

    def list_swapped(self, one: CauseCombination) -> list[CauseCombination]:
        """The combinations that have another part in place of one, the best first."""
        if not one.parts:
            return []
        names = self.table.model.coordinates.names
        starts = []
        for part in one.parts:
            c = one.points.c[0].copy()
            gone = self._list_numbers(part)
            c[gone] = self._find_none(part)
            free = tuple(i for i in one.points.free[0] if i not in gone)
            bare = CauseCombination(one.parts - {part}, Points(c[None], (free,)), np.inf, np.inf)
            starts += [s for s in self._add_parts([bare], 1) if s.parts != one.parts]
        stiffness = np.array([name == STIFFNESS for name in names])
        starts += [  # a damper on approach may stand in for part of the stiffness, or be in its way
            s._replace(c=s.c + _STIFFER * stiffness) for s in starts if DAMPING in s.parts
        ]
        return self._choose(starts, set(), most=len(starts))

    def _start(self) -> list[CauseCombination]:
        """The spring alone."""
        names = self.table.model.coordinates.names
        c = np.repeat(self.base[None], len(_SOFTER), axis=0)
        c[:, names.index(DAMPING)] = _NONE
        c[:, names.index(VISCOSITY)] = 0.0
        c[:, names.index(STIFFNESS)] += np.log(_SOFTER)
        free = (names.index(STIFFNESS),)
        points, cost = self.table.descend(Points(c, (free,) * len(c)), _LAST)
        best = np.argmin(cost)
        return [self._make(frozenset(), points.pick(np.array([best])), float(cost[best]))]

    def _add_parts(self, beam: list[CauseCombination], count: int) -> list[_Start]:
        """Every combination with so many parts more, from all sizes of these."""
        starts = []
        for one in beam:
            for more in combinations(self._list_missing(one), count):
                index = [i for part in more for i in self._list_numbers(part)]
                some = [self._list_sizes(part) for part in more]
                if count > 1:
                    some = [_thin(sizes) for sizes in some]
                for sizes in product(*some):
                    c = one.points.c[0].copy()
                    c[index] = np.concatenate(sizes)
                    starts.append(_Start(one.parts | set(more), c, (*one.points.free[0], *index)))
        return starts

    def _choose(
        self, starts: list[_Start], sure: set[frozenset[str]], most: int = _RANKED
    ) -> list[CauseCombination]:
        """The best combinations, each where it fits best."""
        points = Points(np.array([s.c for s in starts]), tuple(s.free for s in starts))
        parts = [s.parts for s in starts]
        order = np.argsort(self.table.measure_costs(points), kind="stable")
        # A part that only shows once all else has moved ranks low, but near its null: of the best
        # combinations every extension is followed, from all sizes.
        own = [s.parts in sure for s in starts]
        more = _take_few([j for j in order if not own[j]], parts, most)
        some = np.concatenate([np.flatnonzero(own), more])
        points, cost = self.table.descend(points.pick(some), _FIRST)
        parts = [parts[j] for j in some]
        worth = cost + self.price * np.array([len(f) for f in points.free])
        order = np.argsort(worth, kind="stable")
        some = _take_few(order, parts, _FINALISTS, each=1)
        points, cost = self.table.descend(points.pick(some), _LAST)
        found = [
            self._make(parts[j], points.pick(np.array([i])), float(cost[i]))
            for i, j in enumerate(some)
        ]
        return sorted(found, key=lambda one: one.penalised)[:_BEAM]

    def _list_missing(self, one: CauseCombination) -> list[str]:
        every = (DAMPING, VISCOSITY, *self.effects)
        return [part for part in every if part not in one.parts]

    def _list_numbers(self, part: str) -> list[int]:
        names = (part,) if part in PLAIN else numbers_of(part)
        return self.table.model.coordinates.indices(names)

    def _find_none(self, part: str) -> Any:
        """The coordinates at which a part is not there."""
        if part == RATIO:
            return self.base[self._list_numbers(part)]
        return _NONE if part == DAMPING else 0.0

    def _list_sizes(self, part: str) -> list[list[float]]:
        """The coordinates from which a part is looked for."""
        coordinates, s = self.table.model.coordinates, self.scales
        critical = 2 * np.sqrt(s.mass * s.peak / s.compression)
        if part == DAMPING:
            return [coordinates.point({part: x * critical}) for x in (0.03, 0.1, 0.3)]
        if part == VISCOSITY:
            return [coordinates.point({part: x * s.peak / s.fastest}) for x in (1e-3, 1e-2)]
        sizes = list_starting_values(part, s)
        if part == "pusher_duration":  # a tip that goes on for long is none that a table shows
            longest = _LONGEST * find_contact_time(s)
            sizes = [values for values in sizes if max(values.values()) < longest]
        return [coordinates.point(values) for values in sizes]

    def _make(self, parts: frozenset[str], points: Points, cost: float) -> CauseCombination:
        return CauseCombination(parts, points, cost, cost + self.price * len(points.free[0]))


def _thin(sizes: list[list[float]]) -> list[list[float]]:
    """A few of some sizes, from one end to the other."""
    which = np.linspace(0, len(sizes) - 1, min(len(sizes), _FEW)).round().astype(int)
    return [sizes[k] for k in which]


def _take_few(
    order: Iterable[int], parts: Sequence[frozenset[str]], most: int, each: int = _EACH
) -> NDArray:
    """The first of some points in their order, so many of one combination at most."""
    taken: dict[frozenset[str], int] = {}
    some = []
    for j in order:
        taken[parts[j]] = taken.get(parts[j], 0) + 1
        if taken[parts[j]] <= each:
            some.append(j)
        if len(some) == most:
            break
    return np.array(some, int)
