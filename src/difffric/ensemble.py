"""Many fits of one data set at once: each has effects of its own, all share the compiled program.

A fit moves the plain parameters, a mu_s of each condition and of each push (which scatters about
it), and the numbers of its effects. Its answers come as Gram matrices, so that everything else is
small linear algebra, done for all fits together: Levenberg-Marquardt steps, the scatter by
restricted maximum likelihood, spreads that are not known, and what a held-out push would say.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.extended_model import ExtendedModel

_SCATTERS = np.concatenate([[1e-6], np.geomspace(3e-4, 0.3, 24)])
"""Relative scatters of mu_s that are looked at."""
_REJECTED = 1e12
_LEAST_DIAGONAL = 1e-9


@dataclass(frozen=True)
class Task:
    """A data set, the parameters that are free in every fit, and what is known of the noise."""

    model: ExtendedModel
    shared: tuple[int, ...]
    """coordinates free in every fit, mu_s not among them"""
    condition: NDArray
    """(n,) number of each push's condition"""
    mu_free: bool = True
    """whether mu_s is free; else it is what a gauge says of each push"""
    estimate_scatter: bool = True
    open_spread: tuple[bool, bool] = (False, False)
    """whether the noise of force and of distance is to be estimated"""
    counts: NDArray = field(default_factory=lambda: np.ones((1, 2)))
    """(n, 2) numbers (samples, or measurements) of each push and channel"""

    @property
    def n(self) -> int:
        """Pushes."""
        return len(self.condition)

    @property
    def conditions(self) -> int:
        """How many there are."""
        return int(self.condition.max()) + 1


@dataclass(frozen=True)
class Fits:
    """m fits where they stand; `extra[j]` are the coordinates that are free in fit j alone."""

    extra: tuple[tuple[int, ...], ...]
    c: NDArray
    """(m, K) coordinates; that of mu_s is not used"""
    mu: NDArray
    """(m, conditions) log mu_s"""
    own: NDArray
    """(m, n) log mu_s of each push beyond its condition's"""
    scatter: NDArray
    """(m,)"""
    spread: NDArray
    """(m, 2) factor of the noise of each channel"""
    gram: Any = None
    """(m, n, 2, D + 1, D + 1) of the answers there"""
    model: Any = None
    """(m, n, 2)"""
    residual: Any = None
    damping: Any = None
    """(m,) Levenberg and Marquardt's"""

    @property
    def m(self) -> int:
        """How many fits."""
        return len(self.c)

    def pick(self, which) -> Fits:
        """Some of them."""
        which = np.atleast_1d(np.asarray(which, int))

        def of(x):
            return None if x is None else x[which]

        return Fits(
            tuple(self.extra[j] for j in which), self.c[which], self.mu[which], self.own[which],
            self.scatter[which], self.spread[which], of(self.gram), of(self.model),
            of(self.residual), of(self.damping),
        )  # fmt: skip


def together(*parts: Fits) -> Fits:
    """Several ensembles of the same pushes as one; their answers, if all have them."""

    def of(name) -> Any:
        columns = [getattr(p, name) for p in parts]
        if any(x is None for x in columns):
            return None
        if name == "gram":
            size = max(x.shape[-1] for x in columns)
            columns = [_widened(x, size) for x in columns]
        return np.concatenate(columns)

    names = ("c", "mu", "own", "scatter", "spread", "gram", "model", "residual", "damping")
    return Fits(sum((p.extra for p in parts), ()), *(of(name) for name in names))


def _widened(gram, size):
    """With empty columns before the residual's."""
    missing = size - gram.shape[-1]
    if not missing:
        return gram
    out = np.zeros((*gram.shape[:-2], size, size))
    keep = [*range(gram.shape[-1] - 1), size - 1]
    out[(..., *np.ix_(keep, keep))] = gram
    return out


def directions(task: Task, fits: Fits) -> NDArray:
    """(m, D, K): mu_s, the shared parameters, each fit's own; padded with nothing."""
    K, base = fits.c.shape[1], [0, *task.shared]
    D = len(base) + max((len(x) for x in fits.extra), default=0)
    out = np.zeros((fits.m, D, K))
    for j, extra in enumerate(fits.extra):
        for row, i in enumerate([*base, *extra]):
            out[j, row, i] = float(row > 0 or task.mu_free)
    return out


