"""Where a fit of a table starts: F_p alone is smooth in the parameters, d jumps.

F_p alone is fitted first; points about that fit, and about the set-up, are ranked by a cost that
one push on the wrong side of a jump does not spoil; the best are worth a descent.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.calibration.batched_answers import BATCH, compute_answers, stack_measured
from difffric.calibration.free_parameters import USUAL_SCATTER
from difffric.estimation.coordinates import to_coordinate
from difffric.estimation.descent import Model, Settled, descend, first_point, linearise_at, take_end
from difffric.estimation.mixed_model import MAX_STEPS
from difffric.estimation.stacked_data import FitData
from difffric.rig import parameters
from difffric.units import GRAVITY

_POOL = 3 * BATCH
"""Points that are ranked; whole batches, so that one compiled program serves."""
_FORCE_ONLY = 0.003
"""How far the model's F_p may be off, as a share, while it leads alone."""
_WIDER = 2.0
"""By how much the points spread more than the fit of F_p says."""
_WEAK = 1.5
"""Standard deviation of the logarithms where F_p says nothing."""
_LOOSE = np.array([0.03, 0.15])
"""Relative errors of F_p and d at which the rank's cost begins to flatten."""
_NO_ANSWER = 1e9
"""The residual of an F_p that does not exist."""
_LEAST_DISTANCE = 1e-9
"""A distance [m] that stands for none, so that it has a logarithm."""
_UNKNOWN_NOISE = 0.01
"""The noise of F_p, as a share, where its spread is to be estimated."""
_ALIKE = 0.01
"""Two descents whose chi-squares differ by less than this share have led to one point."""
_TAIL = 1e-4
"""The share of the normal distribution that is cut off at either end."""
_TO_SMALL = 1.5
"""The power of evenly spread numbers that gives more of the starts a small k_v."""
_VISCOUS = 0.3
"""The largest share of viscosity in the friction at the fastest push that is looked for."""


def gather_starts(model: Model, data: FitData, box: list[NDArray]) -> NDArray:
    """(N, P) points from which a fit may start: those of `box`, and about the fit of F_p."""
    points = np.array(box)
    if np.isfinite(stack_measured(data)[:, 0]).sum() > model.layout.n_free:
        points = np.concatenate([points, _scatter_about_forces(model, data, box)])
    return np.clip(points, model.layout.lower, model.layout.upper)


def rank_starts(model: Model, data: FitData, box: list[NDArray], most: int) -> list[NDArray]:
    """At most `most` points to descend from, the most promising first; the first of `box`, the
    set-up itself, is always among them."""
    points = gather_starts(model, data, box)
    answers = compute_answers(model, data, points, np.zeros((len(points), data.n)))
    cost = _rank_answers(answers, stack_measured(data))
    chosen = [*np.argsort(cost, kind="stable")[: most - 1].tolist(), 0]
    return [points[i] for i in dict.fromkeys(chosen)]


def _rank_answers(answers: NDArray, measured: NDArray) -> NDArray:
    """(batch,) the cost of answers (batch, n, 2) beside what was measured (n, 2).

    It is the sum of log(1 + r^2): what is far off costs hardly more than what is off.
    """
    slid = np.maximum(np.nan_to_num(answers[..., 1]), _LEAST_DISTANCE)
    with np.errstate(invalid="ignore", divide="ignore"):
        force = (answers[..., 0] / measured[:, 0] - 1) / _LOOSE[0]
        d = np.log(slid / measured[:, 1]) / _LOOSE[1]
    force = np.where(np.isnan(answers[..., 0]), _NO_ANSWER, force)
    seen = np.isfinite(measured)
    each = np.log1p(force**2) * seen[:, 0] + np.log1p(d**2) * seen[:, 1]
    return each @ np.ones(len(measured))


def fit_forces(
    model: Model, data: FitData, box: list[NDArray], steps: int = MAX_STEPS
) -> Settled | None:
    """Where F_p alone leads in so many steps at most, with k_v held as it is; None where the model
    gives no number.

    F_p hardly depends on k_v. Starts are tried until the two best of three lead to one point.
    """
    F = stack_measured(data)[:, 0]
    known = (data.group[:, 0] < 0) & (data.weights[:, 0] > 0)
    noise = np.where(known, 1.0 / np.where(known, data.weights[:, 0], 1.0), _UNKNOWN_NOISE * F)
    sd = np.hypot(_FORCE_ONLY * F, noise)
    weights = np.nan_to_num(np.column_stack([1.0 / sd, np.zeros(data.n)]))
    forces = replace(data, weights=weights, group=np.full(data.group.shape, -1))
    held = np.array([name == "k_v_N_s_per_m" for name in model.layout.names], bool)
    scatter = USUAL_SCATTER if model.estimate_scatter else model.scatter
    best, costs = None, []
    for theta in box:
        at = first_point(model, forces, theta)
        end = descend(model, forces, at, held, weights, scatter, 1.0, steps)
        chi2 = float(end.chi2)
        if np.isfinite(chi2) and (best is None or chi2 < min(costs)):
            best = replace(take_end(at, end, held, scatter), weights=weights)
        costs.append(chi2 if np.isfinite(chi2) else np.inf)
        good = sorted(costs)
        if len(good) > 2 and good[1] - good[0] < _ALIKE * (1 + good[0]):
            break
    return best


def _scatter_about_forces(model: Model, data: FitData, box: list[NDArray]) -> NDArray:
    """Points from the neighbourhood of the fit of F_p alone."""
    layout = model.layout
    best = fit_forces(model, data, box)
    if best is None:
        return np.zeros((0, layout.n_free))
    forces = replace(
        data,
        weights=best.weights,
        group=np.full(data.group.shape, -1),
        counts=np.zeros(0),
        least=np.zeros(0),
    )
    free = ~best.held
    linear = linearise_at(model, forces, best)
    X = linear.evaluate(best.scatter, np.zeros(0))[1][np.ix_(free, free)]
    X = X / _WIDER**2 + np.eye(int(free.sum())) / _WEAK**2
    spread = np.linalg.cholesky(np.linalg.inv(X))
    n = _POOL - len(box)
    u = scipy.stats.qmc.Sobol(layout.n_free, scramble=False).random_base2(
        int(np.ceil(np.log2(n + 1)))
    )
    u = u[1 : n + 1]  # the first is the origin
    theta = np.tile(best.theta, (len(u), 1))
    theta[:, free] += scipy.special.ndtri(np.clip(u[:, free], _TAIL, 1 - _TAIL)) @ spread.T
    theta[:, best.held] = _most_viscous(model, data) * u[:, best.held] ** _TO_SMALL
    return theta


def _most_viscous(model: Model, data: FitData) -> float:
    """The coordinate of the largest k_v worth a start."""
    values = {name: float(x) for name, x in parameters.values(model.rig).items()}
    fastest = float(np.max(np.asarray(data.pushes.velocity)))
    sliding = values["mu_s"] * values["mu_k_over_mu_s"] * values["mass_kg"] * GRAVITY
    most = max(_VISCOUS * sliding / fastest, 2 * values["k_v_N_s_per_m"])
    return float(to_coordinate("k_v_N_s_per_m", most))
