"""How likely a table's pushes are at given parameters, each push's own mu_s integrated out.

`restricted_likelihood.estimate_variances` integrates it out about the mode, with the model linear
there. But d jumps and bends where a regime ends, and a push may have several mu_s. Here the model's
(F_p, d) is linear between the points of a grid, and the integral is exact for that. Two optima of a
search are compared by it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.calibration.batched_answers import BATCH, compute_answers, weigh_residuals
from difffric.estimation.descent import Model, Settled
from difffric.estimation.stacked_data import FitData

_LEAST_SCATTER = 1e-6
"""A scatter of zero is taken as this small, as the grid has to have a width."""
_WIDE = 6.0
"""The grid reaches this many scatters to either side of the shared mu_s,"""
_FINE = 4.2
"""and is dense about each push's mode: sinh of up to this many of its standard deviations."""
_NOTHING = -1e6
"""Log of the density of what the model cannot give."""


def minus_2_log_likelihood(model: Model, data: FitData, at: Settled) -> float:
    """-2 log of the density of the measurements, and of the prior, at the shared parameters,
    scatter and spreads of `at`."""
    n, scatter = data.n, max(at.scatter, _LEAST_SCATTER)
    slope = (np.asarray(at.end.rows)[:n] * at.weights[..., None])[..., 0]
    own = 1.0 / np.sqrt(np.sum(slope**2, axis=1) + scatter**-2)
    half = BATCH // 2
    wide = np.tile(scatter * np.linspace(-_WIDE, _WIDE, half)[:, None], (1, n))
    near = at.s_eta + own * np.sinh(np.linspace(-_FINE, _FINE, half))[:, None]
    grid = np.sort(np.concatenate([wide, near]), axis=0)
    answers = compute_answers(model, data, np.tile(at.theta, (BATCH, 1)), grid)
    r = np.concatenate(
        [weigh_residuals(data, at.weights, answers), (grid / scatter)[..., None]], axis=2
    )
    away = (at.theta - model.layout.start) / model.layout.prior_sd
    return float(
        -2 * _log_integral(grid / scatter, r).sum()
        + 2 * data.counts @ np.log(at.spreads)
        + away @ away
    )


def _log_integral(grid: NDArray, r: NDArray) -> NDArray:
    """(n,) log of the integral of exp(-|r|^2 / 2) / sqrt(2 pi) over `grid` (points, n), where r
    (points, n, rows) is linear in between; nothing is added where it is no number."""
    a, step = r[:-1], r[1:] - r[:-1]
    width = grid[1:] - grid[:-1]
    bend = np.sqrt(np.maximum(np.sum(step**2, axis=2), 1e-24))
    low = np.sum(a * step, axis=2) / bend
    high = low + bend
    # The tail in which both ends are small in absolute size loses no digits.
    left, right = np.where(low > 0, -high, low), np.where(low > 0, -low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        tail = np.minimum(scipy.special.log_ndtr(left) - scipy.special.log_ndtr(right), -1e-16)
        inside = scipy.special.log_ndtr(right) + np.log(-np.expm1(tail))
        log = np.log(width / bend) + 0.5 * (low**2 - np.sum(a**2, axis=2)) + inside
    # (SciPy's annotation says that two numbers may come back; only one does.)
    total: Any = scipy.special.logsumexp(np.where(np.isfinite(log), log, -np.inf), axis=0)
    return np.maximum(total, _NOTHING)
