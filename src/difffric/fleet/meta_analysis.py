"""Many small studies of one thing: their evidence summed, their sizes pooled, the odd one found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

_ROUNDS = 60


@dataclass(frozen=True)
class Pooled:
    """A size that several studies share, by generalised least squares."""

    value: float
    standard_error: float
    """between the studies' own errors and how much they differ"""
    q: float
    """Cochran's: the squares about the mean that counts the studies' own errors only"""
    p_value: float
    """of so large a q where all have the same size"""
    between: float
    """standard deviation between the studies (Paule and Mandel); 0: their errors explain it"""
    n: int
    """studies"""


def pooled(values: ArrayLike, errors: ArrayLike) -> Pooled:
    """The mean of values (n,) with standard errors (n,), n >= 1, the spread between them
    estimated: where it is 0 the weights are 1 / error^2, and the standard error theirs."""
    x, s = np.asarray(values, float), np.asarray(errors, float)
    n = len(x)
    q = _squares(x, s, 0.0)
    variance = 0.0
    if n > 1 and q > n - 1:  # the squares fall with the variance between, and are to be n - 1
        low, high = 0.0, float(np.ptp(x) ** 2 + 1e-300)
        for _ in range(_ROUNDS):
            variance = 0.5 * (low + high)
            low, high = (variance, high) if _squares(x, s, variance) > n - 1 else (low, variance)
    weight = 1.0 / (s**2 + variance)
    p = float(scipy.stats.chi2.sf(q, n - 1)) if n > 1 else 1.0
    return Pooled(
        float(weight @ x / weight.sum()), float(weight.sum() ** -0.5), q, p,
        float(np.sqrt(variance)), n,
    )  # fmt: skip


def _squares(x: NDArray, s: NDArray, variance: float) -> float:
    weight = 1.0 / (s**2 + variance)
    return float(weight @ (x - weight @ x / weight.sum()) ** 2)


def left_out(values: ArrayLike, errors: ArrayLike) -> NDArray:
    """(n,) probability that a study is by chance as far from what the others foretell of it, two
    sides; 1 where fewer than two others are. What the others differ by counts: where they do, by an
    estimate, the test is Student's with a degree of freedom less than there are others."""
    x, s = np.asarray(values, float), np.asarray(errors, float)
    p = np.ones(len(x))
    if len(x) < 3:
        return p
    for i in range(len(x)):
        rest = pooled(np.delete(x, i), np.delete(s, i))
        size = np.sqrt(s[i] ** 2 + rest.between**2 + rest.standard_error**2)
        away = abs(x[i] - rest.value) / size
        p[i] = 2 * (
            scipy.stats.t.sf(away, rest.n - 1) if rest.between > 0 else scipy.stats.norm.sf(away)
        )
    return p


def holm(p: ArrayLike) -> NDArray:
    """(n,) p-values corrected for their number (Holm)."""
    p = np.asarray(p, float)
    order = np.argsort(p)
    raised = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    out = np.empty(len(p))
    out[order] = np.minimum(raised, 1.0)
    return out


def odd_ones(values: ArrayLike, errors: ArrayLike, level: float) -> dict[int, float]:
    """Studies that are off the others' size -> their corrected p-value, below `level`; the oddest
    is taken out first, as it would hide what is left."""
    x, s = np.asarray(values, float), np.asarray(errors, float)
    there, found = list(range(len(x))), {}
    while len(there) > 2:
        p = holm(left_out(x[there], s[there]))
        worst = int(np.argmin(p))
        if p[worst] >= level:
            break
        found[there.pop(worst)] = float(p[worst])
    return found


def summed(drops: ArrayLike, numbers: ArrayLike, at_least: int = 1) -> float:
    """Probability that chance gives as much evidence that `at_least` of n studies have an effect.

    drops: (n,) chi-square statistics, of `numbers` (n,) degrees of freedom each. For one study
    their sum is chi-square's; for more, the strongest but one less than `at_least` of them are left
    out (Benjamini and Heller's partial conjunction), so that a few cannot speak for all.
    """
    x, k = np.asarray(drops, float), np.asarray(numbers, float)
    if at_least > len(x):
        return 1.0
    order = np.argsort(-scipy.stats.chi2.logsf(x, k), kind="stable")  # the weakest first
    rest = order[: len(x) - at_least + 1]
    return float(scipy.stats.chi2.sf(x[rest].sum(), k[rest].sum()))


def sharing(drops: ArrayLike, numbers: ArrayLike, level: float) -> int:
    """How many studies have an effect at least, each claim below `level`."""
    found = 0
    for u in range(1, len(np.asarray(drops)) + 1):
        if summed(drops, numbers, u) >= level:
            break
        found = u
    return found


def of_probability(p: float, numbers: int) -> float:
    """The chi-square of so many degrees of freedom that chance exceeds with this probability."""
    return float(scipy.stats.chi2.isf(min(max(p, 1e-300), 1.0), numbers))
