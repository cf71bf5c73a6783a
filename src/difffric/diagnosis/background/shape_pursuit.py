"""Which shapes, one of each effect, explain best what small effects leave.

The small effects scatter about their nulls, and the plain parameters are free; what is left is
explained by a shape beside those that are placed already, then by the next beside it, of another
effect, with all sizes found anew at each step (Mallat and Zhang, Matching pursuits with
time-frequency dictionaries, IEEE Trans. Signal Process. 41, 1993). Not only the best sequence of
shapes is followed, as two together may look like a third one while one of them stands alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.cause_sets import (
    CauseSet,
    compute_price,
    makes_sense,
    score_singles,
)
from difffric.diagnosis.background.evidence import Evidence, PossibleCause

_RIDGE = 1e-9
"""What is added to the diagonal of the information, as a share of it."""
_BEAM = 40
"""Sequences of shapes that are followed, the best ones of as many shapes."""


class PursuedShapes(NamedTuple):
    """Shapes that together explain what small effects leave."""

    items: tuple[PossibleCause, ...]
    sizes: tuple[float, ...]
    """of their columns, one after the other"""


def choose_best_shapes(evidence: Evidence, of_each: int) -> list[CauseSet]:
    """Return as many shapes of each effect as explain most by themselves, the best first."""
    shaped = [item for item in evidence.items if item.shape and not item.shape.placed]
    found: list[CauseSet] = []
    for one in score_singles(evidence, shaped):
        if sum(one.effects == other.effects for other in found) < of_each:
            found.append(one)
    return found


def pursue_shapes(evidence: Evidence, most: int) -> PursuedShapes:
    """Return at most so many shapes, of effects that are not placed yet, each of which explains
    more than its price beside the others, and whose sizes make sense."""
    placed = evidence.list_placed()
    there_already = {item.effect for item in placed}
    shaped = [x for x in evidence.items if x.shape and x.effect not in there_already]
    equations = _Equations.collect(evidence, placed, shaped)
    best, beam = _Sequence((), 0.0), [_Sequence((), 0.0)]
    for _ in range(most):
        grown: dict[frozenset[int], _Sequence] = {}
        for some in beam:
            taken = {shaped[k].effect for k in some.chosen}
            gains, sizes = equations.add_each(some.chosen)
            for k in np.flatnonzero(gains > 0):
                one = shaped[k]
                if one.effect not in taken and makes_sense(evidence, [one], sizes[k]):
                    worth = some.worth + float(gains[k]) - equations.prices[k]
                    chosen = (*some.chosen, int(k))
                    grown[frozenset(chosen)] = _Sequence(chosen, worth)
        beam = sorted(grown.values(), key=lambda one: -one.worth)[:_BEAM]
        sound = (one for one in beam if _is_sound(evidence, equations, shaped, one.chosen))
        best = max(best, next(sound, best), key=lambda one: one.worth)
    items = tuple(shaped[k] for k in best.chosen)
    return PursuedShapes(items, tuple(equations.find_sizes(best.chosen).tolist()))


class _Sequence(NamedTuple):
    """Shapes that were chosen one beside the other."""

    chosen: tuple[int, ...]
    """their numbers"""
    worth: float
    """their drop of chi-square beyond their prices"""


@dataclass(frozen=True)
class _Equations:
    """The normal equations of columns of shapes, with all else eliminated."""

    M: NDArray
    """(C + 1, C + 1) information; the last column changes nothing"""
    h: NDArray
    """(C + 1,) products with the residuals"""
    placed: list[int]
    """columns of shapes that are in the model"""
    columns: NDArray
    """(m, 2) those of each shape that may be added; where it has one, the second is the last"""
    prices: NDArray
    """(m,) what each must lower chi-square by"""

    @classmethod
    def collect(
        cls, evidence: Evidence, placed: Sequence[PossibleCause], shaped: Sequence[PossibleCause]
    ) -> _Equations:
        """The equations where a comparison stands, of shapes that are `placed` and that may be."""
        M, h, first = evidence.project_out_small()
        # Two that do the same share what they do.
        M = M + _RIDGE * np.diag(np.maximum(np.diag(M), 1e-12))
        C = len(h)
        padded = np.eye(C + 1)
        padded[:C, :C] = M
        of_each = [[c - first for c in item.columns] for item in shaped]
        columns = np.array([[*own, C][:2] for own in of_each], int).reshape(-1, 2)
        prices = np.array([2 * compute_price(evidence, [item]) for item in shaped])
        there = [c - first for item in placed for c in item.columns]
        return cls(padded, np.append(h, 0.0), there, columns, prices)

    def add_each(self, chosen: Sequence[int]) -> tuple[NDArray, NDArray]:
        """The drop of chi-square (m,) by each shape beside those that were chosen, and its sizes
        (m, 2)."""
        there = self._list_columns(chosen)
        M, h = self.M, self.h
        cross = np.linalg.solve(M[np.ix_(there, there)], M[there]) if there else M[:0]
        block = M[self.columns[:, :, None], self.columns[:, None, :]]
        floor = 2 * _RIDGE * np.einsum("mii->mi", block)
        block = block - np.einsum("tma,tmb->mab", M[there][:, self.columns], cross[:, self.columns])
        q = h[self.columns] - np.einsum("t,tma->ma", h[there], cross[:, self.columns])
        # What the others do as well is nothing.
        new = (np.einsum("mii->mi", block) > floor).all(axis=1)
        block[~new] = np.eye(2)
        size = -np.linalg.solve(block, q[:, :, None])[:, :, 0]
        return np.where(new, -np.einsum("ma,ma->m", size, q), 0.0), size

    def find_sizes(self, chosen: Sequence[int]) -> NDArray:
        """The sizes (k,) of the columns of the shapes that were chosen, one after the other."""
        there = self._list_columns(chosen)
        if not there:
            return np.zeros(0)
        return -np.linalg.solve(self.M[np.ix_(there, there)], self.h[there])[len(self.placed) :]

    def _list_columns(self, chosen: Sequence[int]) -> list[int]:
        """The columns of the shapes that are in the model and of those that were chosen."""
        last = len(self.h) - 1
        return [*self.placed, *(int(c) for k in chosen for c in self.columns[k] if c != last)]


def _is_sound(
    evidence: Evidence,
    equations: _Equations,
    shaped: Sequence[PossibleCause],
    chosen: Sequence[int],
) -> bool:
    """Whether each shape of a sequence explains more than its price beside the others, and all
    sizes make sense."""
    for k in chosen:
        gains, _ = equations.add_each([other for other in chosen if other != k])
        if gains[k] <= equations.prices[k]:
            return False
    items = [shaped[k] for k in chosen]
    return makes_sense(evidence, items, equations.find_sizes(chosen))
