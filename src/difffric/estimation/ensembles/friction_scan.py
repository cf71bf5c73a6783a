"""Where a push has several mu_s that fit, no small step leads from one to another: they are looked
for on a grid. Axes as in `ensemble`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits

_BAD = 3.0
"""Squared residual per number from which a push fits badly."""
_OWN = np.linspace(-0.35, 0.35, 21)
_FINE = np.linspace(-0.7, 0.7, 113)
"""The own log mu_s that are tried in a push that fits badly, and those where that led nowhere."""
LOOSE, _NEAR = 5e-4, np.linspace(-3.0, 3.0, 13)
"""The standard error of a push's own log mu_s from which it is looked for on a grid, and the grid
in units of it."""
_OUTLYING, _CLOSE = 2.5, np.linspace(-12.0, 12.0, 49)
"""Standard deviations of what noise leaves of a push, by which one fits worse than the others, and
the own log mu_s that are tried then, in units of its standard error."""
_COSTLY, _WIDE = 4.0, np.linspace(-3.0, 3.0, 61)
"""What a push costs, its own mu_s included, from which that is looked for anywhere within the
scatter, and the own log mu_s that are tried then, in units of it."""
_CAUGHT, _RISES = 0.25, 0.1
"""The share of pushes up to which those that keep a step from succeeding are looked at closely, and
the share of the largest rise of a push's squares that such a one has at least."""
_WORTH = 1.0
"""By how much a sum of squares must fall to be worth another branch."""


def rescan_bad_pushes(
    task: EnsembleTask, fits: Fits, pushes: NDArray | None = None, fine: bool = False
) -> Fits:
    """The fits with the own mu_s of pushes that fit badly taken from a grid where that fits better,
    a `fine` one or not: beside a strong effect a push may have several mu_s that no small step
    betters."""
    if not task.mu_free:
        return fits
    which = np.arange(task.n) if pushes is None else np.asarray(pushes)
    cost = np.einsum("mnk,mk->mn", fits.gram[..., -1, -1], 1.0 / fits.spread**2)
    bad = np.zeros(cost.shape, bool)
    bad[:, which] = cost[:, which] > _BAD * np.maximum(task.counts[which].sum(axis=1), 1.0)
    grid = _FINE if fine else _OWN
    return _rescan(task, fits, bad, np.broadcast_to(grid, (*bad.shape, len(grid))), 0.0)


def rescan_loose_pushes(task: EnsembleTask, fits: Fits) -> Fits:
    """The fits with the own mu_s of pushes that hardly tell it taken from a grid, within what they
    leave open: where a push sticks, its answer jumps with mu_s, and no derivative says so."""
    if not task.mu_free:
        return fits
    error = compute_own_errors(fits)
    return _rescan(task, fits, error > LOOSE, make_own_grid(fits, error), 1.0)


def rescan_costly_pushes(task: EnsembleTask, fits: Fits) -> Fits:
    """The fits with the own mu_s of pushes that fit badly, or only with one that is unusual, taken
    from a grid over the scatter: two numbers of a table may tell a push's own mu_s to a thousandth,
    and another branch of it be thirty standard errors away."""
    if not task.mu_free:
        return fits
    grid = np.multiply.outer(fits.scatter, _WIDE)[:, None]
    costly = _penalise_squares(fits) > _COSTLY
    return _rescan(task, fits, costly, np.broadcast_to(grid, (*costly.shape, len(_WIDE))), 1.0)


def rescan_outlying_pushes(task: EnsembleTask, fits: Fits) -> Fits:
    """The fits with the own mu_s of pushes that fit worse than the others, by more than chance,
    taken from a grid close by: beside a jump of its answer a push may have another valley, a few
    standard errors away, and as long as it is in the wrong one every step of the fit fails."""
    if not task.mu_free:
        return fits
    numbers = np.maximum(task.counts.sum(axis=1), 1.0)
    left = np.einsum("mnk,mk->mn", fits.gram[..., -1, -1], 1.0 / fits.spread**2) / numbers
    usual = np.median(left, axis=1, keepdims=True)
    outlying = left > usual * (1 + _OUTLYING * np.sqrt(2 / numbers))
    return _rescan(task, fits, outlying, _make_close_grid(fits, compute_own_errors(fits)), 1.0)


