"""How an ensemble's fits move: Levenberg-Marquardt within bounds, and pushes that are held out.

`refit` takes all fits to their optima together. Where a push has several mu_s that fit, no small
step leads from one to another: `rescan_bad_pushes`, `rescan_loose_pushes` and
`rescan_outlying_pushes` look on a grid.
Axes as in `ensemble`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.estimation import ensemble as en
from difffric.estimation.ensemble import EnsembleTask, Fits
from difffric.estimation.following.differenced_model import DifferencedModel

_STALE = 1.0
"""Standard deviations that a push's own mu_s may be off where a fit stands."""
_NOTHING = 1e-6
"""Share of a sum of squares, up to a sum of 1, that is not worth a step where steps have begun to
fail: the model jumps there."""
_LITTLE, _FAR_ABOVE = 1e-4, 10.0
"""The share of a sum of squares that is not worth a step, and how many times what noise leaves it
is there at least."""
_GAINED = 0.02
"""What a fit that has arrived has left to gain in chi-square."""
_SETTLING = 2
"""Times that it is brought closer."""
_FAR = 0.5
"""A push's own log mu_s is not moved further than this at once: a linear prediction is no guide."""
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
    now = gather_point(task, fits)
    step = solve_within(found.H, found.g, now, *find_limits(task, fits), damping)
    new = now + step
    weight = 1.0 / (found.z + 1.0 / fits.scatter[:, None] ** 2)
    own = -(found.gm + np.einsum("mnp,mp->mn", found.h, step)) * weight
    gain = -np.einsum("mp,mp->m", step, 2 * found.g + np.einsum("mpq,mq->mp", found.H, step))
    return replace(place_at(task, fits, new), own=own, gram=None), gain


def _settle_own(task: EnsembleTask, fits: Fits, pushes: NDArray | None) -> Fits:
    """The fits with the answers where they stand, and each push's own mu_s at what is best there.

    What a step said of the own mu_s is not exact, and a push may tell it to a part in ten thousand.
    Where derivatives by many parameters are asked for, they are taken once the own mu_s rest.
    """
    if _has_many(task, fits):
        return en.evaluate(task, settle_narrowly(task, fits, pushes), pushes)
    return _settle(task, fits, pushes)


def _has_many(task: EnsembleTask, fits: Fits) -> bool:
    """Whether fits have so many free parameters that their derivatives take several calls."""
    return 1 + len(task.shared) + max(map(len, fits.extra)) > task.model.directions


def settle_narrowly(task: EnsembleTask, fits: Fits, pushes: NDArray | None = None) -> Fits:
    """The fits with each push's own mu_s at what is best, their answers without the derivatives by
    any other parameter, and with that by this one from differences."""
    alone = replace(fits, extra=((),) * fits.m)
    model: Any = DifferencedModel(task.model)
    found = _settle(replace(task, shared=(), model=model), alone, pushes)
    return replace(found, extra=fits.extra)


def _settle(task: EnsembleTask, fits: Fits, pushes: NDArray | None) -> Fits:
    """As `_settle_own`, with all derivatives each time."""
    fits = en.evaluate(task, fits, pushes)
    for _ in range(_SETTLING if task.mu_free else 0):
        found = en.normal_equations(task, fits)
        best = -found.gm / (found.z + 1.0 / fits.scatter[:, None] ** 2)
        away = np.abs(best - fits.own)
        stale = away * np.sqrt(found.z) > _STALE
        off = stale.any(axis=1)
        off &= np.isfinite(best).all(axis=1) & (away.max(axis=1) < _FAR)
        if not off.any():
            break
        which = np.flatnonzero(off)
        at = fits.pick(which)
        # Most pushes rest after the first answer: only the others are followed again.
        some = np.flatnonzero(stale[which].any(axis=0))
        own = at.own.copy()
        own[:, some] = best[which][:, some]
        again = _keep_answers(at, en.evaluate(task, replace(at, own=own), some), some)
        better = en.sum_squares(task, again) < en.sum_squares(task, at)
        if better.any():
            fits = replace_fits(fits, which[better], again.pick(np.flatnonzero(better)))
    return fits


def _keep_answers(before: Fits, fits: Fits, pushes: NDArray) -> Fits:
    """The fits, which have answers for some `pushes`, with those of `before` for all others."""
    size = max(before.gram.shape[-1], fits.gram.shape[-1])
    gram, residual = en.widen(before.gram, size).copy(), before.residual.copy()
    gram[:, pushes] = en.widen(fits.gram[:, pushes], size)
    residual[:, pushes] = fits.residual[:, pushes]
    return replace(fits, gram=gram, residual=residual)


def _keep_own(fits: Fits, narrow: bool) -> Fits:
    """The fits as their answers are: where these have no derivatives but by the own mu_s, with
    nothing else free."""
    return replace(fits, extra=((),) * fits.m) if narrow else fits


def _list_columns(task: EnsembleTask, extra: tuple[int, ...]) -> list[int]:
    """The coordinates behind the parameters after the conditions' mu_s."""
    return [*task.shared, *extra]


