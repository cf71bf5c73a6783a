"""How well fits predict pushes that were held out of them: what a cause gains is counted there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from difffric.estimation import ensemble_refits
from difffric.estimation.ensemble import EnsembleTask, Fits

_MOST_FOLDS = 20
"""Folds at most: each push is one of its own up to so many pushes."""


@dataclass(frozen=True)
class CrossValidation:
    """A data set, and the fold of each push; a push is predicted from the pushes of other folds."""

    task: EnsembleTask
    folds: NDArray
    """(n,) numbers of the folds"""
    known: dict[tuple, ensemble_refits.HeldOut] = field(default_factory=dict, repr=False)
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

    def _predict(self, fits: Fits) -> ensemble_refits.HeldOut:
        """Return what fits say of the held-out pushes: the same fits are asked about again and
        again."""
        where = (fits.c, fits.mu, fits.own, fits.scatter, fits.spread, fits.gram)
        key = (fits.extra, *(np.asarray(x).tobytes() for x in where))
        if key not in self.known:
            self.known[key] = ensemble_refits.predict_held_out(self.task, fits, self.folds)
        return self.known[key]


def assign_folds(velocity: NDArray, by_speed: bool) -> NDArray:
    """Return the fold (n,) of each push: all of one speed, or one push each (of about twenty
    folds)."""
    if by_speed:
        return np.unique(velocity, return_inverse=True)[1]
    n = len(velocity)
    return np.arange(n) % max(min(n, _MOST_FOLDS), 1)
