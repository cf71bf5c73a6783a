"""Where else a settled fit of a table may be looked for: starts drawn from about its optimum.

d jumps and bends in the parameters, and its optima lie along the valley that trades stiffness for
damping. Points of that valley are ranked by a likelihood with each push's own mu_s integrated
out, which resolves more than the first search's, and those in other basins are worth settling.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.calibration.batched_answers import BATCH, compute_answers, weigh_residuals
from difffric.calibration.table_starts import gather_starts
from difffric.estimation.descent import Model, Settled
from difffric.estimation.mixed_fit import full_covariance
from difffric.estimation.stacked_data import FitData

_POOL = 4 * BATCH
"""Points that are drawn: whole batches, so that one compiled program serves."""
_FARTHEST = 20.0
"""Points lie at up to this many times what the covariance says."""
_LEAST = 1e-3
"""Standard deviation of a coordinate that is looked for at least."""
_APART = 3.0
"""Points less than this many standard deviations apart lie in one basin."""
_STEP = 2e-3
"""Of log mu_s, for its derivative by a difference: d bends over no shorter distance."""
_FLOOR = np.array([0.002, 0.01])
"""What the model may be off in F_p and d, as shares, at a point that is not an optimum."""
_SCATTERS = (0.0, 0.002, 0.005, 0.01, 0.02, 0.04)
"""Scatters of mu_s of which the best counts for a point: none, to twice that of usual rails."""
_NO_ANSWER = 1e6
"""The size of a residual where there is no answer."""
_TAIL = 1e-4
"""The share of the normal distribution that is cut off at either end."""
_COUNTED = 4
"""A push's chi-square counts in full up to about this size and by its logarithm beyond, so that
one push on the wrong side of a jump does not spoil a point."""


def find_other_basins(
    model: Model, data: FitData, at: Settled, box: list[NDArray], most: int
) -> list[NDArray]:
    """At most `most` points (free,) in other basins than `at` and each other, the best first."""
    layout = model.layout
    # By eigenvalues: one that nothing determines leaves no digits to the others.
    variance, axes = np.linalg.eigh(full_covariance(model, data, at))
    variance = np.maximum(variance, 0.0) + _LEAST**2
    size, steps = _draw_steps(layout.n_free)
    theta = at.theta + size * (steps * np.sqrt(variance)) @ axes.T
    theta = np.clip(theta, layout.lower, layout.upper)
    theta = np.concatenate([theta, gather_starts(model, data, box)])
    rank = _rank_points(model, data, at, theta)
    inverse = (axes / variance) @ axes.T
    chosen = [at.theta]
    for point in theta[np.argsort(rank, kind="stable")]:
        if all((point - x) @ inverse @ (point - x) > _APART**2 for x in chosen):
            chosen.append(point)
        if len(chosen) > most:
            break
    return chosen[1:]


def _draw_steps(free: int) -> tuple[NDArray, NDArray]:
    """Sizes (N, 1) from 1 to `_FARTHEST`, and standard normal steps (N, free), evenly spread."""
    u = scipy.stats.qmc.Sobol(free + 1, scramble=False).random_base2(int(np.log2(_POOL)))
    size = np.exp(np.log(_FARTHEST) * u[:, -1:])
    return size, scipy.special.ndtri(np.clip(u[:, :-1], _TAIL, 1 - _TAIL))


def _rank_points(model: Model, data: FitData, at: Settled, theta: NDArray) -> NDArray:
    """(N,) robust -2 log-likelihood at points (N, free), the best over some scatters."""
    seen = np.nan_to_num(np.abs(np.asarray(data.pushes.measured)[: data.n]))
    floor = _FLOOR[-seen.shape[1] :] * seen
    own = 1.0 / np.where(at.weights > 0, at.weights, 1.0)
    weights = np.where(at.weights > 0, 1.0 / np.hypot(own, floor), 0.0)

    def residuals_at(s_eta: NDArray) -> NDArray:
        r = weigh_residuals(data, weights, compute_answers(model, data, theta, s_eta))
        return np.clip(np.nan_to_num(r, nan=_NO_ANSWER), -_NO_ANSWER, _NO_ANSWER)

    zero = np.zeros((len(theta), data.n))
    r, beside = residuals_at(zero), residuals_at(zero + _STEP)
    J = (beside - r) / _STEP
    a, b, c = np.sum(J**2, axis=2), np.sum(J * r, axis=2), np.sum(r**2, axis=2)
    costs = []
    for s in _SCATTERS if model.estimate_scatter else (model.scatter,):
        q = np.maximum(c - s**2 * b**2 / (1 + s**2 * a), 0.0)
        costs.append(np.sum(_COUNTED * np.log1p(q / _COUNTED) + np.log1p(s**2 * a), axis=1))
    return np.min(costs, axis=0)
