"""The columns of a linear comparison: what the parameters and small effects change where a fit
stands, and what is left without these effects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.columns.shape_columns import ShapeColumns
from difffric.diagnosis.background.small_effects import (
    SmallEffects,
    count_rows,
    step_off_null,
)
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import numbers_of

_JUMP, _WRONG = 10.0, 0.25
"""Chi-square of a push from which on so small a step counts, and the share of it that is not
foretold from which on it is a jump."""
_NO_FRICTION = 1e-100
"""Share of its mu_s that a push without any friction still has, so that it can be divided by."""


def list_known(
    task: EnsembleTask, at: Fits, small: SmallEffects, placed: Sequence[str]
) -> list[int]:
    """List the coordinates that are known to be in the model, in the order of their columns: the
    plain ones, and what `at` has free besides small effects and the shapes `placed`."""
    held = {
        *small.index,
        *task.model.coordinates.indices([n for e in placed for n in numbers_of(e)]),
    }
    return [*task.shared, *(i for i in at.extra[0] if i not in held)]


def _move_to_null(
    task: EnsembleTask,
    at: Fits,
    small: SmallEffects,
    c: NDArray,
    there: NDArray,
    columns: NDArray,
    away: NDArray,
) -> NDArray:
    """Return the residuals (n, R) with those effects at their nulls that were moved off them to
    have a derivative, all else at coordinates c (n, K), where they are `there`.

    A push on an edge jumps in so small a step, and its derivative says nothing of it: where it
    does not foretell the jump, the `columns` (n, R, p) of these effects become what the step
    changes. How far they are `away` (p,) from their nulls becomes none.
    """
    off = [k for k, i in enumerate(small.index) if 0 < away[k] <= small.start[i] - small.null[i]]
    if not off:
        return there
    n, index = task.n, np.array(small.index)[off]
    points = np.tile(c, (1 + len(off), 1, 1))
    for k, own in enumerate(points):  # first all at their nulls, then one after the other is not
        at_null = np.delete(index, k - 1) if k else index
        own[:, at_null] = small.null[at_null]
    none = np.zeros((0, c.shape[1]))
    found = task.model.answers(
        np.tile(np.arange(n), len(points)), points.reshape(-1, c.shape[1]), none
    )
    r = found.residual[..., : count_rows(task)] / at.spread[0][:, None]
    r = r.reshape(len(points), n, -1)
    r = np.where(np.isfinite(r).all(axis=(0, 2), keepdims=True), r, there)
    for k, moved in zip(off, r[1:] - r[0], strict=True):
        foretold = columns[..., k] * away[k]
        size, wrong = (np.einsum("nr,nr->n", x, x) for x in (foretold, moved - foretold))
        jumps = (size > _JUMP) & (wrong > _WRONG * size)
        columns[jumps, :, k] = moved[jumps] / away[k]
        away[k] = 0.0
    return r[0]


def collect_rows(
    task: EnsembleTask, at: Fits, small: SmallEffects, shapes: ShapeColumns | None
) -> tuple[NDArray, NDArray]:
    """The columns (n, R, p) of each push: the plain parameters, what `at` has free besides, the
    small effects, and what would be left without the small effects and the placed shapes; and that
    of the push's own mu_s (n, R)."""
    n, C = task.n, task.conditions
    placed = () if shapes is None else [s.effect for s in shapes.shapes if s.placed]
    free = [*list_known(task, at, small, placed), *small.index]
    directions = np.zeros((1 + len(free), at.c.shape[1]))
    directions[0, 0] = float(task.mu_free)
    directions[np.arange(1, len(directions)), free] = 1.0
    beside = step_off_null(task, at, free)
    c = np.repeat(beside, n, axis=0)
    c[:, 0] = at.mu[0, task.condition] + at.own[0]
    rows = task.model.answers(np.arange(n), c, directions, True).rows[:, :, : count_rows(task)]
    rows = (rows / at.spread[0][:, None, None]).reshape(n, -1, len(directions) + 1)
    # A push that cannot be followed beside the nulls says nothing.
    rows = np.where(np.isfinite(rows).all(axis=(1, 2), keepdims=True), rows, 0.0)
    # What adds a force changes all mu_s by the same amount, not by the same factor: so does the
    # scatter that is compared here, or a linear prediction would take one for the other.
    level = np.exp(at.own[0])[:, None]
    plain = rows[..., 1 : -1 - len(small.index)]
    # Nor does one whose friction a fit has led to nothing.
    own = np.where(level > 0, rows[..., 0] / np.maximum(level, _NO_FRICTION), 0.0)
    columns = rows[..., -1 - len(small.index) : -1]
    away = (beside[0] - small.null)[list(small.index)]
    there = _move_to_null(task, at, small, c, rows[..., -1], columns, away)
    left = there - own * (level - 1) - columns @ away
    if shapes is not None:
        for shape, mine in zip(shapes.shapes, shapes.columns, strict=True):
            left = left - shape.placed * shapes.rows[..., mine[0]]
    condition = np.zeros((n, own.shape[1], C))
    condition[np.arange(n), :, task.condition] = own
    return np.concatenate([condition, plain, columns, left[:, :, None]], axis=2), own