def rescan_caught_pushes(
    task: EnsembleTask, before: Fits, after: Fits, failed: NDArray, pushes: NDArray | None
) -> Fits:
    """The fits `after` a step from `before` with the own mu_s of those few pushes that made it fail
    taken from a grid close by, or the very same object where that betters none: a jump of its
    answer keeps such a push from following. `failed` (m,) says which steps did."""
    if not (task.mu_free and failed.any()):
        return after
    rise = _penalise_squares(after) - _penalise_squares(before)
    if pushes is not None:
        rise[:, np.setdiff1d(np.arange(task.n), pushes)] = 0.0
    caught = rise > np.maximum(_RISES * rise.max(axis=1, keepdims=True), _WORTH)
    caught &= failed[:, None] & (caught.mean(axis=1, keepdims=True) <= _CAUGHT)
    return _rescan(task, after, caught, _make_close_grid(after, compute_own_errors(before)), 1.0)


def _penalise_squares(fits: Fits) -> NDArray:
    """The sum of squares (m, n) of each push, and what its own mu_s costs beside its scatter."""
    squares = np.einsum("mnk,mk->mn", fits.gram[..., -1, -1], 1.0 / fits.spread**2)
    return squares + (fits.own / fits.scatter[:, None]) ** 2


def compute_own_errors(fits: Fits) -> NDArray:
    """The standard error (m, n) of each push's own log mu_s."""
    z = np.einsum("mnk,mk->mn", fits.gram[:, :, :, 0, 0], 1.0 / fits.spread**2)
    return (z + 1.0 / fits.scatter[:, None] ** 2) ** -0.5


def make_own_grid(fits: Fits, error: NDArray) -> NDArray:
    """The own log mu_s (m, n, values) to try, within what the pushes leave open."""
    return fits.own[:, :, None] + error[:, :, None] * _NEAR


def _make_close_grid(fits: Fits, error: NDArray) -> NDArray:
    """The own log mu_s (m, n, values) to try beside a jump, close to where the pushes are."""
    return fits.own[:, :, None] + error[:, :, None] * _CLOSE


def _rescan(task: EnsembleTask, fits: Fits, asked: NDArray, grid: NDArray, charged: float) -> Fits:
    """The fits with the own mu_s of the pushes `asked` (m, n) from `grid` (m, n, values) where that
    fits better, or the very same object where none does. `charged` 1 counts what an own mu_s costs
    beside its scatter, 0 does not."""
    j, i = np.nonzero(asked)
    if not len(j):
        return fits
    penalty = charged / fits.scatter[j] ** 2
    before = np.einsum("pk,pk->p", fits.gram[j, i][..., -1, -1], 1.0 / fits.spread[j] ** 2)
    before = before + penalty * fits.own[j, i] ** 2
    tried = grid[j, i]
    squares = sum_squares_at(task, fits, j, i, fits.c[j], fits.mu[j, task.condition[i]], tried)
    value = squares + penalty[:, None] * tried**2
    best = np.argmin(value, axis=1)
    better = np.take_along_axis(value, best[:, None], 1)[:, 0] < before - _WORTH
    if not better.any():
        return fits
    own = fits.own.copy()
    own[j[better], i[better]] = tried[better, best[better]]
    return replace(fits, own=own, gram=None, residual=None, damping=None)


def sum_squares_at(
    task: EnsembleTask, fits: Fits, j: NDArray, i: NDArray, c: NDArray, mu: NDArray, own: NDArray
) -> NDArray:
    """The sums of squares (N, values) of pushes i (N,) of fits j (N,) at coordinates c (N, K), log
    mu_s mu (N,) and each of own (N, values); infinite where a push could not be followed."""
    N, values = own.shape
    rows = np.repeat(c, values, axis=0)
    rows[:, 0] = (mu[:, None] + own).ravel()
    found = task.model.answers(np.repeat(i, values), rows, np.zeros((0, rows.shape[1])))
    spread = np.repeat(fits.spread[j], values, axis=0)
    squares = np.einsum("nk,nk->n", found.gram[:, :, -1, -1], 1.0 / spread**2)
    return np.where(np.isfinite(squares), squares, np.inf).reshape(N, values)
