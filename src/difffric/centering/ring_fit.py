"""The fit behind a measured ring: Gauss-Newton steps, weights against outliers, and lobes of
unknown size, which are integrated out.

The parameters p (k,) are x, y, R, and then two amplitudes for each order of lobes, from 2 on [m].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.errors import NumericalError

_ORDERS = (5, 9, 16)
"""Highest orders of lobes that are averaged over: ground rings have few, and few above 16."""
_SCALES = 3.0 ** np.arange(6)
"""Sizes of lobes that are averaged over, over the least one that is allowed for."""
_OUTLIER = 4.0
"""Standard deviations beyond which a reading is an outlier: of normal ones 1 in 16 000 is."""
_TUKEY = 4.685
"""Residual over the standard deviation from which Tukey's weight is 0: 95 % efficiency."""
_HUBER = 0.29
"""Residual over `_TUKEY` from which Huber's weight falls: 1.345 / 4.685, 95 % efficiency."""


class RingReadings(NamedTuple):
    """Readings of a ring, (n,) each."""

    cos: NDArray
    """of theta"""
    sin: NDArray
    """of theta"""
    theta: NDArray
    """encoder angle [rad]"""
    r: NDArray
    """distance of the surface from the axis [m]"""


class Prior(NamedTuple):
    """Lobes of the orders 2 to `order`, each amplitude N(0, scale^2); inf: free."""

    order: int
    scale: float

    @property
    def size(self) -> int:
        """The number of parameters."""
        return 3 + 2 * (self.order - 1)

    @property
    def precision(self) -> NDArray:
        """(size,) of every parameter [1/m^2]."""
        return np.concatenate([np.zeros(3), np.full(self.size - 3, self.scale**-2.0)])


class RingFit(NamedTuple):
    """The fitted parameters of a ring, and what the readings say of them."""

    p: NDArray
    """(k,) parameters [m]"""
    noise: float
    """standard deviation of one reading [m]: given, or estimated"""
    covariance: NDArray
    """(k, k) of p [m^2]"""
    leverage: NDArray
    """(n,) how much of each reading's residual the fit follows"""
    freedom: float
    """degrees of freedom that the residuals have left"""
    form: float
    """standard deviation of a lobe's amplitudes [m], in the mean over priors; inf: free"""


def fit_circle(data: RingReadings) -> NDArray:
    """Return x, y, R [m] of the algebraic circle x^2 + y^2 = 2 a x + 2 b y + c.

    It is exact without noise, and where outliers make it none, it is the median circle.
    """
    x, y = data.r * data.cos, data.r * data.sin
    mean = data.r.mean()
    rows = np.stack([2 * x, 2 * y, np.full_like(x, mean)], axis=1)
    (a, b, c), *_ = np.linalg.lstsq(rows, data.r**2, rcond=None)
    square = c * mean + a**2 + b**2
    if not np.hypot(a, b) < np.sqrt(max(square, 0.0)):  # outliers: from the mean circle then
        return np.array([0.0, 0.0, np.median(data.r)])
    return np.array([a, b, np.sqrt(square)])


def predict(data: RingReadings, p: NDArray) -> tuple[NDArray, NDArray]:
    """Return the radii r (n,) [m] by the model, and their derivatives by p (n, k).

    The derivatives through psi, 1e-5 of the rest, are left out.
    """
    x, y, R = p[:3]
    along = x * data.cos + y * data.sin
    across = x * data.sin - y * data.cos
    psi = data.theta + np.arcsin(np.clip(across / R, -1.0, 1.0))
    orders = (len(p) - 3) // 2
    turns = np.empty((orders + 1, len(psi)), complex)  # exp(i n psi), n = 1 upwards
    turns[:] = np.exp(1j * psi)
    np.multiply.accumulate(turns, axis=0, out=turns)
    waves = np.ascontiguousarray(turns[1:].T).view(float)  # cos and sin in turn
    at = R + waves @ p[3:]
    inner = np.sqrt(np.maximum(at**2 - across**2, (1e-3 * R) ** 2))
    by = np.empty((len(psi), len(p)))
    by[:, 0] = data.cos - across / inner * data.sin
    by[:, 1] = data.sin + across / inner * data.cos
    by[:, 2] = at / inner
    by[:, 3:] = waves * by[:, 2:3]
    return along + inner, by


