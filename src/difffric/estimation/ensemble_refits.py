"""How an ensemble's fits move: Levenberg-Marquardt within bounds, and pushes that are held out.

`refit` takes all fits to their optima together. Where a push has several mu_s that fit, no small
step leads from one to another: `rescan_bad_pushes` and `rescan_loose_pushes` look on a grid.
`predict_held_out` says what fits to the other pushes make of each push. Axes as in `ensemble`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.estimation import ensemble as en
from difffric.estimation.ensemble import EnsembleTask, Fits

_STALE = 1.0
"""Standard deviations that a push's own mu_s may be off where a fit stands."""
_NOTHING = 1e-6
"""Share of a sum of squares, up to a sum of 1, that is not worth a step where steps have begun to
fail: the model jumps there."""
_SETTLING = 2
"""Times that it is brought closer."""
_FAR = 0.5
"""A push's own log mu_s is not moved further than this at once: a linear prediction is no guide."""
_BAD = 3.0
"""Squared residual per number from which a push fits badly."""
_ASTRAY = 3.0
"""Times what a push's squares are where it is fitted, or would be: a prediction beyond is no mere
lack of data."""
_ANEW = 10
"""Rounds of a fit that is made anew for a push that is held out."""
_JUMP = 3.0
"""Standard deviations of chi-square beyond the fit's, from which a prediction may be on another
branch of its own mu_s."""
_OWN = np.linspace(-0.35, 0.35, 21)
_FINE = np.linspace(-0.7, 0.7, 113)
"""The own log mu_s that are tried in a push that fits badly, and those where that led nowhere."""
_LOOSE, _NEAR = 5e-4, np.linspace(-3.0, 3.0, 13)
"""The standard error of a push's own log mu_s from which it is looked for on a grid, and the grid
in units of it."""
_WORTH = 1.0
"""By how much a sum of squares must fall to be worth another branch."""


def solve_within(
    H: NDArray,
    g: NDArray,
    now: NDArray,
    lower: NDArray,
    upper: NDArray,
    damping: ArrayLike = 0.0,
) -> NDArray:
    """The steps (m, P) that solve the normal equations H (m, P, P), g (m, P) from `now` (m, P) and
    end within bounds: what would cross one ends there, and the others make the best of it."""
    stopped = np.zeros(now.shape, bool)
    end = np.zeros(now.shape)
    for _ in range(5):
        pull = g + np.einsum("mpq,mq->mp", H, end)
        A = np.where(stopped[:, :, None] | stopped[:, None, :], 0.0, H)
        step = np.where(stopped, end, en.solve(A, np.where(stopped, 0.0, pull), damping))
        new = now + step
        crossed = ~stopped & ((new < lower) | (new > upper))
        if not crossed.any():
            break
        end = np.where(crossed, np.clip(new, lower, upper) - now, end)
        stopped |= crossed
    return np.clip(now + step, lower, upper) - now


def take_step(task: EnsembleTask, fits: Fits, damping: ArrayLike) -> Fits:
    """The fits after one damped Gauss-Newton step within the bounds; their answers are still those
    of before, so that `gram` is None."""
    return _predict_step(task, fits, damping)[0]


def _predict_step(task: EnsembleTask, fits: Fits, damping: ArrayLike) -> tuple[Fits, NDArray]:
    """The fits after one damped Gauss-Newton step, and the fall of the sum of squares (m,) that
    their linear models promise of it."""
    found = en.normal_equations(task, fits)
    now = _gather_point(task, fits)
    step = solve_within(found.H, found.g, now, *_find_limits(task, fits), damping)
    new = now + step
    weight = 1.0 / (found.z + 1.0 / fits.scatter[:, None] ** 2)
    own = -(found.gm + np.einsum("mnp,mp->mn", found.h, step)) * weight
    gain = -np.einsum("mp,mp->m", step, 2 * found.g + np.einsum("mpq,mq->mp", found.H, step))
    return replace(_place_at(task, fits, new), own=own, gram=None), gain


def _settle_own(task: EnsembleTask, fits: Fits, pushes: NDArray | None) -> Fits:
    """The fits with the answers where they stand, and each push's own mu_s at what is best there.

    What a step said of the own mu_s is not exact, and a push may tell it to a part in ten thousand.
    Where derivatives by many parameters are asked for, they are taken once the own mu_s rest.
    """
    if _has_many(task, fits):
        return en.evaluate(task, _settle_narrowly(task, fits, pushes), pushes)
    return _settle(task, fits, pushes)


