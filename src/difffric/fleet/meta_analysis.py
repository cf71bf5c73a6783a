"""Meta-analysis: many small studies of one thing, here one rig's diagnosis each.

Their evidence is summed (`sum_evidence`, `count_sharing`), the sizes that they found are pooled to
one (`pool`), and a study that does not fit the others is found (`find_odd_ones`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

_EXACT = {"xtol": 1e-300, "rtol": 4 * np.finfo(float).eps, "maxiter": 1000}
"""A root to the last digits, whatever its scale."""


@dataclass(frozen=True)
class Pooled:
    """A size that several studies share, by generalised least squares."""

    value: float
    standard_error: float
    """of `value`, by the studies' own errors and by how much they differ"""
    q: float
    """Cochran's Q: the sum of squares about the mean, each over its study's own variance"""
    p_value: float
    """the probability of a Q as large where all studies have the same size"""
    between: float
    """standard deviation between the studies (Paule and Mandel); 0: their errors explain it"""
    n: int
    """number of studies"""


def pool(values: ArrayLike, errors: ArrayLike) -> Pooled:
    """Estimate the size that n >= 1 studies share from their values (n,) and standard errors (n,).

    The variance between the studies is Paule and Mandel's (1982): the one with which the sum of
    squares about the weighted mean is n - 1. Where it is 0, the weights are 1 / error^2.
    """
    x, s = np.asarray(values, float), np.asarray(errors, float)
    n = len(x)
    q = _sum_squares(x, s, 0.0)
    variance = 0.0
    if n > 1 and q > n - 1:
        # By hand: statsmodels' combine_effects stops at 1e-5 of n - 1, says 0 where rounding lets
        # it pass the root, and does not say whether it converged.
        def excess(between: float) -> float:
            return _sum_squares(x, s, between) - (n - 1)

        highest = float(np.ptp(x) ** 2 + 1e-300)
        variance = float(scipy.optimize.brentq(excess, 0.0, highest, **_EXACT))
    weight = 1.0 / (s**2 + variance)
    return Pooled(
        value=float(weight @ x / weight.sum()),
        standard_error=float(weight.sum() ** -0.5),
        q=q,
        p_value=float(scipy.stats.chi2.sf(q, n - 1)) if n > 1 else 1.0,
        between=float(np.sqrt(variance)),
        n=n,
    )


def _sum_squares(x: NDArray, s: NDArray, variance: float) -> float:
    """The weighted sum of squares of values x (n,) with errors s (n,) about their mean, where the
    studies differ by so much."""
    weight = 1.0 / (s**2 + variance)
    return float(weight @ (x - weight @ x / weight.sum()) ** 2)


def compare_each_with_rest(values: ArrayLike, errors: ArrayLike) -> NDArray:
    """For each of n studies, the probability (n,) that it is by chance as far from what the others
    foretell of it; two-sided.

    What the others differ by counts. Where they do differ, that is an estimate, and the test is
    Student's with one degree of freedom less than there are others. Where fewer than two others
    are, the answer is 1.
    """
    x, s = np.asarray(values, float), np.asarray(errors, float)
    p = np.ones(len(x))
    if len(x) < 3:
        return p
    for i in range(len(x)):
        rest = pool(np.delete(x, i), np.delete(s, i))
        size = np.sqrt(s[i] ** 2 + rest.between**2 + rest.standard_error**2)
        away = abs(x[i] - rest.value) / size
        p[i] = 2 * (
            scipy.stats.t.sf(away, rest.n - 1) if rest.between > 0 else scipy.stats.norm.sf(away)
        )
    return p


def correct_by_holm(p: ArrayLike) -> NDArray:
    """Correct p-values (n,) for their number, by Holm's method.

    It is done by hand: statsmodels' multipletests gives the same bits and collects garbage at each
    call, which takes 0.2 s and more in a process that has compiled a few programs.
    """
    p = np.asarray(p, float)
    order = np.argsort(p)
    raised = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(raised, 1.0)
    return corrected


def find_odd_ones(values: ArrayLike, errors: ArrayLike, level: float) -> dict[int, float]:
    """Find the studies that do not have the others' size: their index -> p-value below `level`,
    corrected for the number of studies.

    The oddest is taken out first, and the rest are compared anew, as it would hide what is left.
    """
    x, s = np.asarray(values, float), np.asarray(errors, float)
    there, found = list(range(len(x))), {}
    while len(there) > 2:
        p = correct_by_holm(compare_each_with_rest(x[there], s[there]))
        worst = int(np.argmin(p))
        if p[worst] >= level:
            break
        found[there.pop(worst)] = float(p[worst])
    return found


def sum_evidence(drops: ArrayLike, numbers: ArrayLike, at_least: int = 1) -> float:
    """The probability that chance gives as much evidence that `at_least` of n studies have an
    effect.

    `drops` (n,) are chi-square statistics of `numbers` (n,) degrees of freedom each. For one study
    their sum is chi-square's; for more, the strongest but one less than `at_least` of them are left
    out (Benjamini and Heller's partial conjunction), so that a few cannot speak for all.
    """
    x, k = np.asarray(drops, float), np.asarray(numbers, float)
    if at_least > len(x):
        return 1.0
    order = np.argsort(-scipy.stats.chi2.logsf(x, k), kind="stable")  # the weakest first
    rest = order[: len(x) - at_least + 1]
    return float(scipy.stats.chi2.sf(x[rest].sum(), k[rest].sum()))


def count_sharing(drops: ArrayLike, numbers: ArrayLike, level: float) -> int:
    """How many studies have an effect at least, each such claim with a p-value below `level`.

    The arguments are those of `sum_evidence`.
    """
    found = 0
    for u in range(1, len(np.asarray(drops)) + 1):
        if sum_evidence(drops, numbers, u) >= level:
            break
        found = u
    return found


def to_chi_square(p: float, numbers: int) -> float:
    """The chi-square of so many degrees of freedom that chance exceeds with probability p."""
    return float(scipy.stats.chi2.isf(min(max(p, 1e-300), 1.0), numbers))
