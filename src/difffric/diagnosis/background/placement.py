"""Where a fit with new shapes begins: where linear algebra puts all parameters at once.

A shape that explains much takes over what other parameters stood for. Placed alone, with all of
these where they were, it leaves thousands of times what it is to explain, and the fit goes astray.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.columns.known_columns import list_known
from difffric.diagnosis.background.evidence import Evidence, PossibleCause
from difffric.diagnosis.background.joint_fit import WIDE
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.diagnosis.data import choose_subset
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import numbers_of

_BEGUN = 5
"""Effects at most with each of which a fit is begun."""
_LEAST_LEVEL = 0.2
"""The share of its mu_s that a push keeps at least: no linear prediction goes further."""


def predict_start(evidence: Evidence, items: Sequence[PossibleCause], share: float = WIDE) -> Fits:
    """Return the fit (an ensemble of one, without answers) with the shapes of the `items` placed,
    of the sizes that explain most together with all other parameters; small effects among the
    items have any size, the others scatter by a `share` of their units. Shapes that are placed
    already, and those whose size is part of the shape, stay as they are, unless an item is another
    shape of the same effect."""
    task, at, small = evidence.task, evidence.at, evidence.small
    first, index = evidence.known, list(small.index)
    chosen = [c for item in items if _has_amplitude(item) for c in item.columns]
    whole = [x for x in items if x.shape and not x.shape.placed and not _has_amplitude(x)]
    moved = {x.effect for x in items if x.shape and not x.shape.placed}
    stay = [x for x in evidence.list_placed() if x.effect not in moved]
    placed = [first + c for item in (*stay, *whole) for c in item.columns]
    weight = evidence.likeliest_scatter**2
    weight = weight / (1 + weight * evidence.z)  # each push's own mu_s is eliminated
    own, kept = evidence.own, [*range(first + len(index)), *(first + c for c in chosen)]
    G = evidence.gram.sum(axis=0) - np.einsum("n,np,nq->pq", weight, own, own)
    of_any_size = [*chosen, *(c for item in items if item.shape is None for c in item.columns)]
    spread = evidence.compute_spread(share, of_any_size)[[*range(len(index)), *chosen]]
    H = G[np.ix_(kept, kept)]
    H[np.diag_indices_from(H)] += np.append(np.zeros(first), spread**-2.0)
    scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
    left = G[kept, -1] + G[np.ix_(kept, placed)].sum(axis=1)
    best = -(np.linalg.pinv(H / np.outer(scale, scale), rcond=1e-12) @ (left / scale)) / scale
    away = own[:, kept] @ best + own[:, -1] + own[:, placed].sum(axis=1)
    mean = np.maximum(1 + best[: task.conditions], _LEAST_LEVEL)
    level = np.maximum(mean[task.condition] - weight * away, _LEAST_LEVEL)
    c = at.c.copy()
    free = list_known(task, at, small, [item.effect for item in evidence.list_placed()])
    c[0, free] += best[task.conditions : first]
    c[0, index] = small.null[index] + best[first : first + len(index)]
    for i in (*free, *index):
        c[0, i] = np.clip(c[0, i], *ensemble.bounds(task, i))
    moved = replace(
        at, c=c, mu=at.mu + np.log(mean), own=np.log(level / mean[task.condition])[None]
    )
    sizes = dict(zip(chosen, best[first + len(index) :], strict=True))
    return place_shapes(
        task, moved, items, [sizes.get(c, 1.0) for item in items for c in item.columns]
    )


def place_shapes(
    task: EnsembleTask, at: Fits, items: Sequence[PossibleCause], sizes: Sequence[float] | NDArray
) -> Fits:
    """Return the fit `at` with the shapes of a set of causes placed and free."""
    c, extra = at.c.copy(), list(at.extra[0])
    start = 0
    for item in items:
        own_sizes = sizes[start : start + len(item.columns)]
        start += len(item.columns)
        if item.shape is not None and not item.shape.placed:
            put_shape(c, item, own_sizes)
            own = task.model.coordinates.indices(numbers_of(item.effect))
            extra += [i for i in own if i not in extra]
    return replace(at, c=c, extra=(tuple(extra),), gram=None, residual=None, damping=None)


def put_small(
    c: NDArray, task: EnsembleTask, small: SmallEffects, item: PossibleCause, size: float
) -> None:
    """Put an effect without a shape, of this size, into coordinates c (1, K), within its bounds."""
    i = small.index[item.columns[0]]
    c[0, i] = np.clip(small.null[i] + size, *ensemble.bounds(task, i))


def put_shape(c: NDArray, item: PossibleCause, sizes: Sequence[float] | NDArray) -> None:
    """Put a shape, its columns of these sizes, into coordinates c (1, K)."""
    assert item.shape is not None
    for point in item.shape.points:
        for i, value in point.items():
            c[0, i] = value
    if _has_amplitude(item):  # the columns are that
        for point, size in zip(item.shape.points, sizes, strict=True):
            i = next(i for i, value in point.items() if value != 0.0)
            c[0, i] = point[i] * size / item.shape.amplitude


def _has_amplitude(item: PossibleCause) -> bool:
    """Whether a shape has an amplitude beside what makes its shape."""
    return item.shape is not None and item.shape.typical < 1.0


def begin_with_each(
    task: EnsembleTask, base: Fits, small: SmallEffects
) -> tuple[list[int], list[Fits]]:
    """Return the coordinates of some small effects, and fits that begin with each of them alone, on
    top of plain parameters and shapes of `base` (ensembles of one): those whose first step promises
    most, as the derivatives by all of them at once have it."""
    shapes = tuple(i for i in base.extra[0] if i not in small.index)
    chosen = _rank_promises(task, base, shapes, small.index)[:_BEGUN]
    starts = []
    for i in chosen:
        c = base.c.copy()
        others = [k for k in small.index if k != i]
        c[0, others] = small.null[others]
        starts.append(replace(base, c=c, extra=((*shapes, i),)))
    return chosen, starts


def _rank_promises(
    task: EnsembleTask, base: Fits, shapes: tuple[int, ...], index: tuple[int, ...]
) -> list[int]:
    """The coordinates `index`, that first whose step beside plain parameters and shapes promises
    most on some of the pushes."""
    some = choose_subset(task) if task.model.recordings else None
    whole = replace(base, extra=((*shapes, *index),), gram=None, residual=None)
    found = ensemble.normal_equations(task, ensemble.evaluate(task, whole, some))
    always = task.conditions + len(task.shared) + len(shapes)
    promised = []
    for k in range(len(index)):
        own = [*range(always), always + k]
        H, g = found.H[:, own][:, :, own], found.g[:, own]
        promised.append(-float((ensemble.solve(H, g) * g).sum()))
    return [index[k] for k in np.argsort(promised)[::-1]]


def hold_at_null(small: SmallEffects, at: Fits, free: Sequence[int] = ()) -> Fits:
    """Return fits with the small effects that have no derivative at their null there, but for those
    coordinates that are `free`: beside it a push may jump, and every step fails."""
    held = [i for i in small.index if small.start[i] != small.null[i] and i not in free]
    c = at.c.copy()
    c[:, held] = small.null[held]
    extra = tuple(tuple(i for i in own if i not in held) for own in at.extra)
    return replace(at, c=c, extra=extra, gram=None, residual=None, damping=None)
