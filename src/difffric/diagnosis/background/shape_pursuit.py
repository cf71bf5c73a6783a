"""Which shapes, one of each effect, explain best what small effects leave: one after the other.

The small effects scatter about their nulls, and the plain parameters are free; what is left is
explained by the shape that takes up most of it, beside those that are placed already, then by the
next beside it, of another effect (Mallat and Zhang, Matching pursuits with time-frequency
dictionaries, IEEE Trans. Signal Process. 41, 1993, with all sizes found anew at each step).
"""

from __future__ import annotations

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
    """Return at most so many shapes, of effects that are not placed yet, whose drops of chi-square
    are above their prices and whose sizes make sense."""
    M, h, first = evidence.project_out_small()
    # Two that do the same share what they do.
    M = M + _RIDGE * np.diag(np.maximum(np.diag(M), 1e-12))
    there_already = {item.effect for item in evidence.list_placed()}
    shaped = [x for x in evidence.items if x.shape and x.effect not in there_already]
    placed = [c - first for item in evidence.list_placed() for c in item.columns]
    chosen: list[PossibleCause] = []
    for _ in range(most):
        there = placed + [c - first for item in chosen for c in item.columns]
        best: tuple[float, PossibleCause] | None = None
        for item in shaped:
            if any(item.effect == other.effect for other in chosen):
                continue
            mine = [c - first for c in item.columns]
            gain, size = _add(M, h, there, mine)
            if gain > 2 * compute_price(evidence, [item]) and makes_sense(evidence, [item], size):
                best = max(best, (gain, item), key=lambda x: x[0]) if best else (gain, item)
        if best is None:
            break
        chosen.append(best[1])
    there = placed + [c - first for item in chosen for c in item.columns]
    sizes = -np.linalg.solve(M[np.ix_(there, there)], h[there]) if there else np.zeros(0)
    return PursuedShapes(tuple(chosen), tuple(sizes[len(placed) :].tolist()))


def _add(M: NDArray, h: NDArray, there: list[int], mine: list[int]) -> tuple[float, NDArray]:
    """The drop of chi-square by the columns `mine` beside those that are `there`, and their
    sizes."""
    A, q = M[np.ix_(mine, mine)], h[mine]
    if there:
        cross = np.linalg.solve(M[np.ix_(there, there)], M[np.ix_(there, mine)])
        A, q = A - M[np.ix_(mine, there)] @ cross, q - h[there] @ cross
    floor = 2 * _RIDGE * np.diag(M[np.ix_(mine, mine)])  # what the others do as well is nothing
    if (np.diag(A) <= floor).any():
        return 0.0, np.zeros(len(mine))
    size = -np.linalg.solve(A, q)
    return float(-size @ q), size