def evaluated(task: Task, fits: Fits, pushes: NDArray | None = None) -> Fits:
    """The fits with their answers where they stand, of all pushes or of some (the others' stay,
    or are nothing)."""
    which = np.arange(task.n) if pushes is None else np.asarray(pushes)
    c = np.repeat(fits.c[:, None], len(which), axis=1)
    c[:, :, 0] = fits.mu[:, task.condition[which]] + fits.own[:, which]
    rows = directions(task, fits)
    index = np.tile(which, fits.m)
    found = task.model.answers(
        index, c.reshape(-1, c.shape[2]), np.repeat(rows, len(which), axis=0)
    )
    shape = (fits.m, len(which))
    gram = found.gram.reshape(*shape, *found.gram.shape[1:])
    bad = ~np.isfinite(gram).all(axis=(2, 3, 4))
    gram = np.where(bad[:, :, None, None, None], 0.0, gram)
    gram[..., -1, -1] += np.where(bad, _REJECTED, 0.0)[:, :, None]
    model = found.model.reshape(*shape, 2)
    residual = found.residual.reshape(*shape, *found.residual.shape[1:])
    if len(which) < task.n:
        gram, model, residual = (_placed(x, which, task.n) for x in (gram, model, residual))
    return replace(fits, gram=gram, model=model, residual=residual)


def _placed(x, which, n):
    out = np.zeros((x.shape[0], n, *x.shape[2:]))
    out[:, which] = x
    return out


@dataclass(frozen=True)
class Normal:
    """The normal equations of m fits with each push's own mu_s eliminated."""

    H: NDArray
    """(m, P, P)"""
    g: NDArray
    """(m, P)"""
    cost: NDArray
    """(m,) the sum of squares at the own mu_s that are best where the shared stand still"""
    z: NDArray
    """(m, n) information on each push's own log mu_s"""
    h: NDArray
    """(m, n, P)"""
    gm: NDArray
    """(m, n)"""


def _parts(task: Task, fits: Fits, on=None):
    """Blocks by push at own mu_s = 0: (H_i, h_i, z_i, g_i, gm_i, rr_i)."""
    G = np.einsum("mnkij,mk->mnij", fits.gram, 1.0 / fits.spread**2)
    if on is not None:
        G = G * on[:, :, None, None]
    n, size = G.shape[1:3]
    D, C = size - 1, task.conditions
    P = C + D - 1
    S = np.zeros((n, D, P))
    S[np.arange(n), 0, task.condition] = 1.0
    S[:, np.arange(1, D), C + np.arange(D - 1)] = 1.0
    H = np.einsum("nap,mnab,nbq->mnpq", S, G[:, :, :D, :D], S, optimize=True)
    h = np.einsum("nap,mna->mnp", S, G[:, :, :D, 0])
    z = G[:, :, 0, 0]
    e = fits.own
    g = np.einsum("nap,mna->mnp", S, G[:, :, :D, -1]) - h * e[:, :, None]
    gm = G[:, :, 0, -1] - z * e
    rr = G[:, :, -1, -1] - 2 * e * G[:, :, 0, -1] + z * e**2
    return H, h, z, g, gm, rr


def normal(task: Task, fits: Fits, scatter=None, parts=None) -> Normal:
    """The normal equations for a scatter (m,)."""
    H, h, z, g, gm, rr = _parts(task, fits) if parts is None else parts
    s = fits.scatter if scatter is None else scatter
    weight = 1.0 / (z + 1.0 / s[:, None] ** 2)
    return Normal(
        H=(H - np.einsum("mnp,mnq,mn->mnpq", h, h, weight)).sum(axis=1),
        g=(g - h * (gm * weight)[:, :, None]).sum(axis=1),
        cost=(rr - gm**2 * weight).sum(axis=1),
        z=z,
        h=h,
        gm=gm,
    )


def solve(H: NDArray, g: NDArray, damping=0.0) -> NDArray:
    """(m, P) steps; a parameter that nothing depends on stays."""
    diagonal = np.einsum("mpp->mp", H)
    scale = np.sqrt(np.maximum(diagonal, _LEAST_DIAGONAL))
    A = H / (scale[:, :, None] * scale[:, None, :])
    P = A.shape[1]
    floor = np.where(diagonal > _LEAST_DIAGONAL, 1e-13, 1.0)
    lam = np.broadcast_to(np.asarray(damping, float), (len(H),))
    A = A + (floor + lam[:, None])[:, :, None] * np.eye(P)
    return -np.linalg.solve(A, (g / scale)[:, :, None])[:, :, 0] / scale


def criterion(task: Task, fits: Fits) -> NDArray:
    """(m,) -2 times the log likelihood where the fits stand, their own mu_s averaged over: sum of
    squares, and what the scatter and the spreads that were estimated cost."""
    return penalised(fits) + _volume(task, fits, normal(task, fits).z)


