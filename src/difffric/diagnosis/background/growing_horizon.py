"""Fits of recordings from afar: first the samples up to the first contact, at last all of them.

What a push does late depends on all that it did before. Fitted all at once from afar, pushes that
are caught again and again lead nowhere; the first contact alone is smooth in every parameter. And
as long as all pushes have the same mu_s, whatever the fit begins with leads to the same place:
mu_s of their own make up, wrongly, for what all else has wrong, and then nothing moves any more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.size_scan import sum_squares_at
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.diagnosis.data import DiagnosisData, choose_subset
from difffric.diagnosis.starting_values import find_contact_time, list_starting_values
from difffric.estimation.block_means import LONGEST, UnevenBlocks
from difffric.estimation.ensembles import ensemble, ensemble_refits, friction_scan
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits

_HORIZONS, _MORE_HORIZONS = (1.5, 4.0), (10.0, 25.0)
"""The first horizons, in times for which the part and the tip touch, and further ones where small
effects are fitted: slow pushes stick and slip many times before they are released."""
AT_EACH_HORIZON, WORTH = 8, 10.0
"""Steps at most at each horizon, and what one has to gain in chi-square."""
_FIRST_SCATTER = 0.03
"""Relative scatter of mu_s from which a fit begins at the set-up's numbers."""
_STIFFNESSES = np.array([0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8])
"""Shares of the set-up's stiffness from which a plain fit may begin: as rough as a guess may be."""
_OWN = np.linspace(-0.5, 0.5, 11)
"""Log mu_s of each push beyond the set-up's that are tried with each of them."""
_BEYOND = 5 * LONGEST
"""How far beyond a horizon [s] a block reaches at most."""
_FOLLOWED = 2
"""How many of these starts are followed."""
_HELD = 1e-3
"""Relative scatter of mu_s with which pushes have the same."""
_TOGETHER, _ALL_TOGETHER = 4, 12
"""Steps at most with the same mu_s, with one effect and with all."""
_LEADERS, _BEHIND = 6, 4.0
"""How many effects are followed at most, and how many times as much as the best they may leave."""


def start_plain_fit(data: DiagnosisData, guess: Fits) -> Fits:
    """Return the plain fit of recordings to which a rough set-up leads, `guess` (an ensemble of
    one): from the stiffness, and each push's mu_s, that suit the first contact best."""
    task = data.task
    first, *later = _list_horizons(data)
    stiffness = task.model.coordinates.index("k_N_per_m")
    some = cut_at(task, first)
    shares = _STIFFNESSES if stiffness in task.shared else np.ones(1)
    starts = ensemble.join(*[_begin_anew(guess)] * len(shares))
    c = starts.c.copy()
    c[:, stiffness] += np.log(shares)
    starts = replace(starts, c=c)
    if task.mu_free:
        starts = _look_for_own(some, starts)
    at = ensemble_refits.refit(some, starts, 1)
    best = np.argsort(ensemble.criterion(some, at))[:_FOLLOWED]
    at = ensemble_refits.refit(some, at.pick(best), AT_EACH_HORIZON, tol=WORTH)
    for horizon in later:
        best = np.argmin(ensemble.criterion(some, at))
        some = cut_at(task, horizon)
        at = ensemble_refits.refit(some, forget_answers(at.pick(best)), AT_EACH_HORIZON, tol=WORTH)
    return restore_scatter(task, at, guess)


def _look_for_own(task: EnsembleTask, fits: Fits) -> Fits:
    """Return the fits with each push's mu_s where it suits the samples best, on a grid."""
    j, i = (x.ravel() for x in np.indices((fits.m, task.n)))
    mu = fits.mu[j, task.condition[i]]
    tried = np.tile(_OWN, (len(j), 1))
    squares = friction_scan.sum_squares_at(task, fits, j, i, fits.c[j], mu, tried)
    log_mu = mu + _OWN[np.argmin(squares, axis=1)]
    log_mu = log_mu.reshape(fits.m, task.n)
    of_each = [task.condition == k for k in range(task.conditions)]
    level = np.stack([np.median(log_mu[:, mine], axis=1) for mine in of_each], axis=1)
    return replace(fits, mu=level, own=log_mu - level[:, task.condition])


def fit_first_contact(
    data: DiagnosisData, small: SmallEffects, guess: Fits, first: NDArray, share: float
) -> tuple[Fits, frozenset[int]]:
    """Return the fit to the samples before the horizon `first` with all small effects, which
    scatter by a `share` of their units, from the set-up's own numbers, `guess` (both ensembles of
    one); and the coordinates of the effects that are large in it: one that explains most, and those
    that are as far from their nulls beside it as they may be, where they go on."""
    guess, ends = _begin_anew(guess), []
    for start, large in _list_leaders(data, small, guess, first):
        task = cut_at(small.assume(data.task, share, large), first)
        at = small.free(replace(start, own=np.zeros_like(start.own)))
        at = _fit_with_same_friction(task, at, _ALL_TOGETHER)
        ends.append((rate_fit(task, at, large), at, large))
    best, least = (guess, frozenset[int]()), np.inf
    for _, at, large in sorted(ends, key=lambda end: end[0])[:_FOLLOWED]:
        task = cut_at(small.assume(data.task, share, large), first)
        at = forget_answers(replace(at, scatter=guess.scatter))
        at = ensemble_refits.refit(task, at, AT_EACH_HORIZON, tol=WORTH)
        cost = rate_fit(task, at, large)
        if cost < least:
            best, least = (at, large), cost
    at, large = best
    for _ in range(_FOLLOWED):
        freed = large | small.list_at_reach(at)
        task = cut_at(small.assume(data.task, share, freed), first)
        if freed == large:
            break
        there = ensemble_refits.refit(task, forget_answers(at), AT_EACH_HORIZON, tol=WORTH)
        cost = rate_fit(task, there, freed)
        if cost >= least:
            break
        at, large, least = there, freed, cost
    return at, large


