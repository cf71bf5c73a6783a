"""How well each time serves as the edge at which a falling polynomial meets the level after it."""

from __future__ import annotations

import math

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.measurements.noise import whiten_consecutive
from difffric.measurements.reduction.local_polynomials import LocalFit, Stretch, powers

_GRID = 31
"""Edges that the posterior is summed over at a time."""
_UNIT_GRID = np.linspace(0.0, 1.0, _GRID)
_UPPER = np.triu(np.ones((8, 8)))  # more than a fall has coefficients
_ALIKE = 1e-3
"""A difference of chi-square that says nothing: more than rounding makes."""


class EdgeProfile:
    """Chi-square over the edge, of points lo <= i < hi of a stretch; no edge is after `latest`.

    Points before any edge in question know nothing of where it is: they go into running sums of
    products, in a basis in which all of them together are uncorrelated. So do those after it. What
    is left of each edge are a few rows: the point whose block it lies in, the next one, which the
    noise's correlation ties to it, and all others together. The polynomial is solved for, for all
    edges at once.
    """

    def __init__(
        self, stretch: Stretch, lo: int, hi: int, degree: int, latest: float, scale: float
    ):
        noise, n = stretch.noise, hi - lo
        self._degree, self._scale, self._origin = degree, scale, latest
        self._block, self._phi = stretch.block / scale, noise.correlation
        self._unit = 1.0 / (noise.level * math.sqrt(1 - self._phi**2))
        # where each point's block ends, from the origin on
        self._ends = (stretch.t[lo:hi] - latest) / scale + self._block / 2
        self._y = y = stretch.y[lo:hi] - stretch.y[max(hi - 16, lo) : hi].mean()
        # sums over the points from the i-th on, of those that all are after the edge
        w = y * self._unit
        if self._phi:
            w[1:] -= self._phi * w[:-1]
        self._after = np.zeros((2, n + 3))
        np.cumsum([w[::-1], np.square(w[::-1])], axis=1, out=self._after[:, n - 1 :: -1])
        n_before = int(np.searchsorted(self._ends, 0.0))
        ends = self._ends[:n_before]
        raw = np.empty((n_before, degree + 2))
        raw[:, :-1] = self._average(ends - self._block, ends)
        raw[:, -1] = y[:n_before]
        rows = whiten_consecutive(raw, noise)
        self._basis, self._start = _orthogonalise(rows)
        rows = rows @ self._basis
        self._raw = raw[:, :-1] @ self._basis[:-1, :-1] if self._phi else rows
        self._before = np.zeros((n_before + 1, degree + 2, degree + 2))
        np.cumsum(rows[:, :, None] * rows[:, None, :], axis=0, out=self._before[1:])

    def _average(self, lower: NDArray, upper: NDArray) -> NDArray:
        """Powers 0 ... degree averaged over blocks; without blocks, at `upper`."""
        if not self._block:
            return powers(self._degree)(upper)
        whole = powers(self._degree + 1, 1)
        return (whole(upper) - whole(lower)) / (self._block * np.arange(1, self._degree + 2))

    def __call__(self, edges: NDArray) -> tuple[NDArray, NDArray]:
        """(chi-square, slope of the fall at the edge per scale) with each of the edges (k,) [s]."""
        e = (edges - self._origin) / self._scale
        j = self._ends.searchsorted(e)
        at = powers(self._degree)(e)
        slope = np.zeros_like(at)
        slope[:, 1:] = at[:, :-1] * np.arange(1, self._degree + 1)
        basis = self._basis[:-1, :-1]
        at, slope = at @ basis, slope @ basis
        if self._block or self._phi:
            rows, target, rest = self._tie(e, j, at)
        else:
            many = np.sqrt(len(self._ends) - j)
            rows = (many * self._unit)[:, None, None] * at[:, None, :]
            rest = self._after.take(j, axis=1)
            target = (rest[0] / np.maximum(many, 1.0))[:, None]
            rest = rest[1] - np.square(target[:, 0])
        target = target - rows @ self._start
        known, turned = self._before[j], rows.swapaxes(1, 2)
        matrix = known[:, :-1, :-1] + turned @ rows
        # An edge with few points before it leaves some of the powers open, whatever their size.
        ridge = 1e-14 * np.maximum(1.0, np.einsum("kii->k", matrix))
        matrix.reshape(len(e), -1)[:, :: self._degree + 2] += ridge[:, None]
        right = known[:, :-1, -1] + (turned @ target[..., None])[..., 0]
        found = np.linalg.solve(matrix, right[..., None])[..., 0]
        chi2 = known[:, -1, -1] + rest + np.square(target).sum(axis=1)
        chi2 -= np.einsum("ij,ij->i", right, found)
        return chi2, np.einsum("ij,ij->i", slope, found + self._start)

    def _tie(self, e: NDArray, j: NDArray, at: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """(rows (k, 3, degree + 1), measured values (k, 3), chi-square that none of them explains
        (k,)) of the points from the j-th on, for edges e whose powers in the basis are `at`: the
        j-th, the next one, and all others together."""
        n, phi, raw = len(self._ends), self._phi, self._raw[:, : self._degree + 1]
        split = at
        if self._block:
            upper = self._ends[np.minimum(j, n - 1)]
            split = self._average(np.minimum(upper - self._block, e), e)
            split = split @ self._basis[:-1, :-1]
            split += np.minimum((upper - e) / self._block, 1.0)[:, None] * at
        many = np.maximum(n - j - 2, 0)
        total, squares = self._after[:, j + 2]
        y = self._y.take(np.stack([j, j + 1]), mode="clip")
        rows = np.stack([split, at, (np.sqrt(many) * (1 - phi))[:, None] * at], axis=1)
        if phi:
            behind = np.maximum(j - 1, 0)
            y[1] -= phi * y[0]
            y[0] -= phi * self._y[behind] * (j > 0)
            rows[:, 0] -= phi * raw[behind] * (j > 0)[:, None]
            rows[:, 1] -= phi * split
        there = np.stack([j < n, j + 1 < n, many > 0])
        unit = np.full(j.shape, self._unit)
        unit[j == 0] *= math.sqrt(1 - phi**2)  # where the series begins
        rows *= there.T[..., None] * self._unit
        rows[:, 0] *= (unit / self._unit)[:, None]
        target = np.stack([y[0] * unit, y[1] * self._unit, total / np.sqrt(np.maximum(many, 1))])
        return rows, (target * there).T, squares - total**2 / np.maximum(many, 1)


def _orthogonalise(rows: NDArray) -> tuple[NDArray, NDArray]:
    """(basis (k, k) in which the columns (n, k) of the rows are about orthonormal, but for the last
    one: that is what the others, fitted to it, leave; the coefficients (k - 1,) of that fit)."""
    k = rows.shape[1] - 1
    gram = rows.T @ rows
    norms = np.sqrt(gram.diagonal())[:k]
    norms[norms == 0] = 1.0
    factor, bad = scipy.linalg.lapack.dpotrf(gram[:k, :k] / (norms[:, None] * norms))
    basis, start = np.eye(k + 1), np.zeros(k)
    if not bad and factor.diagonal().min() > 1e-6:
        basis[:k, :k] = scipy.linalg.lapack.dtrtri(factor)[0] * _UPPER[:k, :k] / norms[:, None]
        start = basis[:k, :k].T @ gram[:k, k]
        basis[:k, k] = -basis[:k, :k] @ start
    return basis, start


def find_edge_posterior(
    stretch: Stretch, fit: LocalFit, degree: int, within: tuple[float, float], scale: float
) -> tuple[float, float, float] | None:
    """Mean and standard deviation of the edge in the window of a fit, and the least chi-square;
    None: nothing falls there.

    The chi-square is not a parabola in the edge where it moves from sample to sample, least of
    all with correlated noise; the mean over it stays right. The prior is flat in the
    coefficients of the falling polynomial, and so goes with its slope at the edge.
    """
    t = stretch.t[fit.lo : fit.hi]
    lo, hi = max(within[0], t[min(degree, len(t)) - 1] + 0.05 * stretch.dt), min(within[1], t[-2])
    if not hi > lo:
        return None
    birge = max(1.0, fit.reduced_chi2) if not fit.passed else 1.0
    profile = EdgeProfile(stretch, fit.lo, fit.hi, degree, hi, scale)
    edge = spread = least = np.nan
    for _ in range(12):
        edges = lo + (hi - lo) * _UNIT_GRID
        chi2, slopes = profile(edges)
        falling = np.maximum(-slopes, 0.0)
        if not falling.any():
            return None
        least = float(chi2[falling > 0].min())
        excess = np.maximum(chi2 - least, 0.0) / birge
        weight = falling * np.exp(-0.5 * excess)
        weight /= weight.sum()
        edge, step = float(weight @ edges), edges[1] - edges[0]
        spread = float(np.sqrt(weight @ (edges - edge) ** 2))
        if spread > 1.5 * step or step < 1e-9 * scale:
            break
        reach = max(8 * spread, 3 * step)
        lo, hi = max(lo, edge - reach), min(hi, edge + reach)
    return edge, spread, least


def find_rough_edge(stretch: Stretch, scale: float, within: tuple[float, float]) -> float:
    """The edge `within` these times that a parabola and a level explain best."""
    n = len(stretch.t)
    if n < 8:
        return within[0]
    edges = np.linspace(*within, 32)
    chi2 = EdgeProfile(stretch, 0, n, 2, within[1], scale)(edges)[0]
    # Between two samples with few before them all edges fit alike: the first one is taken.
    return float(edges[int(np.argmax(chi2 <= chi2.min() + _ALIKE))])
