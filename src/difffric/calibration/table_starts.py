"""Where a fit of a table starts: F_p alone is smooth in the parameters, d jumps.

F_p alone is fitted first; points about that fit, and about the set-up, are ranked by a cost that
one push on the wrong side of a jump does not spoil; the best are worth a descent.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.compute.xla_options import soon_compiled
from difffric.estimation.coordinates import to_coordinate
from difffric.estimation.mixed_fit import (
    Model,
    Settled,
    descend,
    first_point,
    linear_at,
    moved,
    problem_of,
)
from difffric.estimation.mixed_model import Problem
from difffric.estimation.stacked_data import FitData
from difffric.rig import parameters
from difffric.units import GRAVITY

BATCH = 256
"""Points whose answers are computed by one call."""
_POOL = 3 * BATCH
"""Points that are ranked; whole batches, so that one compiled program serves."""
_SCATTER = 0.03
_FORCE_ONLY = 0.003
"""How far the model's F_p may be off, as a share, while it leads alone."""
_WIDER = 2.0
"""By how much the points spread more than the fit of F_p says."""
_WEAK = 1.5
"""Standard deviation of the logarithms where F_p says nothing."""
_LOOSE = np.array([0.03, 0.15])
"""Relative errors of F_p and d at which the rank's cost begins to flatten."""
_NOWHERE = 1e9
"""The residual of an answer that does not exist."""
_VISCOUS = 0.3
"""The largest share of viscosity in the friction at the fastest push that is looked for."""


@soon_compiled
def _model(problem: Problem, thetas, s_etas):
    """(n, batch, 2): F_p and d at shared coordinates (batch, P) and own log mu_s (n, batch).

    One push after the other: a batch goes on for as long as its longest push, and the same push
    lasts about as long at all points.
    """

    def of_push(given):
        push, selection, fixed, own = given

        def at(theta, s_eta):
            c = (fixed + selection @ theta).at[0].add(s_eta)
            return push.respond(problem.rig, problem.integrator, c).model

        return jax.vmap(at)(thetas, own)

    return jax.lax.map(of_push, (problem.pushes, problem.selection, problem.fixed, s_etas))


def answers(model: Model, data: FitData, thetas: NDArray, s_etas: NDArray) -> NDArray:
    """The model's (F_p, d), (batch, n, 2), a batch of `BATCH` at a time."""
    nothing = np.zeros(model.layout.n_free)
    problem = problem_of(model, data, nothing > 0, nothing, 1.0, data.weights, 1.0)
    size, whole = problem.prior.shape[0], problem.weights.shape[0]
    out = []
    for lo in range(0, len(thetas), BATCH):
        theta, s_eta = np.zeros((BATCH, size)), np.zeros((whole, BATCH))
        part = thetas[lo : lo + BATCH]
        theta[: len(part), : part.shape[1]] = part
        s_eta[: data.n, : len(part)] = s_etas[lo : lo + BATCH].T
        out.append(np.asarray(_model(problem, theta, s_eta))[: data.n, : len(part)])
    return np.concatenate(out, axis=1).swapaxes(0, 1)


def measured(data: FitData) -> NDArray:
    """(n, 2) the table's F_p and d, NaN where there is none."""
    both = np.asarray(data.pushes.measured)[: data.n]
    return both if both.shape[1] == 2 else np.column_stack([np.full(data.n, np.nan), both])


def residuals(data: FitData, weights: NDArray, found: NDArray) -> NDArray:
    """(batch, n, m) weighted residuals of answers (batch, n, 2); NaN where the model gives no
    number for one that was measured."""
    seen = measured(data)
    if weights.shape[1] == 1:
        seen, found = seen[:, 1:], found[..., 1:]
    return np.where(weights > 0, weights * (seen - found), 0.0)


def pool(model: Model, data: FitData, box: list[NDArray]) -> NDArray:
    """(N, P) points from which a fit may start: those of `box`, and about the fit of F_p."""
    points = np.array(box)
    if np.isfinite(measured(data)[:, 0]).sum() > model.layout.n_free:
        points = np.concatenate([points, _about_the_forces(model, data, box)])
    return np.clip(points, model.layout.lower, model.layout.upper)


def ranked_starts(model: Model, data: FitData, box: list[NDArray], most: int) -> list[NDArray]:
    """At most `most` points to descend from, the most promising first; the first of `box`, the
    set-up itself, is always among them."""
    points = pool(model, data, box)
    cost = _cost(answers(model, data, points, np.zeros((len(points), data.n))), measured(data))
    chosen = [*np.argsort(cost, kind="stable")[: most - 1].tolist(), 0]
    return [points[i] for i in dict.fromkeys(chosen)]