def _has_many(task: EnsembleTask, fits: Fits) -> bool:
    """Whether fits have so many free parameters that their derivatives take several calls."""
    return 1 + len(task.shared) + max(map(len, fits.extra)) > task.model.directions


def _settle_narrowly(task: EnsembleTask, fits: Fits, pushes: NDArray | None) -> Fits:
    """The fits with each push's own mu_s at what is best, their answers without the derivatives by
    any other parameter."""
    alone = replace(fits, extra=((),) * fits.m)
    found = _settle(replace(task, shared=()), alone, pushes)
    return replace(found, extra=fits.extra)


def _settle(task: EnsembleTask, fits: Fits, pushes: NDArray | None) -> Fits:
    """As `_settle_own`, with all derivatives each time."""
    fits = en.evaluate(task, fits, pushes)
    for _ in range(_SETTLING if task.mu_free else 0):
        found = en.normal_equations(task, fits)
        best = -found.gm / (found.z + 1.0 / fits.scatter[:, None] ** 2)
        away = np.abs(best - fits.own)
        off = (away * np.sqrt(found.z)).max(axis=1) > _STALE
        off &= np.isfinite(best).all(axis=1) & (away.max(axis=1) < _FAR)
        if not off.any():
            break
        which = np.flatnonzero(off)
        at = fits.pick(which)
        again = en.evaluate(task, replace(at, own=best[which]), pushes)
        better = en.sum_squares(task, again) < en.sum_squares(task, at)
        if better.any():
            fits = replace_fits(fits, which[better], again.pick(np.flatnonzero(better)))
    return fits


def _keep_own(fits: Fits, narrow: bool) -> Fits:
    """The fits as their answers are: where these have no derivatives but by the own mu_s, with
    nothing else free."""
    return replace(fits, extra=((),) * fits.m) if narrow else fits


def _list_columns(task: EnsembleTask, extra: tuple[int, ...]) -> list[int]:
    """The coordinates behind the parameters after the conditions' mu_s."""
    return [*task.shared, *extra]


def _find_limits(task: EnsembleTask, fits: Fits) -> tuple[NDArray, NDArray]:
    """The lower and the upper bounds (m, P) of the parameters."""
    P = _gather_point(task, fits).shape[1]
    lower, upper = np.full((fits.m, P), -np.inf), np.full((fits.m, P), np.inf)
    for j, extra in enumerate(fits.extra):
        for k, i in enumerate(_list_columns(task, extra)):
            lower[j, task.conditions + k], upper[j, task.conditions + k] = en.bounds(task, i)
    return lower, upper


def _gather_point(task: EnsembleTask, fits: Fits) -> NDArray:
    """The parameters (m, P) where the fits stand."""
    width = len(task.shared) + max((len(x) for x in fits.extra), default=0)
    if fits.gram is not None:
        width = max(width, fits.gram.shape[-1] - 2)
    out = np.zeros((fits.m, task.conditions + width))
    out[:, : task.conditions] = fits.mu
    for j, extra in enumerate(fits.extra):
        for k, i in enumerate(_list_columns(task, extra)):
            out[j, task.conditions + k] = fits.c[j, i]
    return out


def _place_at(task: EnsembleTask, fits: Fits, point: NDArray) -> Fits:
    """The fits with their parameters at `point` (m, P)."""
    c = fits.c.copy()
    for j, extra in enumerate(fits.extra):
        for k, i in enumerate(_list_columns(task, extra)):
            c[j, i] = point[j, task.conditions + k]
    return replace(fits, mu=point[:, : task.conditions].copy(), c=c)


def refit(
    task: EnsembleTask, fits: Fits, rounds: int, pushes: NDArray | None = None, tol: float = 0.02
) -> Fits:
    """The fits after at most `rounds` of Levenberg-Marquardt, on all pushes or on some.

    A fit rests once it has arrived: less than `tol` is left to gain in chi-square.
    """
    if fits.gram is None:
        fits = en.estimate_scatters(task, _settle_own(task, fits, pushes))
    damping = fits.damping if fits.damping is not None else np.full(fits.m, 1e-3)
    active = np.ones(fits.m, bool)
    for _ in range(rounds):
        which = np.flatnonzero(active)
        if not len(which):
            break
        at = fits.pick(which)
        moved, promised = _predict_step(task, at, damping[which])
        many = _has_many(task, at)
        settle = _settle_narrowly if many else _settle_own
        trial = settle(task, moved, pushes)
        before = en.profile_cost(task, at)
        after = en.profile_cost(replace(task, shared=()) if many else task, _keep_own(trial, many))
        better = after < before
        damping[which] = np.where(better, np.maximum(damping[which] / 8, 1e-9), damping[which] * 8)
        # Where a step that promises so little fails, shorter ones promise less.
        least = np.where(better, tol, np.clip(_NOTHING * before, tol, 1.0))
        done = np.where(better, before - after, promised) < least
        done |= damping[which] > 1e6
        if better.any():
            good = trial.pick(np.flatnonzero(better))
            good = en.evaluate(task, good, pushes) if many else good
            good = en.estimate_scatters(task, good)
            fits = replace_fits(fits, which[better], good)
        active[which[done]] = False
    return replace(fits, damping=damping)


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
    error = _compute_own_errors(fits)
    return _rescan(task, fits, error > _LOOSE, _make_grid(fits, error), 1.0)