def _volume(task: Task, fits: Fits, z) -> NDArray:
    spread = sum(
        2 * task.counts[:, k].sum() * np.log(fits.spread[:, k])
        for k in (0, 1)
        if task.open_spread[k]
    )
    return np.log1p(fits.scatter[:, None] ** 2 * z).sum(axis=1) + spread


def rescattered(task: Task, fits: Fits) -> Fits:
    """The fits with the scatter that the restricted likelihood prefers, and the spreads that the
    residuals show, where these are to be estimated."""
    for k in (0, 1):
        if task.open_spread[k]:
            rss = np.maximum(_rss(task, fits, k), 1e-300)
            # Each parameter takes its share of the residuals.
            lost = (fits.gram.shape[-1] - 1) * task.counts[:, k].sum() / task.counts.sum()
            freedom = np.maximum(task.counts[:, k].sum() - lost, 1.0)
            spread = fits.spread.copy()
            spread[:, k] = np.sqrt(rss / freedom)
            fits = replace(fits, spread=spread)
    if not (task.estimate_scatter and task.mu_free):
        return fits
    parts = _parts(task, fits)
    values = []
    for s in _SCATTERS:
        found = normal(task, fits, np.full(fits.m, s), parts)
        step = solve(found.H, found.g)
        gain = np.einsum("mp,mp->m", step, found.g)
        diagonal = np.einsum("mpp->mp", found.H)
        scale = np.sqrt(np.maximum(diagonal, _LEAST_DIAGONAL))
        A = found.H / (scale[:, :, None] * scale[:, None, :])
        there = diagonal > _LEAST_DIAGONAL
        A = np.where(there[:, :, None] & there[:, None, :], A, np.eye(A.shape[1]))
        volume = np.linalg.slogdet(A + 1e-12 * np.eye(A.shape[1]))[1] + 2 * np.log(scale).sum(1)
        values.append(found.cost + gain + np.log1p(s**2 * found.z).sum(axis=1) + volume)
    return replace(fits, scatter=_SCATTERS[np.argmin(values, axis=0)])


def _rss(task: Task, fits: Fits, channel: int) -> NDArray:
    return fits.gram[:, :, channel, -1, -1].sum(axis=1)


def penalised(fits: Fits) -> NDArray:
    """(m,) the sum of squares with each push's own mu_s as it is."""
    rss = np.einsum("mnk,mk->m", fits.gram[..., -1, -1], 1.0 / fits.spread**2)
    return rss + (fits.own**2).sum(axis=1) / fits.scatter**2


def bounded(H, g, now, lower, upper, damping=0.0) -> NDArray:
    """(m, P) steps that end within bounds: what would cross one ends there, and the others make
    the best of it."""
    stopped = np.zeros(now.shape, bool)
    end = np.zeros(now.shape)
    for _ in range(5):
        pull = g + np.einsum("mpq,mq->mp", H, end)
        A = np.where(stopped[:, :, None] | stopped[:, None, :], 0.0, H)
        step = np.where(stopped, end, solve(A, np.where(stopped, 0.0, pull), damping))
        new = now + step
        crossed = ~stopped & ((new < lower) | (new > upper))
        if not crossed.any():
            break
        end = np.where(crossed, np.clip(new, lower, upper) - now, end)
        stopped |= crossed
    return np.clip(now + step, lower, upper) - now


def moved(task: Task, fits: Fits, damping) -> Fits:
    """The fits one damped Gauss-Newton step on, within the bounds; answers not yet there."""
    found = normal(task, fits)
    now = _point(task, fits)
    step = bounded(found.H, found.g, now, *_limits(task, fits), damping)
    new = now + step
    weight = 1.0 / (found.z + 1.0 / fits.scatter[:, None] ** 2)
    own = -(found.gm + np.einsum("mnp,mp->mn", found.h, step)) * weight
    return replace(_placed_at(task, fits, new), own=own, gram=None)


def _columns(task: Task, extra: tuple[int, ...]) -> list[int]:
    """Coordinates behind the columns after the conditions' mu_s."""
    return [*task.shared, *extra]


def _limits(task: Task, fits: Fits):
    coordinates, P = task.model.coordinates, _point(task, fits).shape[1]
    lower, upper = np.full((fits.m, P), -np.inf), np.full((fits.m, P), np.inf)
    for j, extra in enumerate(fits.extra):
        for k, i in enumerate(_columns(task, extra)):
            lower[j, task.conditions + k], upper[j, task.conditions + k] = coordinates.bounds(
                coordinates.names[i]
            )
    return lower, upper


