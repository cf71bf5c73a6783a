"""Each push's own mu_s followed to what is best for it, where a fit starts far from it.

Where the shared parameters stand, pushes have nothing to do with each other. A step that a push
does not take is that push's alone, and keeps no other from its own. Axes as in `ensemble`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.ensembles import ensemble as en
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits

_ROUNDS = 6
"""Steps of a push at most."""
_SHARES = (1.0, 0.3, 0.1)
"""Of a step that are tried until one is better."""
_FAR = 0.5
"""A push's own log mu_s is not moved further than this at once: a linear prediction is no guide."""
_STALE = 1.0
"""Standard deviations that it may be off where it rests."""


def settle_by_push(task: EnsembleTask, fits: Fits) -> Fits:
    """Return the fits, which have answers, with each push's own mu_s at what is best for it, and
    the answers there; all else stays as it is, the scatter with it."""
    frozen = np.zeros(fits.own.shape, bool)
    for _ in range(_ROUNDS if task.mu_free else 0):
        found = en.normal_equations(task, fits)
        best = -found.gm / (found.z + 1.0 / fits.scatter[:, None] ** 2)
        away = np.clip(best - fits.own, -_FAR, _FAR)
        stale = ~frozen & np.isfinite(best) & (np.abs(away) * np.sqrt(found.z) > _STALE)
        j, i = np.nonzero(stale)
        if not len(j):
            break
        fits, left = _step(task, fits, j, i, away[j, i])
        frozen[j[left], i[left]] = True
    return fits


def _step(
    task: EnsembleTask, fits: Fits, j: NDArray, i: NDArray, away: NDArray
) -> tuple[Fits, NDArray]:
    """Return the fits with the own mu_s of pushes i (N,) of fits j (N,) moved by as much of `away`
    (N,) as makes them better, and the numbers of those that nothing does."""
    own, gram, residual = fits.own.copy(), fits.gram.copy(), fits.residual.copy()
    before = _compute_cost(fits, j, i, gram[j, i], own[j, i])
    left = np.arange(len(j))
    for share in _SHARES:
        a, b = j[left], i[left]
        tried = own[a, b] + share * away[left]
        answers, whitened = _answer(task, fits, a, b, tried)
        good = _compute_cost(fits, a, b, answers, tried) < before[left]
        own[a[good], b[good]] = tried[good]
        gram[a[good], b[good]] = en.widen(answers[good], gram.shape[-1])
        residual[a[good], b[good]] = whitened[good]
        left = left[~good]
        if not len(left):
            break
    return replace(fits, own=own, gram=gram, residual=residual), left


def _compute_cost(fits: Fits, j: NDArray, i: NDArray, gram: NDArray, own: NDArray) -> NDArray:
    """The squares (N,) that single pushes leave, and what their own mu_s cost."""
    squares = np.einsum("nk,nk->n", gram[..., -1, -1], 1.0 / fits.spread[j] ** 2)
    return squares + (own / fits.scatter[j]) ** 2


def _answer(
    task: EnsembleTask, fits: Fits, j: NDArray, i: NDArray, own: NDArray
) -> tuple[NDArray, NDArray]:
    """The Gram matrices and residuals of pushes i (N,) of fits j (N,) at other own mu_s (N,)."""
    c = fits.c[j]
    c[:, 0] = fits.mu[j, task.condition[i]] + own
    found = task.model.answers(i, c, en.directions(task, fits)[j])
    bad = ~np.isfinite(found.gram).all(axis=(1, 2, 3))
    gram = np.where(bad[:, None, None, None], 0.0, found.gram)
    gram[..., -1, -1] += np.where(bad, en.REJECTED, 0.0)[:, None]
    return gram, found.residual