def _shorten(step: NDArray, p: NDArray) -> NDArray:
    """Return a step that moves the centre by half the radius at most."""
    longest = np.hypot(step[0], step[1])
    return step * min(1.0, 0.5 * p[2] / longest) if longest > 0 else step


def fit_robustly(
    data: RingReadings, p: NDArray, prior: Prior, noise: float | None
) -> tuple[NDArray, NDArray]:
    """Fit from p by weights that outliers hardly move.

    Returns the parameters, and for each reading whether it counts (n,), 1 or 0.

    It is iterated by hand: statsmodels' RLM is linear and knows no prior, and scipy's robust losses
    keep their scale, take five times as long and, with 28 % of outliers, find others.
    """
    weight, e, by = np.ones_like(data.r), *_find_residuals(data, p)
    sigma = noise or max(float(np.sqrt(e @ e / len(e))), 1e-15 * p[2])
    for k in range(30):
        heavy, ridge = by * weight[:, None], prior.precision * sigma**2
        step = _invert(heavy.T @ by + np.diag(ridge)) @ (heavy.T @ e - ridge * p)
        p = p + _shorten(step, p)
        e, by = _find_residuals(data, p)
        spread = 1.4826 * np.median(np.abs(e)) * np.sqrt(len(e) / max(len(e) - 3, 1))
        sigma = max(spread, noise or 0.0, 1e-15 * p[2])
        z = np.abs(e) / (_TUKEY * sigma)
        if k == 1 and z.max() < 1:
            return p, np.ones_like(weight)  # nothing is far off
        # Huber's weights first: Tukey's, from a bad start, may stay there.
        huber = np.minimum(1.0, _HUBER / np.maximum(z, 1e-9))
        new = huber if k < 5 else np.maximum(1 - z**2, 0.0) ** 2
        settled = k > 5 and np.abs(new - weight).max() < 1e-2
        weight = new
        if settled:
            break
    return p, (np.abs(e) < _OUTLIER * sigma).astype(float)


def fit_ring(
    data: RingReadings,
    p: NDArray,
    prior: Prior | None,
    weight: NDArray,
    noise: float | None,
    form: float,
) -> RingFit:
    """Fit the parameters by Gauss-Newton steps from p, each reading with its weight (n,).

    Without a `prior` the answer is averaged over lobes of all `_ORDERS`, and over their sizes from
    `form` [m] on.
    """
    widest = prior or Prior(_ORDERS[-1], _SCALES[2] * form)
    at = np.zeros(widest.size)
    n = min(len(p), len(at))
    at[:n] = p[:n]
    by = inverse = np.zeros((0, 0))
    variance = freedom = scale = 0.0
    for _ in range(20):
        value, by = predict(data, at)
        heavy = by * weight[:, None]
        normal, e = heavy.T @ by, data.r - value
        # About the circle alone: its lobes are unknowns of the linear problem, as x, y, R are.
        e = e + by[:, 3:] @ at[3:]
        right, square = heavy.T @ e, float(weight @ e**2)
        exact = (1e-15 * at[2]) ** 2
        variance, freedom = _estimate_variance(normal, right, square, weight.sum(), widest)
        variance = max(noise**2 if noise else variance, exact)
        if prior is None:
            q, inverse, scale = _average_over_priors(normal, right, variance, form)
        else:
            inverse = _invert(normal + variance * np.diag(prior.precision))
            q, scale = inverse @ right, prior.scale
        step = np.concatenate([q[:3], q[3:] - at[3:]])
        at = at + _shorten(step, at)
        se = np.sqrt(variance * np.diag(inverse))
        if (np.abs(step) <= 1e-3 * se + 1e-15 * at[2]).all():
            break
    leverage = np.einsum("ni,ij,nj->n", by, inverse, by)
    return RingFit(at, float(np.sqrt(variance)), variance * inverse, leverage, freedom, scale)