def _point(task: Task, fits: Fits) -> NDArray:
    width = len(task.shared) + max((len(x) for x in fits.extra), default=0)
    if fits.gram is not None:
        width = max(width, fits.gram.shape[-1] - 2)
    out = np.zeros((fits.m, task.conditions + width))
    out[:, : task.conditions] = fits.mu
    for j, extra in enumerate(fits.extra):
        for k, i in enumerate(_columns(task, extra)):
            out[j, task.conditions + k] = fits.c[j, i]
    return out


def _placed_at(task: Task, fits: Fits, point: NDArray) -> Fits:
    c = fits.c.copy()
    for j, extra in enumerate(fits.extra):
        for k, i in enumerate(_columns(task, extra)):
            c[j, i] = point[j, task.conditions + k]
    return replace(fits, mu=point[:, : task.conditions].copy(), c=c)


def refitted(
    task: Task, fits: Fits, rounds: int, pushes: NDArray | None = None, tol: float = 0.02
) -> Fits:
    """The fits after at most `rounds` of Levenberg-Marquardt, those that have arrived resting.

    A fit has arrived where less than `tol` is left to gain in chi-square.
    """
    if fits.gram is None:
        fits = rescattered(task, evaluated(task, fits, pushes))
    damping = fits.damping if fits.damping is not None else np.full(fits.m, 1e-3)
    active = np.ones(fits.m, bool)
    for _ in range(rounds):
        which = np.flatnonzero(active)
        if not len(which):
            break
        at = fits.pick(which)
        trial = evaluated(task, moved(task, at, damping[which]), pushes)
        before, after = penalised(at), penalised(trial)
        better = after < before
        gain = before - after
        damping[which] = np.where(better, np.maximum(damping[which] / 8, 1e-9), damping[which] * 8)
        done = (better & (gain < tol)) | (damping[which] > 1e6)
        if better.any():
            good = rescattered(task, trial.pick(np.flatnonzero(better)))
            fits = _replaced(fits, which[better], good)
        active[which[done]] = False
    return replace(fits, damping=damping)


def _replaced(fits: Fits, which, new: Fits) -> Fits:
    def put(old, values):
        if old is None or values is None:
            return old
        out = old.copy()
        if out.ndim > 3 and out.shape[-1] != values.shape[-1] and out.shape[-2] == out.shape[-1]:
            values = _widened(values, out.shape[-1])
        out[which] = values
        return out

    names = ("c", "mu", "own", "scatter", "spread", "gram", "model", "residual")
    return replace(fits, **{x: put(getattr(fits, x), getattr(new, x)) for x in names})


def covariance(task: Task, fits: Fits) -> NDArray:
    """(m, P, P) of mu_s, the shared parameters and each fit's own, as coordinates."""
    H = normal(task, fits).H
    diagonal = np.einsum("mpp->mp", H)
    scale = np.sqrt(np.maximum(diagonal, _LEAST_DIAGONAL))
    A = H / (scale[:, :, None] * scale[:, None, :])
    there = diagonal > _LEAST_DIAGONAL
    A = np.where(there[:, :, None] & there[:, None, :], A, np.eye(A.shape[1]))
    inverse = np.linalg.inv(A + 1e-13 * np.eye(A.shape[1]))
    return inverse / (scale[:, :, None] * scale[:, None, :])


def held_out(task: Task, fits: Fits, folds: NDArray) -> NDArray:
    """(m, n) sum of squares of each push as predicted by a fit to the other folds, its own mu_s
    alone re-estimated. `folds` (n,) numbers each push's fold.

    The parameters without a fold are one Gauss-Newton step from the fit to everything; the push
    is then followed with them, exactly.
    """
    parts = _parts(task, fits)
    H_i, h, z, g_i, gm, _ = parts
    weight = 1.0 / (z + 1.0 / fits.scatter[:, None] ** 2)
    H_i = H_i - np.einsum("mnp,mnq,mn->mnpq", h, h, weight)
    g_i = g_i - h * (gm * weight)[:, :, None]
    limits, now = _limits(task, fits), _point(task, fits)
    c = np.repeat(fits.c[:, None], task.n, axis=1)
    mu = np.zeros((fits.m, task.n))
    for fold in np.unique(folds):
        inside = folds != fold
        H, g = H_i[:, inside].sum(axis=1), g_i[:, inside].sum(axis=1)
        at = _placed_at(task, fits, now + bounded(H, g, now, *limits))
        for i in np.flatnonzero(~inside):
            c[:, i] = at.c
            mu[:, i] = at.mu[:, task.condition[i]]
    own = fits.own
    total = np.full((fits.m, task.n), np.inf)
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
        value = np.where(np.isfinite(value), value, _REJECTED)
        total = np.minimum(total, value)
        own = own + np.where(np.isfinite(step), step, 0.0)
    return total
