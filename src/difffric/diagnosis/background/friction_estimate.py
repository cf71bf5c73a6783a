"""The mu_s of each push beside a background, and how well it is known.

What small effects do to mu_s is not seen one by one: a tilt of a thousandth is friction of a
thousandth. So mu_s is averaged over all that they may be, those with a shape included, as likely as
the data and their common scatter make it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.cause_sets import CauseSet
from difffric.diagnosis.background.evidence import Evidence, PossibleCause
from difffric.diagnosis.inferred.friction import (
    DWELL_EFFECT,
    compute_friction_errors,
    differentiate_friction,
    find_friction,
)
from difffric.estimation.ensembles.ensemble import Fits

_LEAST = 1e-3
"""Probability of a scatter and a share below which they are not looked at."""
_NO_SPREAD = 1e-9
"""Spread of a column, in its units, that stands for none at all."""
_HARDLY = -5.0
"""Log probability, beside no cause at all, below which sets of causes are not looked at."""
_MOST_SETS = 12
"""Sets of causes that are averaged over at most."""


def estimate_friction(
    evidence: Evidence, items: Sequence[PossibleCause], least_share: float = 0.0
) -> tuple[NDArray, NDArray]:
    """Return the log mu_s (n,) of each push, with drift and rest before it, and the standard errors
    (n,) of these, where the `items` are causes and all else is background, which scatters by the
    `least_share` of its units at least; NaN where the average is no friction.

    What static friction grows by in a rest is in it where that is a cause: where it is not seen,
    F_p and d tell of the friction that slides.
    """
    means, variances, weights = [], [], []
    for scatter, share, weight in evidence.weigh_states(items):
        if weight > _LEAST:
            share = max(share, least_share)
            mean, variance = _estimate_at(evidence, items, scatter, share)
            means.append(mean)
            variances.append(variance)
            weights.append(weight)
    share_of = np.array(weights) / np.sum(weights)
    mean = share_of @ np.array(means)
    spread = share_of @ (np.array(means) - mean) ** 2
    return mean, np.sqrt(share_of @ np.array(variances) + spread)


def average_over_sets(
    evidence: Evidence, at: Fits, sets: Sequence[CauseSet]
) -> tuple[NDArray, NDArray]:
    """Return the log mu_s (n,) of the fit `at` (an ensemble of one), which has no cause, and their
    standard errors (n,), moved and widened by what `sets` of causes make of mu_s, each as much as
    it is probable: a cause that is hardly seen may change mu_s by more than a fit without it says.
    """
    likely: dict[frozenset[str], CauseSet] = {}
    for one in sorted(sets, key=lambda one: -one.score):
        if one.score > _HARDLY:
            likely.setdefault(one.effects, one)
    some = list(likely.values())[:_MOST_SETS]
    weight = np.exp([one.score - some[0].score for one in some])
    weight /= weight.sum()
    means, errors = np.swapaxes([estimate_friction(evidence, one.items) for one in some], 0, 1)
    average = weight @ means
    variance = weight @ (errors**2 + (means - average) ** 2)
    none, error = estimate_friction(evidence, ())
    grown = _is_grown(evidence, ())
    own = compute_friction_errors(evidence.task, at, grown=grown)
    wider = np.maximum(variance - error**2, 0.0)
    return find_friction(evidence.task, at, grown) + average - none, np.hypot(own, np.sqrt(wider))


def _is_grown(evidence: Evidence, items: Sequence[PossibleCause]) -> bool:
    """Whether what static friction grows by in a rest is told with the friction."""
    return DWELL_EFFECT not in evidence.small.effects or any(
        item.effect == DWELL_EFFECT for item in items
    )


def _estimate_at(
    evidence: Evidence, items: Sequence[PossibleCause], scatter: float, share: float
) -> tuple[NDArray, NDArray]:
    """The means and the variances (n,) of the log mu_s for one scatter of mu_s and one share of the
    background."""
    task, at, small = evidence.task, evidence.at, evidence.small
    grown = _is_grown(evidence, items)
    spread = evidence.compute_spread(share, [c for item in items for c in item.columns])
    spread = np.maximum(spread, _NO_SPREAD * evidence.unit)
    # Each push's own mu_s is eliminated, as in the comparison of sets.
    known = scatter**2 / (1 + scatter**2 * evidence.z / evidence.excess) / evidence.excess
    own = evidence.own
    G = evidence.gram.sum(axis=0) - np.einsum("n,np,nq->pq", known, own, own)
    H = G[:-1, :-1] / evidence.excess
    H[np.diag_indices_from(H)] += np.append(np.zeros(evidence.known), spread**-2.0)
    scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
    V = np.linalg.pinv(H / np.outer(scale, scale), rcond=1e-13) / np.outer(scale, scale)
    best = -V @ G[:-1, -1] / evidence.excess
    away = -known * (own[:, :-1] @ best + own[:, -1])
    level = 1 + best[task.condition] + away
    c = at.c.copy()
    index, first = list(small.index), evidence.known
    c[0, index] = small.null[index] + best[first : first + len(index)]
    level = np.where(level > 0, level, np.nan)
    mean = find_friction(task, replace(at, c=c, own=np.log(level)[None]), grown)
    slope = -known[:, None] * own[:, :-1]
    slope[np.arange(task.n), task.condition] += 1.0
    slope /= level[:, None]
    for i, change in differentiate_friction(task, c[0], grown).items():
        if i in index:
            slope[:, first + index.index(i)] += change
    variance = known * evidence.excess / level**2
    return mean, variance + np.einsum("np,pq,nq->n", slope, V, slope)
