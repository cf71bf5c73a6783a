"""Local polynomials: a value, a slope or an edge read off noisy samples without a model.

A wide window has little noise and much bias. Among all windows around a point, one-sided ones
included, the one with the least standard error is taken in which higher terms than those fitted
are not significant; the bias that this leaves is small beside the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.measurements.noise import Noise, whiten_consecutive
from difffric.measurements.recordings import Channel

MOST = 400
"""Points that a stretch keeps: more are averaged in blocks."""
_PIECE = 1 << 20  # samples in memory at a time
_LEVELS = (0.3, 0.03, 0.001)  # p-values of the higher terms: strict first, as what passes is bias
_LIMITS = 512  # degrees of freedom that limits are computed for, if no more are asked for
_SHRINK = 0.7  # of the window found: it ends where the higher terms begin to show
_UPPER = np.triu(np.ones((16, 16)))  # more than any design has columns


class LocalEstimate(NamedTuple):
    """A value at a time, and the standard error of both."""

    value: float
    se: float
    time: float
    time_se: float = np.nan


@dataclass(frozen=True)
class Stretch:
    """Consecutive samples of a channel, or means of blocks of them."""

    t: NDArray
    """(n,) [s]"""
    y: NDArray
    """(n,)"""
    dt: float
    noise: Noise
    block: float = 0.0
    """what each point is the mean over [s]; 0: a sample"""

    @classmethod
    def of(
        cls, channel: Channel, t_0: float, t_1: float, noise: Noise, most: int = MOST
    ) -> Stretch:
        """The samples with t_0 <= t < t_1, at most `most` points; read in pieces."""
        start = channel.start
        lo, hi = (
            int(np.clip(np.ceil((t - start) / channel.dt - 1e-9), 0, channel.n)) for t in (t_0, t_1)
        )
        size = max(1, -(-(hi - lo) // max(most, 1)))
        n = max(hi - lo, 0) // size
        piece = max(1, _PIECE // size)
        y = np.empty(n)
        for i in range(0, n, piece):
            j = min(i + piece, n)
            y[i:j] = channel.read(lo + i * size, lo + j * size).reshape(-1, size).mean(1)
        t = start + channel.dt * (lo + (size - 1) / 2 + size * np.arange(n))
        if size == 1:
            return cls(t, y, channel.dt, noise)
        return cls(t, y, size * channel.dt, noise.average(size), size * channel.dt)

    def between(self, t_0: float, t_1: float) -> Stretch:
        """The points with t_0 <= t < t_1."""
        lo, hi = np.searchsorted(self.t, [t_0, t_1])
        return replace(self, t=self.t[lo:hi], y=self.y[lo:hi])


@dataclass(frozen=True)
class LocalFit:
    """Generalised least squares in one window."""

    coefficients: NDArray
    """(columns,)"""
    covariance: NDArray
    """(columns, columns)"""
    reduced_chi2: float
    lo: int
    hi: int
    """the window: points lo <= i < hi"""
    passed: float
    """how well it passes: the least significance level of `_LEVELS` that it holds at, or 0 where
    higher terms matter; the covariance is then scaled by chi-square"""

    def se(self, i: int = 0) -> float:
        """Standard error of coefficient i."""
        return float(np.sqrt(self.covariance[i, i]))


Columns = Callable[[NDArray], NDArray]
"""s (..., n) to the columns of a design (..., n, columns)"""
HigherTerms = Callable[..., NDArray]
"""s (..., n) and the first and last s of a window (..., 1) to the columns (..., n, columns) of
terms higher than those fitted"""


def powers(degree: int, start: int = 0) -> Columns:
    """The columns s^start ... s^degree."""

    def columns(s: NDArray) -> NDArray:
        out = np.ones((*s.shape, degree + 1))
        for n in range(1, degree + 1):
            np.multiply(out[..., n - 1], s, out=out[..., n])
        return out[..., start:]

    return columns


def fit_window(
    stretch: Stretch,
    lo: int,
    hi: int,
    centre: float,
    scale: float,
    design: Columns,
    extra: HigherTerms | None = None,
) -> LocalFit:
    """Fit the columns `design(s)` of s = (t - centre) / scale to points lo <= i < hi.

    `extra(s, first, last)` are the higher terms whose significance decides whether the fit is
    adequate, given the window's first and last s.
    """
    s = (stretch.t[lo:hi] - centre) / scale
    columns = [design(s)]
    p = columns[0].shape[1]
    if extra is not None:
        columns.append(extra(s, s[:1], s[-1:]))
    rows = np.concatenate([*columns, stretch.y[lo:hi, None]], axis=1)
    return fit_rows(whiten_consecutive(rows, stretch.noise), p, lo, hi)


def fit_rows(white: NDArray, p: int, lo: int, hi: int) -> LocalFit:
    """Fit the first `p` columns of whitened rows (n, columns + 1) to the last one; the columns
    between are higher terms. The rows are those of the points lo <= i < hi."""
    q = white.shape[1] - 1
    norms = np.sqrt(np.einsum("ij,ij->j", white, white))
    norms[norms == 0] = 1.0
    norms[q] = 1.0
    r: NDArray = scipy.linalg.lapack.dgeqrf(white / norms)[0]
    last = r[: q + 1, q]  # what is beyond the matrix' end is zero
    upper = r[:p, :p] * _UPPER[: len(r[:p]), :p]
    if len(r) >= p and np.abs(upper.diagonal()).min(initial=np.inf) > 1e-9:
        inverse = scipy.linalg.lapack.dtrtri(upper)[0]
    else:
        inverse = np.linalg.pinv(upper, rcond=1e-9)
    higher, rest = float(last[p:q] @ last[p:q]), float(last[q:] @ last[q:])
    chi2 = (higher + rest) / max(hi - lo - p, 1)
    passed = _find_significance_once(higher, rest, q - p, hi - lo - q) if q > p else 1.0
    inverse /= norms[:p, None]
    covariance = inverse @ inverse.T
    if not passed:
        covariance *= max(1.0, chi2)
    return LocalFit(inverse @ last[:p], covariance, chi2, lo, hi, passed)


def sizes(least: int, most: int, ratio: float = 1.45) -> list[int]:
    """A geometric series of window sizes from `least` to `most`, both included."""
    found, size = [], float(least)
    while size < most:
        found.append(round(size))
        size = max(size * ratio, size + 1)
    return [*found, most] if most >= 0 else []


def find_significance(higher: NDArray, rest: NDArray, extra: int, free: NDArray) -> NDArray:
    """The highest of `_LEVELS` at which the higher terms' chi-square `higher`, of `extra` degrees
    of freedom, and the remainder's `rest`, of `free`, are no surprise; 0 where there is none. The
    remainder may have thirty times as small a p-value."""
    free = np.maximum(free, 1)
    of_higher, of_rest = _find_limits(1.0, 16), _find_limits(30.0, _reach(int(free.max())))
    passed = np.zeros(np.broadcast_shapes(higher.shape, free.shape))
    for k in range(len(_LEVELS) - 1, -1, -1):
        passed[(higher < of_higher[k, extra]) & (rest < of_rest[k].take(free))] = _LEVELS[k]
    return passed


def _find_significance_once(higher: float, rest: float, extra: int, free: int) -> float:
    """As `find_significance`, of numbers."""
    of_higher, of_rest = _find_limits(1.0, 16), _find_limits(30.0, _reach(free))
    for k, level in enumerate(_LEVELS):
        if higher < of_higher[k, extra] and rest < of_rest[k, max(free, 1)]:
            return level
    return 0.0


def _reach(free: int) -> int:
    """How many limits are computed where as many as `free` degrees of freedom are asked for."""
    return _LIMITS << max(free // _LIMITS, 0).bit_length()


@lru_cache
def _find_limits(weaker: float, n: int) -> NDArray:
    """Chi-squares (levels, n) of 0 ... n - 1 degrees of freedom whose p-values are `_LEVELS` over
    `weaker`: computed once, as comparing takes far less time than a p-value."""
    return scipy.special.chdtri(np.arange(n), np.array(_LEVELS)[:, None] / weaker)


def sum_nested(rows: NDArray, sizes: Sequence[int]) -> NDArray:
    """Gram matrices (len(sizes), columns, columns) of the first so many rows, for rising sizes:
    each adds to the one before."""
    edges = [0, *sizes]
    parts = [rows[lo:hi].T @ rows[lo:hi] for lo, hi in pairwise(edges)]
    return np.cumsum(parts, axis=0)


def join_grams(
    raw: NDArray, white: NDArray, i: int, left: Sequence[int], right: Sequence[int]
) -> NDArray:
    """Gram matrices (len(left), len(right), columns, columns) of the windows i - a <= j < i + b of
    `raw` rows, of unit variance, and of the same whitened, where all columns look the same from
    every window. A window begins a series of its own, with a row that is not whitened.

    Not as good as a QR factorisation, but good enough to choose a window by.
    """
    before = sum_nested(white[i - left[-1] : i][::-1], left)
    if white is not raw:
        start, some = i - np.array(left), np.array(left) > 0
        for rows, sign in ((raw, 1.0), (white, -1.0)):
            first = np.where(some[:, None], rows[np.minimum(start, len(rows) - 1)], 0.0)
            before = before + sign * first[:, :, None] * first[:, None, :]
    whole = before[:, None] + sum_nested(white[i : i + right[-1]], right)
    if white is not raw and left[0] == 0 and right[-1]:
        own = np.outer(raw[i], raw[i]) - np.outer(white[i], white[i])
        whole[0, np.array(right) > 0] += own
    return whole


def _grams(stretch: Stretch, i: int, s: NDArray, columns, left, right) -> NDArray:
    """As `join_grams`, of columns that look at the windows' ends: each is the sum of its two
    sides'."""
    noise, y = stretch.noise, stretch.y - stretch.y[min(i, len(s) - 1)]

    def white(lo, hi, starts, stops):
        """Rows lo <= j < hi of windows with such ends (k,), whitened: (k, hi - lo, columns)."""
        t = np.broadcast_to(s[lo:hi], (len(starts), hi - lo))
        some = columns(t, starts[:, None], stops[:, None])
        rows = np.concatenate([some, np.broadcast_to(y[lo:hi, None], (*t.shape, 1))], axis=2)
        return rows

    def gram(rows):
        return rows.swapaxes(1, 2) @ rows

    out = np.zeros((len(left), len(right), 1, 1))
    far = np.full(1, np.inf)
    if left[-1]:
        rows = white(i - left[-1], i, s[i - left], np.repeat(far, len(left)))
        begin = left[-1] - left
        inside = np.arange(left[-1]) >= begin[:, None]
        rows = whiten_consecutive((rows * inside[..., None]).swapaxes(0, 1), noise).swapaxes(0, 1)
        if noise.correlation:
            some = np.flatnonzero(begin)  # the first one of all begins a series as it is
            some = some[left[some] > 0]
            rows[some, begin[some]] *= np.sqrt(1 - noise.correlation**2)
        out = out + gram(rows)[:, None]
    if right[-1]:
        inside = np.arange(right[-1]) < right[:, None]
        stops = s[np.maximum(i + right - 1, 0)]
        behind = []
        for joined in (0, 1) if noise.correlation and i else (0,):
            rows = white(i - joined, i + right[-1], np.repeat(-far, len(right)), stops)
            rows = whiten_consecutive(rows.swapaxes(0, 1), noise).swapaxes(0, 1)[:, joined:]
            behind.append(gram(rows * inside[..., None]))
        out = out + np.array([behind[-1 if a else 0] for a in left])
    return out


