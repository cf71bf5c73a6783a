"""Windows about an edge: in which of them a fall of each degree, and a level after it, will do.

The falls of all degrees share their columns, and all windows the running sums of their products.
Of a triangular factor the leading blocks belong to the lower degrees, so that two of them, with
and without the higher terms, say of every window and degree how adequate it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.measurements.noise import whiten_consecutive
from difffric.measurements.reduction.local_polynomials import (
    LocalFit,
    Stretch,
    find_significance,
    fit_rows,
    join_grams,
    powers,
    scale_gram,
    shorten,
    sizes,
)

DEGREES = ((1, 6), (2, 1 << 30), (3, 1 << 30))
"""Of the fall, and for how many points before the edge at most."""
_HIGHER = 2  # more powers that are tried for significance, and a slope after the edge
_FIRST = 3  # the first power's column: the level, a step and a slope after the edge come before
_Y = _FIRST + DEGREES[-1][0] + _HIGHER  # the measured values' column
_WITHOUT = np.array([0, 1, *range(_FIRST, _FIRST + DEGREES[-1][0]), _Y])
"""The columns without higher terms."""


class EdgeFit(NamedTuple):
    """A fall of some degree, a level after it, and a step between them, in the best window."""

    degree: int
    fit: LocalFit
    """its first coefficients are the level and the step"""


def average_powers(s: NDArray, block: float, degree: int) -> NDArray:
    """Powers 1 ... `degree` of min(s, 0), averaged over blocks about s (n,): (n, degree)."""
    if not block:
        return powers(degree, 1)(np.minimum(s, 0.0))
    # exactly: a mean across the edge is on neither side of it
    whole = powers(degree + 1, 2)
    means = whole(np.minimum(s + block / 2, 0)) - whole(np.minimum(s - block / 2, 0))
    return means / (block * np.arange(2, degree + 2))


def fit_falls(stretch: Stretch, edge: float, scale: float, certain: float) -> list[EdgeFit]:
    """For each degree the fit in the window, of all about the `edge` [s], in which the step has
    the least standard error among the adequate ones; the smallest where none is. None for degrees
    with too few points. `certain`: every window reaches back to there [s]."""
    i = int(np.searchsorted(stretch.t, edge))
    n = len(stretch.t) - i
    known = i - int(np.searchsorted(stretch.t, certain - 0.1 * stretch.dt))
    lefts = []
    for degree, most in DEGREES:
        if i < (degree + 2 if degree > 1 else 2):
            break
        short = min(max(degree + 2, known), i)  # up to where the force is seen for certain
        lefts.append(sizes(short, min(i, max(most, short))))
    if not lefts:
        return []
    left = sorted(set().union(*lefts))
    right = sorted(set(sizes(min(max(6, round(scale / stretch.dt)), n), n, 1.6)))
    raw, white = _make_rows(stretch, i, edge, scale)
    gram = join_grams(raw, white, i, left, right).reshape(-1, _Y + 1, _Y + 1)
    size = np.add.outer(left, right).ravel()
    degrees = np.arange(1, len(lefts) + 1)
    allowed = np.array([np.repeat([a in own for a in left], len(right)) for own in lefts])
    allowed &= size >= degrees[:, None] + 6
    passed, width = _judge(gram, size, degrees)
    passed[~allowed] = -1.0
    rank = np.where(passed > 0, width, size)
    rank[passed < passed.max(axis=1, keepdims=True)] = np.inf
    found = []
    for k, chosen in enumerate(rank.argmin(axis=1)):
        if passed[k, chosen] < 0:
            continue
        lo, hi = i - left[chosen // len(right)], i + right[chosen % len(right)]
        if passed[k, chosen]:
            shorter = shorten(lo, hi, i, lefts[k][0], right[0])
            lo, hi = shorter if shorter[1] - shorter[0] >= k + 7 else (lo, hi)
        rows = white[lo:hi, _ORDERS[k]]
        rows[0] = raw[lo, _ORDERS[k]]  # a series of its own
        found.append(EdgeFit(k + 1, fit_rows(rows, k + 3, lo, hi)))
    return found


_ORDERS = [
    np.array([0, 1, *range(_FIRST, _FIRST + g), 2, _FIRST + g, _FIRST + g + 1, _Y])
    for g, _ in DEGREES
]
"""The columns of a degree's fit: level, step, powers; slope after the edge, higher powers."""


def _make_rows(stretch: Stretch, i: int, edge: float, scale: float) -> tuple[NDArray, NDArray]:
    """The rows (n, columns) of all points, of unit variance and whitened (the same where the noise
    is white): the level, a step before the edge, a slope after it, powers before it, the values."""
    s = (stretch.t - edge) / scale
    raw = np.empty((len(s), _Y + 1))
    raw[:, 0] = 1.0
    raw[:, 1] = s < 0.0
    raw[:, 2] = np.maximum(s, 0.0)
    raw[:, _FIRST:_Y] = average_powers(s, stretch.block / scale, _Y - _FIRST)
    raw[:, _Y] = stretch.y - stretch.y[min(i, len(s) - 1)]
    white = whiten_consecutive(raw, stretch.noise)
    return (raw / stretch.noise.level, white) if stretch.noise.correlation else (white, white)


def _judge(gram: NDArray, size: NDArray, degrees: NDArray) -> tuple[NDArray, NDArray]:
    """(highest significance level at which the fit is adequate, standard error of the step), each
    (degrees, windows), from Gram matrices of the windows."""
    scaled, norms = scale_gram(gram)
    r = np.linalg.cholesky(scaled[:, _WITHOUT[:, None], _WITHOUT])
    plain = _sum_from_end(r[:, -1] * norms[:, -1:])[:, degrees + 2]
    unit = r[:, 1:-1, 1:-1]
    z = np.empty((unit.shape[1], len(gram)))  # the step's column of the inverse factor
    z[0] = 1.0 / unit[:, 0, 0]
    for k in range(1, len(z)):
        z[k] = (unit[:, k, :k] * z[:k].T).sum(axis=1) / -unit[:, k, k]
    width = np.sqrt(np.cumsum(np.square(z), axis=0))[degrees] / norms[:, 1]
    r = np.linalg.cholesky(scaled)
    rest = _sum_from_end(r[:, -1] * norms[:, -1:])[:, degrees + _FIRST + _HIGHER]
    free = size - degrees[:, None] - _FIRST - _HIGHER
    return find_significance((plain - rest).T, rest.T, _HIGHER + 1, free), width


def _sum_from_end(x: NDArray) -> NDArray:
    """Sums (n, k) of the squares of each entry of rows (n, k) and those after it."""
    return np.cumsum(np.square(x[:, ::-1]), axis=1)[:, ::-1]
