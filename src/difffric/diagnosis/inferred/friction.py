"""The mu_s of each push by a fit, and how well it is known."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import CATALOGUE

DWELL_EFFECT = "static_dwell"
"""The effect by which static friction grows in a rest."""
_DRIFT, _DWELL = "friction_drift.drift", f"{DWELL_EFFECT}.amplitude"
_TAU = next(key.null for key in CATALOGUE[DWELL_EFFECT].keys if key.name == "tau_s")
"""Time [s] after which a rest begins to count, which is fixed."""


def find_friction(task: EnsembleTask, fits: Fits, grown: bool = True) -> NDArray:
    """Return the log mu_s (n,) that each push had by a fit (an ensemble of one): with the drift up
    to it and, where it is to be `grown`, what static friction grew by in the rest before it."""
    coordinates = task.model.coordinates
    found = fits.mu[0, task.condition] + fits.own[0]
    if _DRIFT in coordinates.names:
        (drift,) = coordinates.values(fits.c[0], (_DRIFT,))
        found = found + np.log1p(drift * np.asarray(task.model.pushes.share))
    if grown and _DWELL in coordinates.names:
        (amplitude,) = coordinates.values(fits.c[0], (_DWELL,))
        found = found + np.log1p(amplitude * _grow_in_rest(task.model.pushes))
    return found


def compute_friction_errors(
    task: EnsembleTask, fits: Fits, unseen: float = 0.0, grown: bool = True
) -> NDArray:
    """Return the standard errors (n,) of the log mu_s of `find_friction`; `unseen` is what a small
    effect that no push can tell from mu_s (a normal force, where all have one mass) does to it.

    A push's own mu_s is known as well as its own data and the scatter say, where the parameters
    are known; their covariance adds what they do to it. All is as much larger as what the fit
    leaves beyond the noise.
    """
    if not task.mu_free:
        return np.zeros(task.n)
    weight, slope = linearise_friction(task, fits, grown)
    covariance = ensemble.covariance(task, fits)[0]
    variance = 1.0 / weight + np.einsum("np,pq,nq->n", slope, covariance, slope)
    return np.sqrt(variance * measure_excess(task, fits) + unseen**2)


def measure_excess(task: EnsembleTask, fits: Fits) -> float:
    """Return by how much more than noise the squares of a fit (an ensemble of one) are: at least
    1."""
    squares = np.einsum("nk,k->", fits.gram[0, ..., -1, -1], fits.spread[0] ** -2.0)
    spent = task.conditions + fits.gram.shape[-1] - 2
    return max(float(squares) / max(task.counts.sum() - spent - task.n, 1.0), 1.0)


def linearise_friction(
    task: EnsembleTask, fits: Fits, grown: bool = True
) -> tuple[NDArray, NDArray]:
    """Return the precision (n,) of each push's own log mu_s where all else is known, and the
    derivatives (n, P) of the log mu_s by the parameters, each push's own following them."""
    parts = ensemble.split_by_push(task, fits)
    weight = parts.z[0] + 1.0 / fits.scatter[0] ** 2
    slope = -parts.h[0] / weight[:, None]
    slope[np.arange(task.n), task.condition] += 1.0
    columns = [*task.shared, *fits.extra[0]]
    for i, change in differentiate_friction(task, fits.c[0], grown).items():
        if i in columns:
            slope[:, task.conditions + columns.index(i)] += change
    return weight, slope


def differentiate_friction(
    task: EnsembleTask, c: NDArray, grown: bool = True
) -> dict[int, NDArray]:
    """Return the derivatives (n,) of each push's log mu_s, as `find_friction` has it, by those of
    the coordinates c (K,) that say how it changes from push to push, by their numbers."""
    coordinates, found = task.model.coordinates, {}
    for name in (_DRIFT, _DWELL) if grown else (_DRIFT,):
        for i in coordinates.indices([name]) if name in coordinates.names else ():
            pushes = task.model.pushes
            by = np.asarray(pushes.share) if name == _DRIFT else _grow_in_rest(pushes)
            (value,) = coordinates.values(c, (name,))
            found[i] = coordinates.unit[i] * by / (1.0 + value * by)
    return found


def _grow_in_rest(pushes: Any) -> NDArray:
    """By what share of the amplitude of a dwell static friction grew in the rest before each
    push."""
    return np.log1p(np.asarray(pushes.rest) / _TAU)
