"""What else would explain the same as a cause.

An effect may stand in a cause's place where the derivatives of the answers by the two, all else
projected out, are parallel. It is then put there in the final model, which is refitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.exploration import CandidateCause
from difffric.diagnosis.score_test import step_off_null
from difffric.estimation import ensemble, ensemble_refits
from difffric.estimation.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import numbers_of

_PARALLEL = 0.8
"""Share of an effect's information that a cause takes, from which it is tried in its place."""
_ROUNDS = 15
"""Steps at most of the refit with an effect in the place of the cause."""


def find_alternatives(
    task: EnsembleTask, plain: Fits, base: Fits, cause: CandidateCause, others: Sequence[str]
) -> list[CandidateCause]:
    """Put each of the effects `others` in the place of a cause, where their derivatives are
    parallel, and return the refitted models.

    `base` is the model with the cause, `plain` the one without any (both ensembles of one).
    Effects of more than one number are left out.
    """
    mine = task.model.coordinates.indices(numbers_of(cause.effect))
    if not set(mine) <= set(base.extra[0]):  # a ratio, free in the plain model too
        return []
    before, out = float(ensemble.criterion(task, base)[0]), []
    for effect in others:
        index = task.model.coordinates.indices(numbers_of(effect))
        if len(index) > 1 or set(index) <= set(base.extra[0]):
            continue
        share, step = _measure_overlap(task, plain, base, mine, index)
        if share < _PARALLEL:
            continue
        c = base.c.copy()
        c[0, mine], c[0, index] = plain.c[0, mine], plain.c[0, index] + step
        low, high = task.model.coordinates.bounds(task.model.coordinates.names[index[0]])
        c[0, index] = np.clip(c[0, index], low, high)
        extra = (*(i for i in base.extra[0] if i not in mine), *index)
        at = replace(base, extra=(extra,), c=c, gram=None, residual=None, damping=None)
        at = ensemble_refits.refit(task, at, _ROUNDS)
        drop = cause.drop + before - float(ensemble.criterion(task, at)[0])
        penalised = drop - len(index) * task.price
        out.append(
            replace(
                cause, effect=effect, fits=at, drop=drop, predicted=0.0, penalised_drop=penalised
            )
        )
    return out


def _measure_overlap(
    task: EnsembleTask, plain: Fits, base: Fits, mine: list[int], index: list[int]
) -> tuple[float, NDArray]:
    """Return the share of the information on the coordinates `index` of an effect that the cause's
    coordinates `mine` take, all else projected out; and the effect's size that does what the cause
    does."""
    at = step_off_null(task, replace(base, extra=((*base.extra[0], *index),)))
    H = ensemble.normal_equations(task, ensemble.evaluate(task, at)).H[0]
    known = task.conditions + len(task.shared)
    a = known + np.array([base.extra[0].index(i) for i in mine])
    b = known + len(base.extra[0]) + np.arange(len(index))
    rest = np.setdiff1d(np.arange(len(H)), [*a, *b])
    scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
    H = H / np.outer(scale, scale)
    X = H[rest][:, [*a, *b]]
    S = H[np.ix_([*a, *b], [*a, *b])] - X.T @ np.linalg.pinv(H[np.ix_(rest, rest)]) @ X
    k = len(a)
    cross, own = S[:k, k:], S[k:, k:]
    if own[0, 0] < 1e-10:
        return 0.0, np.zeros(len(b))
    share = cross.T @ np.linalg.pinv(S[:k, :k]) @ cross / own
    moved = (base.c[0, mine] - plain.c[0, mine]) * scale[a]
    return float(share[0, 0]), (cross.T @ moved / own[0, 0]) / scale[b]
