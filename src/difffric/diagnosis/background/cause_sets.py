"""Which set of causes explains the most: all single ones, pairs and triples, compared at once."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy

from difffric.diagnosis.background.evidence import Evidence, PossibleCause
from difffric.diagnosis.score_test import SIGNIFICANT, count_looks

_IN_PAIRS = 40
"""Items that are tried in pairs."""
_IN_TRIPLES = 18
"""Items that are tried in triples."""
_OF_EACH = 2
"""Shapes of each effect that are tried beside others."""
_ADDED = 3
"""Effects that are added to the best triple, one after the other, at most."""
_LIKE_ITSELF = (0.4, 2.5)
"""Sizes of a column that stands for one size of an effect, between which it is that effect."""


@dataclass(frozen=True)
class CauseSet:
    """One set of causes."""

    items: tuple[PossibleCause, ...]
    score: float
    """log posterior probability, but for a constant: that of no cause is 0"""
    sizes: tuple[float, ...]
    """of the items' columns, one after the other"""
    price: float = 0.0
    """what of the log likelihood that it gains its numbers would buy in any case"""

    @property
    def effects(self) -> frozenset[str]:
        """The effects in it."""
        return frozenset(item.effect for item in self.items)


def search_sets(evidence: Evidence, items: Sequence[PossibleCause]) -> list[CauseSet]:
    """Return the sets of up to three of the items, and what was added to the best, the most
    probable first; that of no cause is among them."""
    found = [CauseSet((), 0.0, ())]
    singles = _score(evidence, [(item,) for item in items])
    leaders = _choose_leaders(singles, items)
    pairs = _score(evidence, _combine(leaders[:_IN_PAIRS], 2))
    first = dict.fromkeys(item for one in pairs[:25] for item in one.items)
    triples = _score(evidence, _combine([*dict.fromkeys([*first, *leaders])][:_IN_TRIPLES], 3))
    found += [*singles, *pairs, *triples]
    best = max(found, key=lambda one: one.score)
    for _ in range(_ADDED if len(best.items) == 3 else 0):
        more = [(*best.items, item) for item in leaders if item.effect not in best.effects]
        grown = _score(evidence, more)
        if not grown or grown[0].score <= best.score:
            break
        found += grown
        best = grown[0]
    return sorted(found, key=lambda one: -one.score)


def replace_item(
    evidence: Evidence, items: Sequence[PossibleCause], gone: PossibleCause
) -> list[CauseSet]:
    """Return the sets in which every effect that is not among the `items` stands in the place of
    `gone`, the best first; each effect once."""
    rest = [item for item in items if item is not gone]
    taken = {item.effect for item in items}
    sets = [(*rest, item) for item in evidence.items if item.effect not in taken]
    best: dict[str, CauseSet] = {}
    for one in _score(evidence, sets):
        best.setdefault(one.items[-1].effect, one)
    return list(best.values())


def weigh_set(evidence: Evidence, items: Sequence[PossibleCause]) -> CauseSet:
    """Return the set of these items, whatever their sizes."""
    return _score(evidence, [tuple(items)], every=True)[0] if items else CauseSet((), 0.0, ())


def find_set(evidence: Evidence, effects: Collection[str]) -> CauseSet | None:
    """Find the set of these effects, each as it is in the fit where the comparison stands; None
    where one of them is not in it."""
    items = tuple(
        x for x in evidence.items if x.effect in effects and (x.shape is None or x.shape.placed)
    )
    return None if len(items) < len(effects) else weigh_set(evidence, items)


def _combine(items: Sequence[PossibleCause], k: int) -> list[tuple[PossibleCause, ...]]:
    """All sets of k items, no effect twice."""
    return [some for some in combinations(items, k) if len({item.effect for item in some}) == k]


def _choose_leaders(
    singles: Sequence[CauseSet], items: Sequence[PossibleCause]
) -> list[PossibleCause]:
    """The items that are tried beside others, the best alone first; effects without a shape are
    all among them, as two of them may explain what neither does."""
    count: dict[str, int] = {}
    chosen = []
    for (item,) in (one.items for one in singles):
        count[item.effect] = count.get(item.effect, 0) + 1
        if count[item.effect] <= _OF_EACH:
            chosen.append(item)
    return [*chosen, *(x for x in items if x.shape is None and x not in chosen)]


def score_singles(evidence: Evidence, items: Iterable[PossibleCause]) -> list[CauseSet]:
    """Score each of the items alone, the best first, whatever its size."""
    return _score(evidence, [(item,) for item in items], every=True)


def _score(
    evidence: Evidence, sets: Iterable[tuple[PossibleCause, ...]], every: bool = False
) -> list[CauseSet]:
    """Score sets, the best first; unless `every` one is asked for, those are left out whose sizes
    make no sense."""
    by_columns: dict[int, list[tuple[PossibleCause, ...]]] = {}
    for some in sets:
        by_columns.setdefault(sum(len(item.columns) for item in some), []).append(some)
    found = []
    for same in by_columns.values():
        fit = evidence.compare([[c for item in some for c in item.columns] for some in same])
        sizes = np.einsum("sn,snk->nk", fit.weight, fit.size)
        for some, gain, size in zip(same, fit.gain, sizes, strict=True):
            if every or makes_sense(evidence, some, size):
                price = compute_price(evidence, some)
                found.append(CauseSet(some, float(gain) - price, tuple(size.tolist()), price))
    return sorted(found, key=lambda one: -one.score)


def compute_price(evidence: Evidence, items: Sequence[PossibleCause]) -> float:
    """What a set must buy in log likelihood: of each item what chance alone buys, with the
    probability `SIGNIFICANT`, where so many effects are looked for."""
    looks = [count_looks(item.effect, evidence.effects) for item in items]
    numbers = [1 if item.shape is None else item.shape.numbers for item in items]
    return 0.5 * float(scipy.stats.chi2.isf(SIGNIFICANT / np.array(looks), numbers).sum())


def makes_sense(evidence: Evidence, items: Sequence[PossibleCause], sizes: np.ndarray) -> bool:
    """Whether the sizes lie within the effects' bounds, and near the sizes that columns stand
    for."""
    coordinates, small = evidence.task.model.coordinates, evidence.small
    start = 0
    for item in items:
        size = sizes[start]
        start += len(item.columns)
        if item.shape is None:
            i = small.index[item.columns[0]]
            low, high = coordinates.bounds(coordinates.names[i])
            if not low - 1e-9 <= small.null[i] + size <= high + 1e-9:
                return False
        elif len(item.columns) == 1 and (item.shape.placed or item.shape.typical == 1.0):
            low, high = _LIKE_ITSELF
            if size < low or size > high:
                return False
    return True
