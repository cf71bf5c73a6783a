"""What fits to the other pushes make of each push: held-out predictions. Axes as in `ensemble`."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.ensembles import ensemble as en
from difffric.estimation.ensembles import ensemble_refits as refits
from difffric.estimation.ensembles import friction_scan
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits

_ASTRAY = 3.0
"""Times what a push's squares are where it is fitted, or would be: a prediction beyond is no mere
lack of data."""
_ANEW = 5
"""Rounds of a fit that is made anew for a push that is held out."""
_ENOUGH = 1.0
"""What such a fit may leave to gain in chi-square: it changes what is astray by no more."""
_JUMP = 3.0
"""Standard deviations of chi-square beyond the fit's, from which a prediction may be on another
branch of its own mu_s."""
_FEW = 0.25
"""Share of the pushes up to which those that are predicted so badly may be beside a jump, however
well each tells its own mu_s: more of them tell of a poor fit."""
_BESIDE = np.linspace(-0.015, 0.015, 13)
"""The own log mu_s that are tried in such a push, beside where it is fitted."""


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
    limits, now = refits.find_limits(task, fits), refits.gather_point(task, fits)
    c = np.repeat(fits.c[:, None], task.n, axis=1)
    mu = np.zeros((fits.m, task.n))
    noise = np.zeros((2, fits.m, task.n))
    for fold in np.unique(folds):
        out = folds == fold
        H, g = H_i[:, ~out].sum(axis=1), g_i[:, ~out].sum(axis=1)
        at = refits.place_at(task, fits, now + refits.solve_within(H, g, now, *limits))
        c[:, out], mu[:, out] = at.c[:, None], at.mu[:, task.condition[out]]
        noise[:, :, out] = _foresee_squares(task, H, H_i[:, out], np.flatnonzero(out))
    seen = np.einsum("mnk,mk->mn", fits.gram[..., -1, -1], 1.0 / fits.spread**2)
    found = _predict_on_branches(task, fits, seen, c, mu, noise)
    astray = found.squares > _ASTRAY * (seen + task.counts.sum(axis=1))
    for j, fold in {(j, folds[i]) for j, i in np.argwhere(astray)}:
        out = folds == fold
        at = replace(_forget_pushes(fits.pick([j]), out), damping=None)
        at = refits.refit(task, at, _ANEW, np.flatnonzero(~out), tol=_ENOUGH)
        c[j, out], mu[j, out] = at.c, at.mu[0, task.condition[out]]
    return _predict_on_branches(task, fits, seen, c, mu, noise) if astray.any() else found


def _forget_pushes(fits: Fits, out: NDArray) -> Fits:
    """The fits as they stand, without what the pushes `out` (n,) answer."""
    gram, residual = fits.gram.copy(), fits.residual.copy()
    gram[:, out] = residual[:, out] = 0.0
    return replace(fits, gram=gram, residual=residual)


def _predict_on_branches(
    task: EnsembleTask, fits: Fits, seen: NDArray, c: NDArray, mu: NDArray, noise: NDArray
) -> HeldOut:
    """What pushes say at coordinates c (m, n, K) and log mu_s mu (m, n), each on the better branch
    of its own mu_s; `seen` (m, n) are its squares where it is fitted."""
    start = _keep_friction(task, fits, mu)
    found = _predict(task, start, c, mu, noise)
    jumps = found.squares > seen + _JUMP * np.sqrt(2 * task.counts.sum(axis=1))
    branches = _choose_branches(task, start, jumps, c, mu)
    if branches is start:
        return found
    other = _predict(task, branches, c, mu, noise)
    return HeldOut(*np.minimum(found[:3], other[:3]), *noise)


def _keep_friction(task: EnsembleTask, fits: Fits, mu: NDArray) -> Fits:
    """The fits with each push's own mu_s what it was, where its condition's log mu_s is mu (m, n)
    without it: from there it is estimated anew."""
    return replace(fits, own=fits.own + fits.mu[:, task.condition] - mu)


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
    those pushes `asked` (m, n) that hardly tell it, or that are few."""
    error = friction_scan.compute_own_errors(fits)
    few = asked.mean(axis=1, keepdims=True) <= _FEW
    j, i = np.nonzero(asked & (few | (error > friction_scan.LOOSE)))
    if not task.mu_free or not len(j):
        return fits
    loose = (error > friction_scan.LOOSE)[j, i, None]
    beside = fits.own[j, i, None] + _BESIDE
    tried = np.where(loose, friction_scan.make_own_grid(fits, error)[j, i], beside)
    value = friction_scan.sum_squares_at(task, fits, j, i, c[j, i], mu[j, i], tried)
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
