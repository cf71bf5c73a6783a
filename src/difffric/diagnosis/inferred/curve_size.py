"""How large a free curve is, and the mu_s of each push beside it.

The level of a curve of friction is nearly one with mu_s, and a curve that may be of any size goes
far along that, the further the less it can follow what is there. So its coefficients are expected
to be as large as the data make probable where no curve is yet, and mu_s is averaged over the sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.inferred.friction import (
    compute_friction_errors,
    find_friction,
    linearise_friction,
    measure_excess,
)
from difffric.estimation.ensembles import ensemble, ensemble_refits
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits

_SIZES = np.geomspace(1e-5, 0.5, 24)
"""Sizes that the coefficients of a curve may be expected to have."""
_ROUNDS = 6
"""Steps at most of the fit with the most probable size."""
_ALONG_THE_WAY = "friction_place"
"""The form of a friction that varies along the way."""


@dataclass(frozen=True)
class SizedCurve:
    """A curve whose coefficients have some size, or another."""

    task: EnsembleTask
    """with the size that is most probable"""
    fits: Fits
    """the fit with that, an ensemble of one"""
    friction: tuple[NDArray, NDArray]
    """log mu_s (n,) of the pushes beside it, and their standard errors, averaged over the sizes"""


def fit_to_size(task: EnsembleTask, start: Fits, curve: Sequence[int]) -> SizedCurve:
    """Fit the curve whose coordinates are `curve` from `start` (an ensemble of one, with its
    answers), where it is zero."""
    _, left = _find_step(_expect_size(task, curve, _SIZES[-1], 1.0), start)
    excess = max(left / task.counts.sum(), 1.0)
    scores = np.array([_score_size(task, start, curve, size, excess) for size in _SIZES])
    share = np.exp(scores - scores.max())
    best = _expect_size(task, curve, _SIZES[int(np.argmax(scores))], excess)
    at = ensemble_refits.refit(best, replace(start, damping=None), _ROUNDS)
    means, variances = [], []
    for size in _SIZES:
        sized = _expect_size(task, curve, size, measure_excess(task, at))
        weight, slope = linearise_friction(sized, at)
        own = -ensemble.normal_equations(sized, at).gm / weight
        step, _ = _find_step(sized, at)
        means.append(find_friction(sized, replace(at, own=own)) + slope @ step)
        variances.append(compute_friction_errors(sized, at) ** 2)
    share /= share.sum()
    mean = share @ np.array(means)
    apart = share @ (np.array(means) - mean) ** 2
    return SizedCurve(best, at, (mean, np.sqrt(share @ np.array(variances) + apart)))


def _expect_size(
    task: EnsembleTask, curve: Sequence[int], size: float, excess: float
) -> EnsembleTask:
    """Return the task that expects the coefficients to have the `size`, where the fit leaves the
    `excess`, in units of the noise's squares."""
    assert task.prior is not None
    prior = task.prior.copy()
    prior[list(curve)] = excess / size**2
    return replace(task, prior=prior)


def _find_step(task: EnsembleTask, fits: Fits) -> tuple[NDArray, float]:
    """Return the step (P,) from the parameters of `fits` (an ensemble of one) to where, by its
    linear answers, the sum of squares is least, and that sum."""
    found = ensemble.normal_equations(task, fits)
    step = -ensemble.covariance(task, fits)[0] @ found.g[0]
    return step, float(found.cost[0] + found.g[0] @ step)


def _score_size(
    task: EnsembleTask, fits: Fits, curve: Sequence[int], size: float, excess: float
) -> float:
    """Return the log of how probable the data are where the coefficients have the `size`, but for a
    constant, by the linear answers of `fits`."""
    sized = _expect_size(task, curve, size, excess)
    H = ensemble.normal_equations(sized, fits).H[0]
    held = np.diag(ensemble.covariance(sized, fits)[0]) == 0.0
    volume = np.linalg.slogdet(np.where(held[:, None] | held, np.eye(len(held)), H))[1]
    _, least = _find_step(sized, fits)
    return -0.5 * (least / excess + volume) - len(curve) * float(np.log(size))


def measure_open(form: str, correction: NDArray, arrived: bool) -> float:
    """Return how far, relatively, mu_s is open beside a curve of the `form` with this `correction`
    by what no error of a fit tells, where the fit has `arrived` at the noise or not."""
    if not arrived:  # elsewhere it may be as far off as the curve is large
        return float(np.abs(correction).max())
    if form == _ALONG_THE_WAY:  # where it varies by so much, so much is open what mu_s is
        return float(np.sqrt(np.mean(correction**2)))
    return 0.0
