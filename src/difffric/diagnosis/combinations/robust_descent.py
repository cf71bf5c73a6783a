"""Many models of one table, each taken to an optimum near it, in which outliers count for little.

A measurement far off adds the logarithm of its square (Cauchy's cost): while a cause is missing,
what it would explain does not bend what is there. Axes: m points, n pushes, K coordinates, D free
ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.extended_model import ExtendedModel

_SCALE = 2.5
"""Standard deviations from which a measurement begins to count for less."""
_FARTHEST = 0.7
"""No step moves a coordinate further: a factor of two, or as much of what is typical."""
_RIDGE = 1e-9
"""Added to a unit diagonal, so that equations that say nothing of a number have a solution."""
_ARRIVED = 3e-3
"""A step that gains no more is the last."""
_STUCK = 1e3
"""The damping at which a point that betters itself no more is given up: it stands at a jump."""


@dataclass(frozen=True)
class Points:
    """Where m models stand."""

    c: NDArray
    """(m, K) coordinates; that of mu_s is each push's own"""
    free: tuple[tuple[int, ...], ...]
    """entry j: the coordinates that are free in model j"""
    seen: NDArray | None = None
    """(m, n) whether a push counts; None: all do"""

    def pick(self, which: NDArray) -> Points:
        """Some of them, by their numbers."""
        seen = None if self.seen is None else self.seen[which]
        return Points(self.c[which], tuple(self.free[j] for j in which), seen)


@dataclass(frozen=True)
class KnownFriction:
    """A table whose mu_s a gauge knows, and the errors of its numbers."""

    model: ExtendedModel
    log_mu: NDArray
    """(n,)"""
    precision: NDArray
    """(K,) of what is known of coordinates beforehand: about 0, with a standard deviation of
    1 / sqrt(precision)"""

    def measure_costs(self, points: Points) -> NDArray:
        """(m,) what the points leave unexplained; no derivatives are asked for."""
        none = np.zeros((len(points.c), 0, points.c.shape[1]))
        return self._sum(points.c, self._answer(points, none))

    def measure_squares(self, points: Points) -> NDArray:
        """(m, n, 2) the squared errors of F_p and d in units of their standard errors."""
        none = np.zeros((len(points.c), 0, points.c.shape[1]))
        return self._answer(points, none)[..., 0, 0]

    def descend(self, points: Points, rounds: int) -> tuple[Points, NDArray]:
        """The points after so many Levenberg-Marquardt steps, and their costs (m,)."""
        lower, upper = self._find_limits()
        seeds = _seed(points)
        gram = self._answer(points, seeds)
        cost, damping = self._sum(points.c, gram), np.full(len(points.c), 1e-2)
        points, active = replace(points, c=points.c.copy()), np.ones(len(points.c), bool)
        for _ in range(rounds):
            which = np.flatnonzero(active)
            if not len(which):
                break
            at, G, own = points.pick(which), gram[which], seeds[which]
            known = np.einsum("mdk,k->md", own, self.precision)
            along = np.einsum("mdk,mk->md", own, at.c)
            step = np.einsum("md,mdk->mk", _solve(G, known, along, damping[which]), own)
            c = np.clip(at.c + np.clip(step, -_FARTHEST, _FARTHEST), lower, upper)
            new = self._answer(replace(at, c=c), own)
            found, before = self._sum(c, new), cost[which]
            better = found < before
            points.c[which] = np.where(better[:, None], c, at.c)
            gram[which] = np.where(better[:, None, None, None, None], new, G)
            cost[which] = np.where(better, found, before)
            by = np.where(better, 0.2, 6.0)
            damping[which] = np.clip(damping[which] * by, 1e-9, 1e6)
            active[which] = np.where(better, before - found > _ARRIVED, damping[which] < _STUCK)
        return points, cost

    def _sum(self, c: NDArray, gram: NDArray) -> NDArray:
        """(m,) Cauchy's cost of the residuals, and what is known of the coordinates c (m, K)."""
        squares = gram[..., -1, -1]
        far = _SCALE**2 * np.log1p(squares / _SCALE**2)
        return far.sum(axis=(1, 2)) + c**2 @ self.precision

    def _answer(self, points: Points, seeds: NDArray) -> NDArray:
        """(m, n, 2, D + 1, D + 1) Gram matrices of derivatives and residual."""
        m, n = len(points.c), len(self.log_mu)
        c = np.repeat(points.c[:, None], n, axis=1)
        c[:, :, 0] = self.log_mu
        index = np.tile(np.arange(n), m)
        found = self.model.answers(index, c.reshape(m * n, -1), np.repeat(seeds, n, axis=0))
        gram = found.gram.reshape(m, n, *found.gram.shape[1:])
        bad = ~np.isfinite(gram).all(axis=(-2, -1), keepdims=True)
        gram = np.where(bad, 0.0, gram)
        gram[..., -1, -1] += np.where(bad[..., 0, 0], 1e6, 0.0)
        return gram if points.seen is None else gram * points.seen[:, :, None, None, None]

    def leave_out_folds(self, point: Points, folds: NDArray, rounds: int) -> Points:
        """Where the one point leads without the pushes of each fold (n,), in their order."""
        names = np.unique(folds)
        c = np.repeat(point.c, len(names), axis=0)
        return self.descend(Points(c, point.free * len(names), folds != names[:, None]), rounds)[0]

    def predict_held_out(self, ends: Points) -> NDArray:
        """(n, 2) squared errors, in units of the standard errors, of each push where the point of
        `leave_out_folds` stands that has not seen it."""
        squares = self.measure_squares(replace(ends, seen=None))
        blind = np.argmin(np.asarray(ends.seen), axis=0)
        return squares[blind, np.arange(len(self.log_mu))]

    def _find_limits(self) -> tuple[NDArray, NDArray]:
        coordinates = self.model.coordinates
        bounds = np.array([coordinates.bounds(name) for name in coordinates.names])
        return bounds[:, 0], bounds[:, 1]


def _seed(points: Points) -> NDArray:
    """The directions (m, D, K) of the free coordinates, padded with zeros."""
    D = max(len(free) for free in points.free)
    seeds = np.zeros((len(points.c), D, points.c.shape[1]))
    for j, free in enumerate(points.free):
        seeds[j, np.arange(len(free)), free] = 1.0
    return seeds


def _solve(gram: NDArray, known: NDArray, at: NDArray, damping: NDArray) -> NDArray:
    """The damped steps (m, D) of the reweighted normal equations, with what is `known` (m, D) of
    the numbers, which are `at` (m, D)."""
    weight = 1.0 / (1.0 + gram[..., -1, -1] / _SCALE**2)
    total = np.einsum("mnkij,mnk->mij", gram, weight)
    H = total[:, :-1, :-1] + known[:, :, None] * np.eye(known.shape[1])
    g = total[:, :-1, -1] + known * at
    scale = np.sqrt(np.einsum("mdd->md", H))
    scale = np.where(scale > 0, scale, 1.0)
    A = H / (scale[:, :, None] * scale[:, None, :])
    A = A + (damping + _RIDGE)[:, None, None] * np.eye(A.shape[1])
    return -np.linalg.solve(A, (g / scale)[:, :, None])[:, :, 0] / scale