def _cost(model: NDArray, data: NDArray) -> NDArray:
    """Sum of log(1 + r^2): what is far off costs hardly more than what is off."""
    with np.errstate(invalid="ignore", divide="ignore"):
        force = (model[..., 0] / data[:, 0] - 1) / _LOOSE[0]
        d = np.log(np.maximum(np.nan_to_num(model[..., 1]), 1e-9) / data[:, 1]) / _LOOSE[1]
    force = np.where(np.isnan(model[..., 0]), 1e9, force)
    seen = np.isfinite(data)
    return (np.log1p(force**2) * seen[:, 0] + np.log1p(d**2) * seen[:, 1]) @ np.ones(len(data))


def fit_of_forces(
    model: Model, data: FitData, box: list[NDArray]
) -> tuple[Settled, NDArray] | None:
    """Where F_p alone leads, with k_v as it is, and which parameters that was without; None
    where the model gives no number."""
    F = measured(data)[:, 0]
    known = (data.group[:, 0] < 0) & (data.weights[:, 0] > 0)
    noise = np.where(known, 1.0 / np.where(known, data.weights[:, 0], 1.0), 0.01 * F)
    sd = np.hypot(_FORCE_ONLY * F, noise)
    weights = np.nan_to_num(np.column_stack([1.0 / sd, np.zeros(data.n)]))
    forces = replace(data, weights=weights, group=np.full(data.group.shape, -1))
    held = np.array([name == "k_v_N_s_per_m" for name in model.layout.names], bool)
    scatter = _SCATTER if model.estimate_scatter else model.scatter
    best, costs = None, []
    for theta in box:
        at = first_point(model, forces, theta)
        end = descend(model, forces, at, held, weights, scatter, 1.0)
        chi2 = float(end.chi2)
        if np.isfinite(chi2) and (best is None or chi2 < min(costs)):
            best = replace(moved(at, end, held, scatter), weights=weights)
        costs.append(chi2 if np.isfinite(chi2) else np.inf)
        good = sorted(costs)
        if len(good) > 2 and good[1] - good[0] < 0.01 * (1 + good[0]):
            break
    return None if best is None else (best, held)


def _about_the_forces(model: Model, data: FitData, box: list[NDArray]) -> NDArray:
    """Points from the neighbourhood of the fit of F_p alone."""
    layout = model.layout
    found = fit_of_forces(model, data, box)
    if found is None:
        return np.zeros((0, layout.n_free))
    best, held = found
    forces = replace(
        data, weights=best.weights, group=np.full(data.group.shape, -1), counts=np.zeros(0),
        least=np.zeros(0),
    )  # fmt: skip
    free = ~held
    linear = linear_at(model, forces, best)
    X = linear.criterion(best.scatter, np.zeros(0))[1][np.ix_(free, free)]
    X = X / _WIDER**2 + np.eye(int(free.sum())) / _WEAK**2
    spread = np.linalg.cholesky(np.linalg.inv(X))
    n = _POOL - len(box)
    u = scipy.stats.qmc.Sobol(layout.n_free, scramble=False).random_base2(
        int(np.ceil(np.log2(n + 1)))
    )
    u = u[1 : n + 1]  # the first is the origin
    theta = np.tile(best.theta, (len(u), 1))
    theta[:, free] += scipy.special.ndtri(np.clip(u[:, free], 1e-4, 1 - 1e-4)) @ spread.T
    theta[:, held] = _most_viscous(model, data) * u[:, held] ** 1.5
    return theta


def _most_viscous(model: Model, data: FitData) -> float:
    """The coordinate of the largest k_v worth a start."""
    values = {name: float(x) for name, x in parameters.values(model.rig).items()}
    fastest = float(np.max(np.asarray(data.pushes.velocity)))
    sliding = values["mu_s"] * values["mu_k_over_mu_s"] * values["mass_kg"] * GRAVITY
    most = max(_VISCOUS * sliding / fastest, 2 * values["k_v_N_s_per_m"])
    return float(to_coordinate("k_v_N_s_per_m", most))


def other_branches(model: Model, data: FitData, at: Settled) -> list[NDArray]:
    """Where else each push's own log mu_s may lie: the two best minima of its cost on a fine
    grid, each (n,), the shared parameters as they are."""
    scatter = max(at.scatter, 1e-3)
    width = max(0.15, 5 * scatter)
    grid = np.linspace(-width, width, BATCH)
    n = data.n
    found = answers(model, data, np.tile(at.theta, (BATCH, 1)), np.tile(grid[:, None], (1, n)))
    r = np.nan_to_num(residuals(data, at.weights, found), nan=_NOWHERE)
    cost = np.sum(r**2, axis=2) + (grid[:, None] / scatter) ** 2
    padded = np.pad(cost, ((1, 1), (0, 0)), constant_values=np.inf)
    dip = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])
    order = np.argsort(np.where(dip, cost, np.inf), axis=0)
    return [grid[order[k]] for k in range(3)]
