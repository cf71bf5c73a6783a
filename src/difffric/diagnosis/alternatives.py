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
from difffric.estimation.ensembles import ensemble, ensemble_refits
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
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
    coordinates = task.model.coordinates
    index = {effect: coordinates.indices(numbers_of(effect)) for effect in others}
    # All of one number: they are evaluated, and fitted, together.
    single = {e: i[0] for e, i in index.items() if len(i) == 1 and i[0] not in base.extra[0]}
    overlaps = _measure_overlaps(task, plain, base, mine, list(single.values()))
    names, at = [], []
    for (effect, i), (share, step) in zip(single.items(), overlaps, strict=True):
        if share < _PARALLEL:
            continue
        c = base.c.copy()
        c[0, mine] = plain.c[0, mine]
        c[0, i] = np.clip(plain.c[0, i] + step, *coordinates.bounds(coordinates.names[i]))
        extra = (*(x for x in base.extra[0] if x not in mine), i)
        at.append(replace(base, extra=(extra,), c=c, gram=None, residual=None, damping=None))
        names.append(effect)
    if not names:
        return []
    fits = ensemble_refits.refit(task, ensemble.join(*at), _ROUNDS)
    drops = cause.drop + ensemble.criterion(task, base) - ensemble.criterion(task, fits)
    return [
        replace(
            cause,
            effect=effect,
            fits=fits.pick(j),
            drop=float(drops[j]),
            predicted=0.0,
            penalised_drop=float(drops[j]) - task.price,
        )
        for j, effect in enumerate(names)
    ]


def _measure_overlaps(
    task: EnsembleTask, plain: Fits, base: Fits, mine: list[int], others: Sequence[int]
) -> list[tuple[float, float]]:
    """Return for each of the coordinates `others`, each an effect's, the share of the information
    on it that the cause's coordinates `mine` take, all else projected out; and the effect's size
    that does what the cause does."""
    if not others:
        return []
    at = [step_off_null(task, replace(base, extra=((*base.extra[0], i),))) for i in others]
    fits = ensemble.evaluate(task, ensemble.join(*at))
    known = task.conditions + len(task.shared)
    a = known + np.array([base.extra[0].index(i) for i in mine])
    b = np.array([known + len(base.extra[0])])
    moved = base.c[0, mine] - plain.c[0, mine]
    return [_project_out(H, a, b, moved) for H in ensemble.normal_equations(task, fits).H]


def _project_out(H: NDArray, a: NDArray, b: NDArray, moved: NDArray) -> tuple[float, float]:
    """Return the share of the information on column b (1,) of normal equations H that the columns
    a take, all else projected out, and the step of b that does what `moved` of a does."""
    rest = np.setdiff1d(np.arange(len(H)), [*a, *b])
    scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
    H = H / np.outer(scale, scale)
    X = H[rest][:, [*a, *b]]
    S = H[np.ix_([*a, *b], [*a, *b])] - X.T @ np.linalg.pinv(H[np.ix_(rest, rest)]) @ X
    k = len(a)
    cross, own = S[:k, k:], S[k:, k:]
    if own[0, 0] < 1e-10:
        return 0.0, 0.0
    share = cross.T @ np.linalg.pinv(S[:k, :k]) @ cross / own
    step = cross.T @ (moved * scale[a]) / own[0, 0] / scale[b]
    return float(share[0, 0]), float(step[0])
