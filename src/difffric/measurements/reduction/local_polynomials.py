"""Local polynomials: a value, a slope or an edge read off noisy samples without a model.

A wide window has little noise and much bias. Among all windows around a point, one-sided ones
included, the one with the least standard error is taken in which higher terms than those fitted
are not significant; the bias that this leaves is small beside the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.measurements.noise import Noise, make_whitening
from difffric.measurements.recordings import Channel

MOST = 400
"""Points that a stretch keeps: more are averaged in blocks."""
_PIECE = 1 << 20  # samples in memory at a time
_LEVELS = (0.3, 0.03, 0.001)  # p-values of the higher terms: strict first, as what passes is bias
_SHRINK = 0.7  # of the window found: it ends where the higher terms begin to show


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
"""s (n,) to the columns of a design (n, columns)"""
HigherTerms = Callable[[NDArray, tuple[float, float]], NDArray]
"""s (n,) and a window's ends to the columns (n, columns) of terms higher than those fitted"""


def powers(degree: int, start: int = 0) -> Columns:
    """The columns s^start ... s^degree."""

    def columns(s: NDArray) -> NDArray:
        out = np.ones((len(s), degree + 1))
        for n in range(1, degree + 1):
            np.multiply(out[:, n - 1], s, out=out[:, n])
        return out[:, start:]

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

    `extra(s, ends)` are the higher terms whose significance decides whether the fit is adequate;
    `ends` are the window's, in s.
    """
    s = (stretch.t[lo:hi] - centre) / scale
    columns = design(s)
    p = columns.shape[1]
    if extra is not None:
        columns = np.concatenate([columns, extra(s, (s[0], s[-1]))], axis=1)
    y = stretch.y[lo:hi]
    white = make_whitening(np.arange(lo, hi), stretch.noise)(
        np.concatenate([columns, y[:, None]], 1)
    )
    norms = np.sqrt(np.einsum("ij,ij->j", white[:, :-1], white[:, :-1]))
    norms[norms == 0] = 1.0
    r: NDArray = np.asarray(
        np.linalg.qr(np.concatenate([white[:, :-1] / norms, white[:, -1:]], 1), mode="r")
    )
    upper, rhs = r[:p, :p], r[:p, -1]
    firm = np.abs(np.diag(upper)).min(initial=np.inf) > 1e-9
    inverse = np.linalg.inv(upper) if firm else np.linalg.pinv(upper, rcond=1e-9)
    q = columns.shape[1]
    higher, rest = float(r[p:q, -1] @ r[p:q, -1]), float(r[q:, -1] @ r[q:, -1])
    chi2 = (higher + rest) / max(hi - lo - p, 1)
    passed = 1.0
    if extra is not None:
        passed = float(_significance(higher, rest, q - p, hi - lo - q))
    covariance = inverse @ inverse.T / np.outer(norms[:p], norms[:p])
    if not passed:
        covariance = covariance * max(1.0, chi2)
    return LocalFit(inverse @ rhs / norms[:p], covariance, chi2, lo, hi, passed)


def sizes(least: int, most: int, ratio: float = 1.45) -> list[int]:
    """A geometric series of window sizes from `least` to `most`, both included."""
    found, size = [], float(least)
    while size < most:
        found.append(round(size))
        size = max(size * ratio, size + 1)
    return [*found, most] if most >= 0 else []


def _significance(higher, rest, extra: int, free) -> NDArray:
    """The highest of `_LEVELS` at which the higher terms' chi-square `higher`, of `extra` degrees
    of freedom, and the remainder's `rest`, of `free`, are no surprise; 0 where there is none."""
    p_value = np.minimum(
        scipy.special.chdtrc(extra, higher), 30 * scipy.special.chdtrc(np.maximum(free, 1), rest)
    )
    return np.select([p_value > level for level in _LEVELS], _LEVELS, 0.0)


