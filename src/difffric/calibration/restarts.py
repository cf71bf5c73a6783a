"""Where else a settled fit of a table may be looked for: starts drawn from about its optimum.

d jumps and bends in the parameters, and its optima lie along the valley that trades stiffness for
damping. Points of that valley are ranked by a likelihood with each push's own mu_s integrated
out, which resolves more than the first search's, and those in other basins are worth settling.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.calibration.table_starts import BATCH, answers, pool, residuals
from difffric.estimation.mixed_fit import Model, Settled, full_covariance
from difffric.estimation.stacked_data import FitData

_POOL = 4 * BATCH
_FARTHEST = 20.0
"""Points lie at up to this many times what the covariance says."""
_LEAST = 1e-3
"""Standard deviation of a coordinate that is looked for at least."""
_APART = 3.0
"""Points less than this many standard deviations apart lie in one basin."""
_STEP = 2e-3
"""Of log mu_s, for its derivative."""
_FLOOR = np.array([0.002, 0.01])
"""What the model may be off in F_p and d, as shares, at a point that is not an optimum."""
_SCATTERS = (0.0, 0.002, 0.005, 0.01, 0.02, 0.04)


def starts_elsewhere(
    model: Model, data: FitData, at: Settled, box: list[NDArray], most: int
) -> list[NDArray]:
    """At most `most` points (P,) in other basins than `at` and each other, the best first."""
    layout = model.layout
    # By eigenvalues: one that nothing determines leaves no digits to the others.
    variance, axes = np.linalg.eigh(full_covariance(model, data, at))
    variance = np.maximum(variance, 0.0) + _LEAST**2
    u = scipy.stats.qmc.Sobol(layout.n_free + 1, scramble=False).random_base2(int(np.log2(_POOL)))
    size = np.exp(np.log(_FARTHEST) * u[:, -1:])
    normal = scipy.special.ndtri(np.clip(u[:, :-1], 1e-4, 1 - 1e-4))
    theta = at.theta + size * (normal * np.sqrt(variance)) @ axes.T
    theta = np.clip(theta, layout.lower, layout.upper)
    theta = np.concatenate([theta, pool(model, data, box)])
    rank = _rank(model, data, at, theta)
    inverse = (axes / variance) @ axes.T
    chosen = [at.theta]
    for point in theta[np.argsort(rank, kind="stable")]:
        if all((point - x) @ inverse @ (point - x) > _APART**2 for x in chosen):
            chosen.append(point)
        if len(chosen) > most:
            break
    return chosen[1:]


_HUGE = 1e6
"""A residual where there is no answer."""


def _rank(model: Model, data: FitData, at: Settled, theta: NDArray) -> NDArray:
    """(N,) robust -2 log-likelihood at points (N, P), the best over some scatters."""
    seen = np.nan_to_num(np.abs(np.asarray(data.pushes.measured)[: data.n]))
    floor = _FLOOR[-seen.shape[1] :] * seen
    own = 1.0 / np.where(at.weights > 0, at.weights, 1.0)
    weights = np.where(at.weights > 0, 1.0 / np.hypot(own, floor), 0.0)
    zero = np.zeros((len(theta), data.n))
    r, beside = (
        np.clip(
            np.nan_to_num(residuals(data, weights, answers(model, data, theta, x)), nan=_HUGE),
            -_HUGE,
            _HUGE,
        )
        for x in (zero, zero + _STEP)
    )
    J = (beside - r) / _STEP
    a, b, c = np.sum(J**2, axis=2), np.sum(J * r, axis=2), np.sum(r**2, axis=2)
    costs = []
    for s in _SCATTERS if model.estimate_scatter else (model.scatter,):
        q = np.maximum(c - s**2 * b**2 / (1 + s**2 * a), 0.0)
        costs.append(np.sum(4 * np.log1p(q / 4) + np.log1p(s**2 * a), axis=1))
    return np.min(costs, axis=0)