def _compute_own_errors(fits: Fits) -> NDArray:
    """The standard error (m, n) of each push's own log mu_s."""
    z = np.einsum("mnk,mk->mn", fits.gram[:, :, :, 0, 0], 1.0 / fits.spread**2)
    return (z + 1.0 / fits.scatter[:, None] ** 2) ** -0.5


def _make_grid(fits: Fits, error: NDArray) -> NDArray:
    """The own log mu_s (m, n, values) to try, within what the pushes leave open."""
    return fits.own[:, :, None] + error[:, :, None] * _NEAR


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
    squares = _sum_squares_at(task, fits, j, i, fits.c[j], fits.mu[j, task.condition[i]], tried)
    value = squares + penalty[:, None] * tried**2
    best = np.argmin(value, axis=1)
    better = np.take_along_axis(value, best[:, None], 1)[:, 0] < before - _WORTH
    if not better.any():
        return fits
    own = fits.own.copy()
    own[j[better], i[better]] = tried[better, best[better]]
    return replace(fits, own=own, gram=None, residual=None, damping=None)


def _sum_squares_at(
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


def replace_fits(fits: Fits, which: NDArray, new: Fits) -> Fits:
    """The fits with those numbered `which` replaced by `new` ones; their damping stays."""

    def put(old: NDArray | None, values: NDArray | None) -> NDArray | None:
        if old is None or values is None:
            return old
        out = old.copy()
        if out.ndim > 3 and out.shape[-1] != values.shape[-1] and out.shape[-2] == out.shape[-1]:
            values = en.widen(values, out.shape[-1])
        out[which] = values
        return out

    names = ("c", "mu", "own", "scatter", "spread", "gram", "residual")
    return replace(fits, **{x: put(getattr(fits, x), getattr(new, x)) for x in names})


class HeldOut(NamedTuple):
    """What fits say of pushes that they have not seen."""

    squares: NDArray
    """(m, n) sums of squares, each push's own mu_s alone re-estimated"""
    penalised: NDArray
    """(m, n) the same with what that mu_s costs beside its scatter"""
    surprise: NDArray
    """(m, n) -2 log likelihood but for a constant, each push's own mu_s averaged over: what
    explains the scatter of mu_s, as a drift does, gains here and not in the squares"""
    expected: NDArray
    """(m, n) what noise alone leaves of the penalised squares on average, the error of a fit to
    the other folds included"""
    variance: NDArray
    """(m, n) of the same"""


def predict_held_out(task: EnsembleTask, fits: Fits, folds: NDArray) -> HeldOut:
    """Each push as a fit to the other folds predicts it. `folds` (n,) numbers each push's fold.

    The parameters without a fold are one Gauss-Newton step from the fit to everything; where that
    leads astray they are fitted anew. The push is then followed with them, exactly.
    """
    parts = en.split_by_push(task, fits)
    H_i, h, z, g_i, gm, _ = parts
    weight = 1.0 / (z + 1.0 / fits.scatter[:, None] ** 2)
    H_i = H_i - np.einsum("mnp,mnq,mn->mnpq", h, h, weight)
    g_i = g_i - h * (gm * weight)[:, :, None]
    limits, now = _find_limits(task, fits), _gather_point(task, fits)
    c = np.repeat(fits.c[:, None], task.n, axis=1)
    mu = np.zeros((fits.m, task.n))
    noise = np.zeros((2, fits.m, task.n))
    for fold in np.unique(folds):
        out = folds == fold
        H, g = H_i[:, ~out].sum(axis=1), g_i[:, ~out].sum(axis=1)
        at = _place_at(task, fits, now + solve_within(H, g, now, *limits))
        c[:, out], mu[:, out] = at.c[:, None], at.mu[:, task.condition[out]]
        noise[:, :, out] = _foresee_squares(task, H, H_i[:, out], np.flatnonzero(out))
    found = _predict(task, fits, c, mu, noise)
    seen = np.einsum("mnk,mk->mn", fits.gram[..., -1, -1], 1.0 / fits.spread**2)
    numbers = task.counts.sum(axis=1)
    jumps = found.squares > seen + _JUMP * np.sqrt(2 * numbers)
    branches = _choose_branches(task, fits, jumps, c, mu)
    if branches is not fits:
        fits, found = branches, _predict(task, branches, c, mu, noise)
    astray = found.squares > _ASTRAY * (seen + numbers)
    for j, fold in {(j, folds[i]) for j, i in np.argwhere(astray)}:
        out = folds == fold
        at = replace(fits.pick([j]), gram=None, residual=None, damping=None)
        at = refit(task, at, _ANEW, np.flatnonzero(~out))
        c[j, out], mu[j, out] = at.c, at.mu[0, task.condition[out]]
    return _predict(task, fits, c, mu, noise) if astray.any() else found


def _foresee_squares(task: EnsembleTask, H: NDArray, H_i: NDArray, which: NDArray) -> NDArray:
    """The mean and the variance (2, m, which) of the penalised squares of pushes `which`, held out
    of a fit with the normal equations H (m, P, P), to which each would add H_i (m, which, P, P)."""
    zeros = task.model.recordings * (task.counts[which, 1] > 0)  # each position has its own zero
    numbers = task.counts[which].sum(axis=1) - zeros
    columns = np.moveaxis(H_i, 1, 2).reshape(*H.shape[:2], -1)
    # What the other folds do not determine is held where it is, and foreseen without an error.
    share = np.stack([-en.solve(H, columns[:, :, k]) for k in range(columns.shape[2])], axis=2)
    share = np.moveaxis(share.reshape(*H.shape[:2], len(which), -1), 2, 1)
    first = np.einsum("mnpp->mn", share)
    second = np.einsum("mnpq,mnqp->mn", share, share)
    return np.stack([numbers + first, 2 * (numbers + 2 * first + second)])


def _choose_branches(
    task: EnsembleTask, fits: Fits, asked: NDArray, c: NDArray, mu: NDArray
) -> Fits:
    """The fits with the own mu_s that is best at coordinates c (m, n, K) and log mu_s mu (m, n), of
    those pushes `asked` (m, n) that hardly tell it."""
    error = _compute_own_errors(fits)
    j, i = np.nonzero(asked & (error > _LOOSE))
    if not task.mu_free or not len(j):
        return fits
    tried = _make_grid(fits, error)[j, i]
    value = _sum_squares_at(task, fits, j, i, c[j, i], mu[j, i], tried)
    value = value + (tried / fits.scatter[j, None]) ** 2
    own = fits.own.copy()
    own[j, i] = np.take_along_axis(tried, np.argmin(value, axis=1)[:, None], 1)[:, 0]
    return replace(fits, own=own)


def _predict(task: EnsembleTask, fits: Fits, c: NDArray, mu: NDArray, noise: NDArray) -> HeldOut:
    """What pushes followed at coordinates c (m, n, K) and log mu_s mu (m, n) say, with their own
    mu_s estimated anew; `noise` (2, m, n) are the mean and the variance of what it alone leaves."""
    own, c = fits.own, c.copy()
    squares, penalised, surprise = np.full((3, fits.m, task.n), np.inf)
    for _ in range(2):
        c[:, :, 0] = mu + own
        rows = np.zeros((1, c.shape[2]))
        rows[0, 0] = float(task.mu_free)
        found = task.model.answers(
            np.tile(np.arange(task.n), fits.m), c.reshape(-1, c.shape[2]), rows
        )
        G = np.einsum(
            "mnkij,mk->mnij",
            found.gram.reshape(fits.m, task.n, 2, 2, 2),
            1.0 / fits.spread**2,
        )
        zz, gz, rr = G[:, :, 0, 0], G[:, :, 0, 1], G[:, :, 1, 1]
        s = 1.0 / fits.scatter[:, None] ** 2
        step = -(gz + s * own) / (zz + s)
        value = rr + 2 * step * gz + step**2 * zz
        value = np.where(np.isfinite(value), value, en.REJECTED)
        own = own + np.where(np.isfinite(step), step, 0.0)
        squares = np.minimum(squares, value)
        volume = np.where(np.isfinite(zz), np.log1p(zz / s), 0.0)
        penalised = np.minimum(penalised, value + s * own**2)
        surprise = np.minimum(surprise, value + s * own**2 + volume)
    return HeldOut(squares, penalised, surprise, *noise)