def _grams(stretch: Stretch, i: int, s: NDArray, columns, left, right, nested) -> NDArray:
    """Gram matrices (len(left), len(right), columns, columns) of the whitened columns of the
    windows i - a <= j < i + b: each is the sum of its two sides'. `nested`: the columns do not
    depend on the windows' ends.

    Not as good as a QR factorisation, but good enough to choose a window by.
    """
    correlated = bool(stretch.noise.correlation)
    y = stretch.y - stretch.y[min(i, len(s) - 1)]
    if nested and not correlated:
        part = slice(i - left[-1], i + right[-1])
        rows = np.concatenate([columns(s[part], (-np.inf, np.inf)), y[part, None]], axis=1)
        rows /= stretch.noise.level
        before, behind = (
            _sum_nested(rows[: left[-1]][::-1], left),
            _sum_nested(rows[left[-1] :], right),
        )
        return before[:, None] + behind

    def gram(lo, hi, ends, joined):
        """Of the rows lo <= j < hi; `joined` to the one before or on their own."""
        begin = lo - 1 if joined else lo
        rows = np.concatenate([columns(s[begin:hi], ends), y[begin:hi, None]], axis=1)
        if correlated:
            rows = make_whitening(np.arange(begin, hi), stretch.noise)(rows)[lo - begin :]
        return rows.T @ rows / (1.0 if correlated else stretch.noise.level**2)

    n = columns(s[:1], (0.0, 0.0)).shape[1] + 1
    out = np.zeros((len(left), len(right), n, n))
    for row, a in zip(out, left, strict=True):
        if a:
            row += gram(i - a, i, (s[i - a], np.inf), False)
    behind = np.array([a > 0 for a in left])
    for column, b in zip(np.moveaxis(out, 1, 0), right, strict=True):
        if not b:
            continue
        ends = (-np.inf, s[i + b - 1])
        if not correlated:
            column += gram(i, i + b, ends, False)
            continue
        for joined in {bool(x) for x in behind}:
            column[behind == joined] += gram(i, i + b, ends, joined)
    return out


def _sum_nested(rows: NDArray, sizes: NDArray) -> NDArray:
    """Gram matrices of the first so many rows, for rising sizes: each adds to the one before."""
    edges = [0, *sizes.tolist()]
    parts = [rows[lo:hi].T @ rows[lo:hi] for lo, hi in pairwise(edges)]
    return np.cumsum(parts, axis=0)


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
    if not (size >= least).any():
        return None

    def columns(s, ends):
        return np.concatenate([design(s), extra(s, ends)], axis=1)

    s = (stretch.t - centre) / scale
    gram = _grams(stretch, i, s, columns, before, behind, nested)[size >= least]
    p, q = design(s[:1]).shape[1], gram.shape[-1] - 1
    norms = np.sqrt(np.diagonal(gram, axis1=1, axis2=2))
    norms[norms == 0] = 1.0
    gram = gram / (norms[:, :, None] * norms[:, None, :]) + 1e-12 * np.eye(q + 1)
    r = np.linalg.cholesky(gram).swapaxes(1, 2)
    last = (r[:, :, -1] * norms[:, -1:]) ** 2
    n = size[size >= least]
    passed = _significance(last[:, p:q].sum(1), last[:, q], q - p, n - q)
    unit = np.broadcast_to(np.eye(p)[of], (len(r), p))[..., None]
    se = np.linalg.norm(np.linalg.solve(r[:, :p, :p].swapaxes(1, 2), unit)[..., 0], axis=1)
    rank = np.where(passed > 0, se / norms[:, of], n)
    chosen = int(np.lexsort((rank, -passed))[0])
    ends = np.broadcast_arrays(i - before[:, None], i + behind)
    lo, hi = (int(e[size >= least][chosen]) for e in ends)
    if passed[chosen]:
        short_lo = lo if lo in keep else i - max(round(_SHRINK * (i - lo)), int(before[0]))
        short_hi = hi if hi in keep else i + max(round(_SHRINK * (hi - i)), int(behind[0]))
        if short_hi - short_lo >= least:
            lo, hi = short_lo, short_hi
    return fit_window(stretch, lo, hi, centre, scale, design, extra)