def find_limits(task: EnsembleTask, fits: Fits) -> tuple[NDArray, NDArray]:
    """The lower and the upper bounds (m, P) of the parameters."""
    P = gather_point(task, fits).shape[1]
    lower, upper = np.full((fits.m, P), -np.inf), np.full((fits.m, P), np.inf)
    for j, extra in enumerate(fits.extra):
        for k, i in enumerate(_list_columns(task, extra)):
            lower[j, task.conditions + k], upper[j, task.conditions + k] = en.bounds(task, i)
    return lower, upper


def gather_point(task: EnsembleTask, fits: Fits) -> NDArray:
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


def place_at(task: EnsembleTask, fits: Fits, point: NDArray) -> Fits:
    """The fits with their parameters at `point` (m, P)."""
    c = fits.c.copy()
    for j, extra in enumerate(fits.extra):
        for k, i in enumerate(_list_columns(task, extra)):
            c[j, i] = point[j, task.conditions + k]
    return replace(fits, mu=point[:, : task.conditions].copy(), c=c)


def refit(
    task: EnsembleTask, fits: Fits, rounds: int, pushes: NDArray | None = None, tol: float = _GAINED
) -> Fits:
    """The fits after at most `rounds` of Levenberg-Marquardt, on all pushes or on some.

    A fit rests once it has arrived: less than `tol` is left to gain in chi-square, or a small share
    of what it leaves where that is far more than noise: such a fit is on its way to another model.
    """
    if fits.gram is None:
        fits = en.estimate_scatters(task, _settle_own(task, fits, pushes))
    damping = fits.damping if fits.damping is not None else np.full(fits.m, 1e-3)
    counted = task.counts.sum() if pushes is None else task.counts[pushes].sum()
    active = np.ones(fits.m, bool)
    for _ in range(rounds):
        which = np.flatnonzero(active)
        if not len(which):
            break
        at = fits.pick(which)
        moved, promised = _predict_step(task, at, damping[which])
        many = _has_many(task, at)
        settle = settle_narrowly if many else _settle_own
        trial = settle(task, moved, pushes)
        before = en.profile_cost(task, at)
        after = en.profile_cost(replace(task, shared=()) if many else task, _keep_own(trial, many))
        better = after < before
        damping[which] = np.where(better, np.maximum(damping[which] / 8, 1e-9), damping[which] * 8)
        # Where a step that promises so little fails, shorter ones promise less.
        least = np.where(better, tol, np.clip(_NOTHING * before, tol, 1.0))
        least = np.maximum(least, _LITTLE * (before - _FAR_ABOVE * counted))
        done = np.where(better, before - after, promised) < least
        done |= damping[which] > 1e6
        if better.any():
            good = trial.pick(np.flatnonzero(better))
            good = en.evaluate(task, good, pushes) if many else good
            good = en.estimate_scatters(task, good)
            fits = replace_fits(fits, which[better], good)
        active[which[done]] = False
    return replace(fits, damping=damping)


def refit_past_jumps(task: EnsembleTask, fits: Fits, rounds: int, tol: float = _GAINED) -> Fits:
    """The fits after at most so many `rounds`, and as many again where a push that is beside a jump
    of its answer has kept one from moving."""
    fits = refit(task, fits, rounds, tol=tol)
    again = rescan_outlying_pushes(task, fits)
    return fits if again is fits else refit(task, again, rounds, tol=tol)


def refit_without(
    task: EnsembleTask, fits: Fits, before: Fits, gone: Sequence[int], rounds: int
) -> Fits:
    """Return the fit (an ensemble of one) with the coordinates `gone` as they are in the fit
    `before`, which has none of them, and all else that is free fitted anew."""
    c, extra = fits.c.copy(), tuple(i for i in fits.extra[0] if i not in gone)
    c[0, gone] = before.c[0, gone]
    less = replace(fits, c=c, extra=(extra,), gram=None, residual=None, damping=None)
    # Without a strong effect the plain parameters are elsewhere: where they were before.
    there, shared = c.copy(), list(task.shared)
    there[0, shared] = before.c[0, shared]
    both = en.join(less, replace(less, c=there, mu=before.mu, own=before.own))
    nearer = int(np.argmin(en.criterion(task, en.evaluate(task, both))))
    return refit(task, both.pick(nearer), rounds)


def move_unseen(task: EnsembleTask, fits: Fits, before: Fits, some: NDArray) -> Fits:
    """The fits, which are to the pushes `some`, with the mu_s of all others moved from where it was
    `before` by as much as that of these was on average."""
    now, then = (one.mu[:, task.condition] + one.own for one in (fits, before))
    total = then + (now - then)[:, some].mean(axis=1, keepdims=True)
    total[:, some] = now[:, some]
    return replace(fits, own=total - fits.mu[:, task.condition])


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
    grid = fits.own[:, :, None] + compute_own_errors(fits)[:, :, None] * _CLOSE
    return _rescan(task, fits, outlying, grid, 1.0)


def compute_own_errors(fits: Fits) -> NDArray:
    """The standard error (m, n) of each push's own log mu_s."""
    z = np.einsum("mnk,mk->mn", fits.gram[:, :, :, 0, 0], 1.0 / fits.spread**2)
    return (z + 1.0 / fits.scatter[:, None] ** 2) ** -0.5


def make_own_grid(fits: Fits, error: NDArray) -> NDArray:
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