def best_window(
    stretch: Stretch,
    centre: float,
    scale: float,
    design: Columns,
    extra: HigherTerms,
    *,
    left: Iterable[int],
    right: Iterable[int],
    least: int,
    of: int = 0,
    keep: Collection[int] = (),
    nested: bool = False,
) -> LocalFit | None:
    """The fit whose coefficient `of` has the least standard error among the adequate ones.

    `left`, `right`: the numbers of points to try on either side of `centre`; `least` points in
    all. The smallest window where none is adequate; None where there are too few points.
    `keep`: ends of the stretch (0, its length) at which the window must stay if it reaches them.
    `nested`: `extra` does not look at the window's ends, which takes less time.
    """
    i = int(np.searchsorted(stretch.t, centre))
    before, behind = (np.array(sorted(set(n))) for n in (left, right))
    size = before[:, None] + behind
    enough = size >= least
    if not enough.any():
        return None

    def columns(s, first, last):
        return np.concatenate([design(s), extra(s, first, last)], axis=-1)

    s = (stretch.t - centre) / scale
    p = design(s[:1]).shape[1]
    if nested:
        y = stretch.y - stretch.y[min(i, len(s) - 1)]
        raw = np.concatenate([columns(s, -np.inf, np.inf), y[:, None]], axis=1)
        white = whiten_consecutive(raw, stretch.noise)
        raw = raw / stretch.noise.level if stretch.noise.correlation else white
        gram = join_grams(raw, white, i, before.tolist(), behind.tolist())[enough]
    else:
        gram = _grams(stretch, i, s, columns, before, behind)[enough]
    scaled, norms = scale_gram(gram)
    r = np.linalg.cholesky(scaled)
    q = gram.shape[-1] - 1
    last = (r[:, -1] * norms[:, -1:]) ** 2
    n = size[enough]
    passed = find_significance(last[:, p:q].sum(1), last[:, q], q - p, n - q)
    unit = np.zeros((p, 1))
    unit[of] = 1.0
    se = np.sqrt(np.square(np.linalg.solve(r[:, :p, :p], unit)).sum(axis=(1, 2)))
    rank = np.where(passed > 0, se / norms[:, of], n)
    chosen = int(np.where(passed == passed.max(), rank, np.inf).argmin())
    row, column = (int(k[chosen]) for k in np.nonzero(enough))
    lo, hi = i - int(before[row]), i + int(behind[column])
    if passed[chosen]:
        short_lo, short_hi = shorten(lo, hi, i, int(before[0]), int(behind[0]))
        short_lo, short_hi = lo if lo in keep else short_lo, hi if hi in keep else short_hi
        if short_hi - short_lo >= least:
            lo, hi = short_lo, short_hi
    return fit_window(stretch, lo, hi, centre, scale, design, extra)


def scale_gram(gram: NDArray) -> tuple[NDArray, NDArray]:
    """(Gram matrices (n, k, k) of columns scaled to length one, with a little on their diagonals so
    that they have Cholesky factors; those lengths (n, k))."""
    n, k, _ = gram.shape
    norms = np.sqrt(gram.reshape(n, -1)[:, :: k + 1])
    norms[norms == 0] = 1.0
    scaled = gram / (norms[:, :, None] * norms[:, None, :])
    scaled.reshape(n, -1)[:, :: k + 1] += 1e-12
    return scaled, norms


def shorten(lo: int, hi: int, i: int, left: int, right: int) -> tuple[int, int]:
    """A window about point i that ends before the higher terms begin to show, but has `left`
    points and `right` ones."""
    return i - max(round(_SHRINK * (i - lo)), left), i + max(round(_SHRINK * (hi - i)), right)
