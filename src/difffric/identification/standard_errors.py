"""The standard error of mu_s: how noise and the calibration's error come through to it.

The two estimates of a push, from F_p and from d, share the calibration's error, so their covariance
is not diagonal: with sigma the noise of F_p and d, s their slopes by mu_s, J their derivatives by
the calibrated coordinates and R R^T the covariance of these,

    C = diag(sigma / s)^2 + S S^T,   S = -(J / s) R.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from difffric.identification.estimates import Estimates

if TYPE_CHECKING:
    from jaxtyping import Float


def propagate_errors(
    slope: Float[NDArray, "n 2"],
    gradient: Float[NDArray, "n 2 k"],
    roots: Float[NDArray, "n k k"],
    errors: Float[NDArray, "n 2"],
) -> tuple[Float[NDArray, "n 2 2"], Float[NDArray, "n 2 k"]]:
    """Return C, and S, the part of the errors that pushes share, for n pushes.

    `slope` holds dF_p/dmu_s [N] and dd/dmu_s [m], `gradient` is J, `roots` is R, and `errors` the
    standard errors of F_p [N] and d [m].
    """
    shared = np.matmul(-(gradient / slope[..., None]), roots)
    covariance = np.matmul(shared, shared.swapaxes(1, 2))
    covariance[:, [0, 1], [0, 1]] += (errors / slope) ** 2
    return covariance, shared


def average_with_error(
    weights: Float[NDArray, "n 2"],
    mu: Float[NDArray, "n 2"],
    covariance: Float[NDArray, "n 2 2"],
    shared: Float[NDArray, "n 2 k"],
) -> Estimates:
    """Return the weighted mean of force and distance with its standard error, sqrt(w^T C w).

    What has no weight does not count, whether it is a number or NaN.
    """
    used = weights != 0
    w = weights[:, None, :]
    mu = np.where(used, mu, 0.0)
    covariance = np.where(used[:, :, None] & used[:, None, :], covariance, 0.0)
    shared = np.where(used[:, :, None], shared, 0.0)
    # Each product by `matmul`, a push at a time: its order of operations does not depend on how
    # many pushes there are.
    variance = np.matmul(np.matmul(w, covariance), weights[..., None])[:, 0, 0]
    value = np.matmul(w, mu[..., None])[:, 0, 0]
    return Estimates(value, np.sqrt(variance), np.matmul(w, shared)[:, 0])
