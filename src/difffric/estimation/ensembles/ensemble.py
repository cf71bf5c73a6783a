"""Many fits of one data set at once: each has effects of its own, all share the compiled program.

A fit moves the plain parameters, a mu_s of each condition and of each push (which scatters about
it), and the numbers of its effects. `extended_model` answers with Gram matrices, so that everything
else is small linear algebra, done for all fits together. This module has the normal equations, the
scatter by restricted maximum likelihood, and the spreads that are not known; `ensemble_refits`
moves the fits. Axes: m fits, n pushes, K coordinates, D directions in which a fit moves, P
parameters of its normal equations (the conditions' mu_s and the other directions).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.estimation.extended_model import ExtendedModel

_SCATTERS = np.geomspace(1e-6, 0.3, 40)
"""Relative scatters of mu_s that are looked at, from none to more than a guide ever has."""
REJECTED = 1e12
"""The square of a residual where a push could not be followed: no fit goes there."""
_LEAST_DIAGONAL = 1e-9
"""A diagonal of the normal equations up to this says that nothing depends on the parameter."""
_RIDGE = 1e-13
"""What is added to a unit diagonal, so that singular equations have a solution."""


@dataclass(frozen=True)
class EnsembleTask:
    """What all fits of an ensemble have in common: the data, what is free, what noise there is."""

    model: ExtendedModel
    shared: tuple[int, ...]
    """coordinates free in every fit, mu_s not among them"""
    condition: NDArray
    """(n,) number of each push's condition"""
    mu_free: bool = True
    """whether mu_s is free; else it is what a gauge says of each push"""
    estimate_scatter: bool = True
    """whether mu_s scatters by as much as the data say, or by as much as the fits have"""
    open_spread: tuple[bool, bool] = (False, False)
    """whether the noise of force and of distance is to be estimated"""
    prior: Any = None
    """(K,) precision of coordinates whose smallness is assumed; None: nothing is"""
    prior_about: Any = None
    """(K,) where these coordinates would be without anything that moves them; None: at zero"""
    reach: Any = None
    """(K,) how far from there they may be; None: anywhere within their bounds"""
    counts: NDArray = field(default_factory=lambda: np.ones((1, 2)))
    """(n, 2) numbers (samples, or measurements) of each push and channel"""

    @property
    def n(self) -> int:
        """The number of pushes."""
        return len(self.condition)

    @property
    def price(self) -> float:
        """What one number must buy in -2 log likelihood (Schwarz's criterion)."""
        return float(np.log(max(self.counts.sum(), 2.0)))

    @property
    def conditions(self) -> int:
        """The number of conditions."""
        return int(self.condition.max()) + 1


@dataclass(frozen=True)
class Fits:
    """m fits where they stand."""

    extra: tuple[tuple[int, ...], ...]
    """entry j: the coordinates that are free in fit j alone"""
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
    """(m, n, 2, D + 1, D + 1) of the answers there; None: not asked for yet"""
    residual: Any = None
    """(m, n, 2, blocks) whitened; None likewise"""
    damping: Any = None
    """(m,) Levenberg and Marquardt's; None: as a search starts"""

    @property
    def m(self) -> int:
        """The number of fits."""
        return len(self.c)

    def pick(self, which: ArrayLike) -> Fits:
        """Some of the fits, by their numbers."""
        which = np.atleast_1d(np.asarray(which, int))

        def take(x: NDArray | None) -> NDArray | None:
            return None if x is None else x[which]

        arrays = {name: take(getattr(self, name)) for name in _ARRAYS}
        return replace(self, extra=tuple(self.extra[j] for j in which), **arrays)


_ARRAYS = ("c", "mu", "own", "scatter", "spread", "gram", "residual", "damping")
"""The fields of `Fits` that are arrays with a row a fit."""


