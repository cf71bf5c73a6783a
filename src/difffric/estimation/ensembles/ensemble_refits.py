"""How an ensemble's fits move: Levenberg-Marquardt within bounds.

`refit` takes all fits to their optima together; where a push has several mu_s that fit, it asks
`friction_scan`. Axes as in `ensemble`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.estimation.ensembles import ensemble as en
from difffric.estimation.ensembles import friction_scan
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.following.differenced_model import DifferencedModel

_FIRST, _HOPELESS = 4, 2.0
"""Rounds after which a fit is given up that leaves so many times as much as its best rival."""
_CHOICE = 2
"""Rounds after which one of several starts without an effect is chosen."""
_STALE = 1.0
"""Standard deviations that a push's own mu_s may be off where a fit stands, and what they may cost
in all."""
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


def predict_gain(task: EnsembleTask, fits: Fits) -> NDArray:
    """The fall of the sum of squares (m,) that the fits' linear models promise of a step within
    the bounds."""
    return _predict_step(task, fits, 0.0)[1]


def _predict_step(
    task: EnsembleTask,
    fits: Fits,
    damping: ArrayLike,
    limits: tuple[NDArray, NDArray] | None = None,
) -> tuple[Fits, NDArray]:
    """The fits after one damped Gauss-Newton step within `limits`, by default the parameters' own,
    and the fall of the sum of squares (m,) that their linear models promise of it."""
    found = en.normal_equations(task, fits)
    now = gather_point(task, fits)
    limits = find_limits(task, fits) if limits is None else limits
    step = solve_within(found.H, found.g, now, *limits, damping)
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
    task: EnsembleTask,
    fits: Fits,
    rounds: int,
    pushes: NDArray | None = None,
    tol: float = _GAINED,
    rival: float | None = None,
) -> Fits:
    """The fits after at most `rounds` of Levenberg-Marquardt, on all pushes or on some.

    A fit rests once it has arrived: less than `tol` is left to gain in chi-square, or a small share
    of what it leaves where that is far more than noise: such a fit is on its way to another model.
    With a `rival` sum of squares, or infinity, only the best fit is wanted: what has no hope to be
    it after a few rounds rests, too.
    """
    if fits.gram is None:
        fits = en.estimate_scatters(task, _settle_own(task, fits, pushes))
    damping = fits.damping if fits.damping is not None else np.full(fits.m, 1e-3)
    counted = task.counts.sum() if pushes is None else task.counts[pushes].sum()
    active, failed = np.ones(fits.m, bool), np.zeros(fits.m, int)
    for k in range(rounds):
        if k == _FIRST and rival is not None:
            active &= find_hopeful(task, fits, rival)
        which = np.flatnonzero(active)
        if not len(which):
            break
        at = fits.pick(which)
        moved, promised = _predict_step(task, at, damping[which])
        many = _has_many(task, at)
        before = en.profile_cost(task, at)
        # Where far more than noise is left a step fails as it is too long, and not by a jump.
        near = before < _FAR_ABOVE * counted
        trial, after = _try_step(task, at, moved, np.where(near, before, np.inf), pushes, many)
        better = after < before
        failed[which] = np.where(better, 0, failed[which] + 1)
        harder = np.where(near & (failed[which] > 1), 64.0, 8.0)
        damping[which] *= np.where(better, 1 / 8, harder)
        damping = np.maximum(damping, 1e-9)
        # Where a step that promises so little fails, shorter ones promise less.
        least = np.where(better, tol, np.clip(_NOTHING * before, tol, 1.0))
        least = np.maximum(least, _LITTLE * (before - _FAR_ABOVE * counted))
        done = np.where(better, before - after, promised) < least
        done |= damping[which] > 1e6
        if better.any():
            good = trial.pick(np.flatnonzero(better))
            good = en.evaluate(task, good, pushes) if many else good
            good = en.estimate_scatters(task, good)
            # Where the scatter has fallen each push's own mu_s has to follow it yet.
            done[better] &= en.profile_cost(task, good) < after[better] + _STALE
            fits = replace_fits(fits, which[better], good)
        active[which[done]] = False
    return replace(fits, damping=damping)


def _try_step(
    task: EnsembleTask,
    at: Fits,
    moved: Fits,
    least: NDArray,
    pushes: NDArray | None,
    narrow: bool,
) -> tuple[Fits, NDArray]:
    """The fits after a step from `at` to `moved`, and what they cost there (m,). Where that is more
    than `least` (m,), a few pushes that a jump of their answer keeps from following are taken over
    it. With `narrow` the answers have no derivatives but by the own mu_s."""

    def answer(fits: Fits) -> tuple[Fits, NDArray]:
        found = (settle_narrowly if narrow else _settle_own)(task, fits, pushes)
        known = replace(task, shared=()) if narrow else task
        return found, en.profile_cost(known, _keep_own(found, narrow))

    trial, after = answer(moved)
    freed = friction_scan.rescan_caught_pushes(task, at, trial, after > least, pushes)
    which = np.flatnonzero((freed.own != trial.own).any(axis=1))
    if len(which):
        again, cost = answer(freed.pick(which))
        good = cost < after[which]
        trial = replace_fits(trial, which[good], again.pick(np.flatnonzero(good)))
        after[which[good]] = cost[good]
    return trial, after


def find_hopeful(task: EnsembleTask, fits: Fits, reference: float = np.inf) -> NDArray:
    """Which fits (m,) of those that compete to explain the same data may still be the best: where
    the best, or a `reference` sum of squares, is little more than noise, no other that leaves far
    more."""
    cost = en.profile_cost(task, fits)
    best = min(float(cost.min()), reference)
    return (cost <= _HOPELESS * best) | (best >= _FAR_ABOVE * task.counts.sum())


def refit_past_jumps(task: EnsembleTask, fits: Fits, rounds: int, tol: float = _GAINED) -> Fits:
    """The fits, of which the best is wanted, after at most so many `rounds`, and as many again
    where a push that is beside a jump of its answer has kept one from moving, or has another mu_s
    that fits better."""
    fits = refit(task, fits, rounds, tol=tol, rival=np.inf)
    which = np.flatnonzero(find_hopeful(task, fits))
    for rescan in (friction_scan.rescan_outlying_pushes, friction_scan.rescan_loose_pushes):
        some = fits.pick(which)
        again = rescan(task, some)
        if again is not some:
            fits = replace_fits(fits, which, refit(task, again, rounds, tol=tol))
    return fits


def refit_without(
    task: EnsembleTask,
    fits: Fits,
    before: Fits,
    gone: Sequence[Sequence[int]],
    rounds: int,
    enough: float = np.inf,
) -> Fits:
    """Return the fit (an ensemble of one) with what is `gone` as it is in the fit `before`, which
    has none of it, and all else that is free fitted anew; `gone` has the coordinates of each
    effect, that of its size first. A fit that is worse by more than `enough` in chi-square is not
    followed to its end."""
    every, sizes = [i for effect in gone for i in effect], [effect[0] for effect in gone]
    extra = tuple(i for i in fits.extra[0] if i not in every)

    def start(at: Fits, shared: Fits) -> Fits:
        c = at.c.copy()
        c[0, every] = before.c[0, every]
        c[0, list(task.shared)] = shared.c[0, list(task.shared)]
        return Fits((extra,), c, shared.mu, shared.own, fits.scatter, fits.spread)

    # Where it stands, where the plain parameters were before, and where all else makes up for it.
    limits = find_limits(task, fits)
    for k, i in enumerate(_list_columns(task, fits.extra[0]), start=task.conditions):
        for limit in limits if i in every else ():
            limit[0, k] = before.c[0, i] if i in sizes else fits.c[0, i]
    moved, _ = _predict_step(task, fits, 1e-3, limits)
    starts = en.join(start(fits, fits), start(fits, before), start(moved, moved))
    if np.isfinite(enough) and _has_many(task, starts):
        values = settle_narrowly(task, starts)
        cost = en.profile_cost(replace(task, shared=()), _keep_own(values, True))
        if cost.min() - en.profile_cost(task, fits)[0] > enough:
            best = replace(values.pick(int(np.argmin(cost))), gram=None, residual=None)
            found = refit(task, best, _CHOICE)
            if en.profile_cost(task, found)[0] - en.profile_cost(task, fits)[0] > enough:
                return found
    found = refit(task, starts, _CHOICE)
    best = int(np.argmin(en.criterion(task, found)))
    return refit(task, found.pick(best), rounds)


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