def rate_fit(task: EnsembleTask, at: Fits, large: frozenset[int]) -> float:
    """-2 log likelihood of a fit (an ensemble of one), with what its large effects cost."""
    return float(ensemble.criterion(task, at)[0]) + task.price * len(large)


def _list_leaders(
    data: DiagnosisData, small: SmallEffects, guess: Fits, first: NDArray
) -> list[tuple[Fits, frozenset[int]]]:
    """List the fits (ensembles of one) of some pushes before the horizon `first` with one small
    effect of any size, or none, and the coordinate of that: those that explain most, and none."""
    task, some = cut_at(data.task, first), choose_subset(data.task)
    starts, own = [guess], [frozenset[int]()]
    for effect, i in zip(small.effects, small.index, strict=True):
        sizes = [
            task.model.coordinates.point(x)[0] for x in list_starting_values(effect, data.scales)
        ]
        points = np.repeat(guess.c, 1 + len(sizes), axis=0)
        points[:, i] = [small.start[i], *sizes]
        best = int(np.argmin(sum_squares_at(task, guess, points)))
        starts.append(replace(guess, c=points[best : best + 1], extra=((*guess.extra[0], i),)))
        own.append(frozenset([i]))
    fits = _fit_with_same_friction(task, ensemble.join(*starts), _TOGETHER, some)
    cost = ensemble.criterion(task, fits)
    near = [k for k in np.argsort(cost)[:_LEADERS] if cost[k] < _BEHIND * cost.min()]
    return [(fits.pick(k), own[k]) for k in dict.fromkeys([*near, 0])]


def _fit_with_same_friction(
    task: EnsembleTask, fits: Fits, rounds: int, pushes: NDArray | None = None
) -> Fits:
    """Return the fits after some steps in which all pushes of a condition have the same mu_s."""
    held = replace(fits, scatter=np.full(fits.m, _HELD))
    return ensemble_refits.refit(
        replace(task, estimate_scatter=False), held, rounds, pushes, tol=WORTH
    )


def _begin_anew(at: Fits) -> Fits:
    """The fits without answers, with a scatter of mu_s at which pushes may still differ."""
    return forget_answers(replace(at, scatter=np.maximum(at.scatter, _FIRST_SCATTER)))


def restore_scatter(task: EnsembleTask, at: Fits, guess: Fits) -> Fits:
    """The fits without answers; where the scatter is known it is again that of `guess`."""
    scatter = at.scatter if task.estimate_scatter else guess.scatter
    return forget_answers(replace(at, scatter=scatter))


def forget_answers(fits: Fits) -> Fits:
    """The fits without their answers."""
    return replace(fits, gram=None, residual=None, damping=None)


def _list_horizons(data: DiagnosisData) -> Iterator[NDArray]:
    """Yield the horizons (n,) of the pushes [s]: a little after the first contact, some later, and
    the release."""
    contact = find_contact_time(data.scales)
    for times in _HORIZONS:
        yield np.full(data.task.n, times * contact)
    yield _find_releases(data)


def list_joint_horizons(data: DiagnosisData) -> Iterator[NDArray]:
    """Yield the horizons (n,) of the pushes [s] where small effects are fitted: more of them, none
    beyond the release, and at last all samples."""
    released, contact = _find_releases(data), find_contact_time(data.scales)
    for times in (*_HORIZONS, *_MORE_HORIZONS):
        yield np.minimum(times * contact, released)
    yield released
    yield np.full(data.task.n, np.inf)


def _find_releases(data: DiagnosisData) -> NDArray:
    """When each push was released (n,) [s], infinite where it was not."""
    assert data.reduction is not None
    released = np.array([one.release_time for one in data.reduction.details])
    return np.where(np.isfinite(released), released, np.inf)


def cut_at(task: EnsembleTask, horizon: NDArray) -> EnsembleTask:
    """The task with the samples of each push up to its horizon (n,) [s] alone."""

    def cut(blocks: UnevenBlocks) -> UnevenBlocks:
        first, second = (np.take_along_axis(blocks.t, x, 1) for x in blocks[1:3])
        keep = 0.5 * (first + second) < horizon[:, None]
        doubt = None if blocks.doubt is None else np.where(keep[..., None], blocks.doubt, 0.0)
        a, b = (np.where(keep, x, 0.0) for x in (blocks.a, blocks.b))
        # What is left out is not read either.
        asked, also = (np.where(keep, x, 0) for x in blocks[1:3])
        return blocks._replace(first=asked, second=also, a=a, b=b, doubt=doubt)

    both = tuple(cut(blocks) for blocks in task.model.pushes.data)
    counts = np.stack([(blocks.a > 0).sum(axis=1) for blocks in both], axis=1).astype(float)
    until = horizon + _BEYOND
    model = replace(task.model, pushes=task.model.pushes._replace(data=both, until=until))
    return replace(task, model=model, counts=counts)