def join(*parts: Fits) -> Fits:
    """Several ensembles of the same pushes as one, with their answers if all have them."""

    def concatenate(name: str) -> NDArray | None:
        columns = [getattr(p, name) for p in parts]
        if any(x is None for x in columns):
            return None
        if name == "gram":
            size = max(x.shape[-1] for x in columns)
            columns = [widen(x, size) for x in columns]
        return np.concatenate(columns)

    extra = tuple(own for p in parts for own in p.extra)
    return replace(parts[0], extra=extra, **{name: concatenate(name) for name in _ARRAYS})


def widen(gram: NDArray, size: int) -> NDArray:
    """Gram matrices (..., D + 1, D + 1) with empty columns before the residual's, up to `size`."""
    missing = size - gram.shape[-1]
    if not missing:
        return gram
    out = np.zeros((*gram.shape[:-2], size, size))
    keep = [*range(gram.shape[-1] - 1), size - 1]
    out[(..., *np.ix_(keep, keep))] = gram
    return out


def directions(task: EnsembleTask, fits: Fits) -> NDArray:
    """The directions (m, D, K) in which each fit moves: mu_s, the shared parameters, the fit's own
    coordinates; padded with zeros."""
    K, base = fits.c.shape[1], [0, *task.shared]
    D = len(base) + max((len(x) for x in fits.extra), default=0)
    out = np.zeros((fits.m, D, K))
    for j, extra in enumerate(fits.extra):
        for row, i in enumerate([*base, *extra]):
            out[j, row, i] = float(row > 0 or task.mu_free)
    return out


def evaluate(task: EnsembleTask, fits: Fits, pushes: NDArray | None = None) -> Fits:
    """The fits with the model's answers where they stand, for all pushes or for some; those for the
    others are then zero. A push that could not be followed answers with `REJECTED`."""
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
    gram[..., -1, -1] += np.where(bad, REJECTED, 0.0)[:, :, None]
    residual = found.residual.reshape(*shape, *found.residual.shape[1:])
    if len(which) < task.n:
        gram, residual = (_fill_pushes(x, which, task.n) for x in (gram, residual))
    return replace(fits, gram=gram, residual=residual)


def _fill_pushes(x: NDArray, which: NDArray, n: int) -> NDArray:
    """The array (m, some, ...) with its second axis as part of n pushes, zero elsewhere."""
    out = np.zeros((x.shape[0], n, *x.shape[2:]))
    out[:, which] = x
    return out


class PushParts(NamedTuple):
    """What each push adds to the normal equations of m fits."""

    H: NDArray
    """(m, n, P, P)"""
    h: NDArray
    """(m, n, P)"""
    z: NDArray
    """(m, n)"""
    g: NDArray
    """(m, n, P)"""
    gm: NDArray
    """(m, n)"""
    rr: NDArray
    """(m, n) sums of squares"""


@dataclass(frozen=True)
class NormalEquations:
    """The normal equations H x = -g of m fits, each push's own mu_s eliminated."""

    H: NDArray
    """(m, P, P)"""
    g: NDArray
    """(m, P)"""
    cost: NDArray
    """(m,) the sum of squares at the own mu_s that are best where the shared stand still"""
    z: NDArray
    """(m, n) information on each push's own log mu_s"""
    h: NDArray
    """(m, n, P) products of each push's own log mu_s with the parameters"""
    gm: NDArray
    """(m, n) slope of the sum of squares along each push's own log mu_s, but for its scatter"""


def split_by_push(task: EnsembleTask, fits: Fits) -> PushParts:
    """What each push adds to the normal equations, with its own mu_s taken to be zero."""
    G = np.einsum("mnkij,mk->mnij", fits.gram, 1.0 / fits.spread**2)
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
    return PushParts(H, h, z, g, gm, rr)