def _average_over_priors(
    normal: NDArray, right: NDArray, variance: float, form: float
) -> tuple[NDArray, NDArray, float]:
    """Average over orders and sizes of lobes by how likely the readings are under each, the lobes
    integrated out. The likeliest alone would be sure of what a short arc cannot show.

    Takes the normal equations' matrix (k, k) and right side (k,), and the variance of a reading
    [m^2]. Returns the estimate (k,), its covariance over the variance (k, k), and the mean size of
    lobes [m].
    """
    m = Prior(_ORDERS[-1], form).size
    means, covariances, logs, sizes = [], [], [], []
    for order in _ORDERS:
        k = Prior(order, form).size
        scales = _SCALES * form
        penalty = np.zeros((len(scales), k))
        penalty[:, 3:] = variance / scales[:, None] ** 2
        inner = normal[:k, :k] + penalty[:, None, :] * np.eye(k)
        inverse = np.linalg.inv(inner)
        q = inverse @ right[:k]
        loglik = 0.5 * (q @ right[:k]) / variance - 0.5 * np.linalg.slogdet(inner)[1]
        logs.append(loglik + 0.5 * np.log(penalty[:, 3:]).sum(axis=1))
        full = np.zeros((len(scales), m, m))
        full[:, :k, :k] = inverse
        # Orders beyond the model's are not there under it.
        means.append(np.concatenate([q, np.zeros((len(scales), m - k))], axis=1))
        covariances.append(full)
        sizes.append(scales)
    log = np.concatenate(logs)
    share = np.exp(log - log.max())
    share /= share.sum()
    each, size = np.concatenate(means), np.concatenate(sizes)
    mean = share @ each
    apart = each - mean
    inverse = np.tensordot(share, np.concatenate(covariances), 1)
    inverse += (apart * share[:, None]).T @ apart / variance
    return mean, inverse, float(share @ size)


def _invert(matrix: NDArray) -> NDArray:
    """Invert a positive definite matrix (k, k), scaled to a diagonal of ones.

    Raises `NumericalError` where it is singular but for rounding.
    """
    scale = 1 / np.sqrt(np.diag(matrix))
    even = matrix * scale[:, None] * scale
    try:
        found = np.linalg.inv(even)
        lost = not np.abs(found).max() < 1e14
    except np.linalg.LinAlgError:
        found, lost = even, True
    if lost:
        raise NumericalError(
            "ring: the readings cannot tell offset, radius and lobes apart: allow fewer lobes, or "
            "measure a longer arc"
        )
    return found * scale[:, None] * scale


def _estimate_variance(
    normal: NDArray, right: NDArray, square: float, count: float, prior: Prior
) -> tuple[float, float]:
    """Estimate the variance of one reading [m^2] and its degrees of freedom, from the normal
    equations of `count` readings and the sum of their squares. It takes a few rounds, as the
    prior's pull depends on the variance."""
    variance, freedom = max(square / count, 1e-300), 1.0
    for _ in range(4):
        inverse = _invert(normal + variance * np.diag(prior.precision))
        q = inverse @ right
        rss = max(float(square - 2 * q @ right + q @ normal @ q), 0.0)
        freedom = count - float((inverse * normal).sum())
        variance = max(rss / max(freedom, 1.0), 1e-300)
        if prior.scale == np.inf:
            break
    return variance, freedom


def _find_residuals(data: RingReadings, p: NDArray) -> tuple[NDArray, NDArray]:
    """Return measured less predicted radii (n,) [m], and the derivatives of the latter (n, k)."""
    value, by = predict(data, p)
    return data.r - value, by


def select_inliers(data: RingReadings, fit: RingFit) -> NDArray:
    """Return which readings (n,) are no outliers, by their residual's own standard deviation."""
    e = np.abs(data.r - predict(data, fit.p)[0])
    own = np.sqrt(np.clip(1 - fit.leverage, 1e-2, 1.0))
    return e < _OUTLIER * fit.noise * own + 1e-14 * fit.p[2]
