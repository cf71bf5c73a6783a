"""How well fits predict pushes that were held out of them: what a cause gains is counted there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.estimation.ensembles import ensemble, held_out
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.measurements.noise import KNOWN_TO

FLOOR = 1e-3
"""Probability below which what fits leave of held-out pushes is more than noise."""
_MOST_FOLDS = 20
"""Folds at most: each push is one of its own up to so many pushes."""


@dataclass(frozen=True)
class Remaining:
    """What a model leaves of held-out pushes beyond the noise."""

    heldout_nrmse: float
    """error on held-out pushes in units of the noise: 1 is perfect"""
    p_value: float
    """of so large an error by noise alone"""
    where: str
    """where it sits, as a person reads it"""

    def as_dict(self) -> dict[str, Any]:
        """As `result.json` holds it."""
        return {
            "heldout_nrmse": self.heldout_nrmse,
            "p_value": self.p_value,
            "where": self.where,
        }

    def __str__(self) -> str:
        return (
            f"what is left is not noise: the error on held-out pushes is {self.heldout_nrmse:.3g} "
            f"times the noise (p = {self.p_value:.2g}), most of it in {self.where}"
        )


@dataclass(frozen=True)
class CrossValidation:
    """A data set, and the fold of each push; a push is predicted from the pushes of other folds."""

    task: EnsembleTask
    folds: NDArray
    """(n,) numbers of the folds"""
    known: dict[tuple, held_out.HeldOut] = field(default_factory=dict, repr=False)
    """what was predicted already, by all that says where the fits stand"""

    @property
    def single(self) -> bool:
        """Whether each push has a single number, which a mu_s of its own would fit."""
        task = self.task
        return task.mu_free and bool((task.counts.sum(axis=1) <= 1).all())

    def measure_surprise(self, fits: Fits) -> float:
        """Return -2 log likelihood of the held-out pushes under `fits` (an ensemble of one)."""
        return float(self._predict(fits).surprise.sum())

    def is_better(self, new: Fits, base: Fits) -> bool:
        """Whether `new` predicts held-out pushes better than `base`, with `new`'s spreads."""
        return self.measure_surprise(new) < self.measure_surprise(replace(base, spread=new.spread))

    def speaks_against(self, new: Fits, base: Fits) -> bool:
        """Whether `new` predicts held-out pushes worse than `base` by more than it explains of all
        pushes."""
        value = ensemble.criterion(self.task, ensemble.join(base, new))
        worse = self.measure_surprise(new) - self.measure_surprise(base)
        return worse > float(value[0] - value[1])

    def measure_squares(self, fits: Fits, spread: NDArray, plain_scatter: NDArray) -> NDArray:
        """Return the (1, n) squared errors of the held-out pushes in units of the noise.

        `spread` (1, 2) are the factors of the noise. A push whose single number a mu_s of its own
        would fit, as a free slide's, is judged in units of the plain model's scatter of mu_s,
        `plain_scatter` (1,).
        """
        found = self._predict(replace(fits, spread=spread))
        if not self.single:
            return found.squares
        return self._predict(replace(fits, scatter=plain_scatter)).penalised

    def measure_floor_p_value(self, fits: Fits) -> float | None:
        """Return the probability that noise alone leaves as much of the held-out pushes as `fits`
        (an ensemble of one) do; None where the noise is not known, or a mu_s of its own takes up
        all that a push says."""
        if self.single or any(self.task.open_spread):
            return None
        found = self._predict(fits)
        # Pushes that the others hardly foresee count for less.
        numbers = self.task.counts.sum(axis=1)
        weight = numbers / np.maximum(found.expected, numbers)
        mean = float((weight * found.expected).sum())
        variance = float((weight**2 * found.variance).sum())
        left = float((weight * found.penalised).sum()) / (1 + KNOWN_TO) ** 2
        # A multiple of chi-square with the same mean and variance.
        scale = 0.5 * variance / mean
        return float(scipy.stats.chi2.sf(left / scale, mean / scale))

    def is_at_floor(self, fits: Fits) -> bool:
        """Whether `fits` (an ensemble of one) leave no more of the held-out pushes than noise does,
        as far as one can say."""
        p_value = self.measure_floor_p_value(fits)
        return p_value is None or p_value > FLOOR

    def _predict(self, fits: Fits) -> held_out.HeldOut:
        """Return what fits say of the held-out pushes: the same fits are asked about again and
        again."""
        where = (fits.c, fits.mu, fits.own, fits.scatter, fits.spread, fits.gram)
        key = (fits.extra, *(np.asarray(x).tobytes() for x in where))
        if key not in self.known:
            self.known[key] = held_out.predict_held_out(self.task, fits, self.folds)
        return self.known[key]


def assign_folds(velocity: NDArray, by_speed: bool) -> NDArray:
    """Return the fold (n,) of each push: all of one speed, or one push each (of about twenty
    folds)."""
    if by_speed:
        return np.unique(velocity, return_inverse=True)[1]
    n = len(velocity)
    return np.arange(n) % max(min(n, _MOST_FOLDS), 1)