def normal_equations(
    task: EnsembleTask,
    fits: Fits,
    scatter: NDArray | None = None,
    parts: PushParts | None = None,
) -> NormalEquations:
    """The normal equations for a scatter (m,), by default the fits' own; `parts` are theirs of
    `split_by_push`, if they are known already."""
    H, h, z, g, gm, rr = split_by_push(task, fits) if parts is None else parts
    s = fits.scatter if scatter is None else scatter
    weight = 1.0 / (z + 1.0 / s[:, None] ** 2)
    precision, at = _make_prior(task, fits, H.shape[-1])
    assumed = precision[:, :, None] * np.eye(H.shape[-1])
    return NormalEquations(
        H=(H - np.einsum("mnp,mnq,mn->mnpq", h, h, weight)).sum(axis=1) + assumed,
        g=(g - h * (gm * weight)[:, :, None]).sum(axis=1) + precision * at,
        cost=(rr - gm**2 * weight).sum(axis=1) + (precision * at**2).sum(axis=1),
        z=z,
        h=h,
        gm=gm,
    )


def _make_prior(task: EnsembleTask, fits: Fits, P: int) -> tuple[NDArray, NDArray]:
    """The precision (m, P) of what is assumed to be small, and its values (m, P)."""
    precision, at = np.zeros((2, fits.m, P))
    if task.prior is not None:
        for j, extra in enumerate(fits.extra):
            mine = task.conditions + len(task.shared) + np.arange(len(extra))
            away = fits.c[j] if task.prior_about is None else fits.c[j] - task.prior_about
            precision[j, mine], at[j, mine] = task.prior[list(extra)], away[list(extra)]
    return precision, at


def _scale(H: NDArray) -> tuple[NDArray, NDArray]:
    """H (m, P, P) scaled to a unit diagonal, and the roots (m, P) of the diagonal that it was
    divided by. A parameter on which nothing depends stands apart from the others."""
    diagonal = np.einsum("mpp->mp", H)
    scale = np.sqrt(np.maximum(diagonal, _LEAST_DIAGONAL))
    there = diagonal > _LEAST_DIAGONAL
    A = H / (scale[:, :, None] * scale[:, None, :])
    unit = np.eye(H.shape[1])
    return np.where(there[:, :, None] & there[:, None, :], A, unit) + _RIDGE * unit, scale


def solve(H: NDArray, g: NDArray, damping: ArrayLike = 0.0) -> NDArray:
    """The steps (m, P) that solve the normal equations H (m, P, P), g (m, P) with Levenberg and
    Marquardt's damping (m,); a parameter on which nothing depends stays where it is."""
    A, scale = _scale(H)
    lam = np.broadcast_to(np.asarray(damping, float), (len(H),))
    A = A + lam[:, None, None] * np.eye(A.shape[1])
    there = np.einsum("mpp->mp", H) > _LEAST_DIAGONAL
    g = np.where(there, g, 0.0)
    return -np.linalg.solve(A, (g / scale)[:, :, None])[:, :, 0] / scale


def criterion(task: EnsembleTask, fits: Fits) -> NDArray:
    """-2 times the log likelihood (m,) where the fits stand, averaged over each push's own mu_s.

    It is the sum of squares, and what the scatter and the spreads that were estimated cost.
    """
    found = normal_equations(task, fits)
    return profile_cost(task, fits, found) + compute_volume(task, fits, found.z)


def profile_cost(task: EnsembleTask, fits: Fits, found: NormalEquations | None = None) -> NDArray:
    """The sum of squares (m,) with each push's own mu_s at its best, as a linear prediction has it:
    it is trusted for no more than a standard deviation."""
    found = normal_equations(task, fits) if found is None else found
    weight = found.z + 1.0 / fits.scatter[:, None] ** 2
    away = -found.gm / weight - fits.own
    return sum_squares(task, fits) - np.minimum(away**2 * weight, 1.0).sum(axis=1)


def compute_volume(task: EnsembleTask, fits: Fits, z: NDArray) -> NDArray:
    """The logarithmic part (m,) of -2 log likelihood: of the scatter and of estimated spreads."""
    spread = sum(
        2 * task.counts[:, k].sum() * np.log(fits.spread[:, k])
        for k in (0, 1)
        if task.open_spread[k]
    )
    return np.log1p(fits.scatter[:, None] ** 2 * z).sum(axis=1) + spread


def estimate_scatters(task: EnsembleTask, fits: Fits) -> Fits:
    """The fits with the scatter of mu_s at which the restricted likelihood is largest, and the
    spreads that the residuals show, where these are to be estimated.

    The scatter is looked for on a grid, for all fits together; `restricted_likelihood` does the
    same for one fit, to more digits.
    """
    for k in (0, 1):
        if task.open_spread[k]:
            rss = np.maximum(_sum_residuals(fits, k), 1e-300)
            # Each parameter takes its share of the residuals.
            lost = (fits.gram.shape[-1] - 1) * task.counts[:, k].sum() / task.counts.sum()
            freedom = np.maximum(task.counts[:, k].sum() - lost, 1.0)
            spread = fits.spread.copy()
            spread[:, k] = np.sqrt(rss / freedom)
            fits = replace(fits, spread=spread)
    if not (task.estimate_scatter and task.mu_free):
        return fits
    parts = split_by_push(task, fits)

    def cost(scatter: NDArray) -> NDArray:
        # Where the shared parameters stand: where a step would lead is not to be trusted yet.
        found = normal_equations(task, fits, scatter, parts)
        A, scale = _scale(found.H)
        volume = np.linalg.slogdet(A)[1] + 2 * np.log(scale).sum(1)
        return found.cost + np.log1p(scatter[:, None] ** 2 * found.z).sum(axis=1) + volume

    best, every = np.ones(fits.m), _SCATTERS
    for _ in range(3):  # over all, then between the best one's neighbours
        tried = np.array([cost(best * s) for s in every])
        best = best * every[np.argmin(tried, axis=0)]
        step = every[-1] / every[-2]
        every = np.geomspace(1 / step, step, 9)
    return replace(fits, scatter=best)


def _sum_residuals(fits: Fits, channel: int) -> NDArray:
    """The sum of squares (m,) of one channel over all pushes."""
    return fits.gram[:, :, channel, -1, -1].sum(axis=1)


def sum_squares(task: EnsembleTask, fits: Fits, some: NDArray | None = None) -> NDArray:
    """The penalised sum of squares (m,) of all pushes, or of some, with each push's own mu_s as it
    is."""
    some = np.arange(task.n) if some is None else some
    rss = np.einsum("mnk,mk->m", fits.gram[:, some][..., -1, -1], 1.0 / fits.spread**2)
    if task.prior is not None:
        away = fits.c if task.prior_about is None else fits.c - task.prior_about
        rss = rss + (task.prior * away**2).sum(axis=1)
    return rss + (fits.own[:, some] ** 2).sum(axis=1) / fits.scatter**2


def covariance(task: EnsembleTask, fits: Fits) -> NDArray:
    """The covariance (m, P, P) of the coordinates: the conditions' mu_s, the shared parameters and
    each fit's own. It is zero for what is at a bound, and the others' as if that were known."""
    H = normal_equations(task, fits).H
    held = _find_at_bound(task, fits, H.shape[1])
    held = held[:, :, None] | held[:, None, :]
    A, scale = _scale(np.where(held, 0.0, H))
    w, V = np.linalg.eigh(A)  # by rounding alone some may be negative: nothing is known along them
    V = V / scale[:, :, None]
    return np.where(held, 0.0, (V / np.maximum(w, _RIDGE)[:, None, :]) @ np.swapaxes(V, 1, 2))


def bounds(task: EnsembleTask, i: int) -> tuple[float, float]:
    """The values between which coordinate i may move."""
    low, high = task.model.coordinates.bounds(task.model.coordinates.names[i])
    if task.reach is None:
        return low, high
    about = 0.0 if task.prior_about is None else task.prior_about[i]
    return max(low, about - task.reach[i]), min(high, about + task.reach[i])


def _find_at_bound(task: EnsembleTask, fits: Fits, P: int) -> NDArray:
    """Whether each parameter (m, P) is at a bound."""
    out = np.zeros((fits.m, P), bool)
    for j, extra in enumerate(fits.extra):
        for k, i in enumerate([*task.shared, *extra]):
            low, high = bounds(task, i)
            out[j, task.conditions + k] = not low < fits.c[j, i] < high
    return out
