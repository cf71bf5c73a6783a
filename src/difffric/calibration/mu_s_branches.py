"""Each push's own mu_s, where several of them explain the push: d jumps and bends with mu_s."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.batched_answers import BATCH, compute_answers, weigh_residuals
from difffric.estimation.descent import ARRIVED, Model, Settled
from difffric.estimation.mixed_fit import settle
from difffric.estimation.push_friction import rescan_push_friction
from difffric.estimation.stacked_data import FitData

_NO_ANSWER = 1e9
"""The residual of an answer that does not exist: more than any that does."""
_LEAST_SCATTER = 1e-3
"""The scatter that a search on a grid assumes at least: with none, all mu_s would be one."""
_LEAST_WIDTH, _SCATTERS = 0.15, 5
"""The grid reaches this far in log mu_s, or this many scatters, to either side."""
_BRANCHES = 3
"""The minima that are handed back for each push, the best first."""
_ROUNDS = 3
"""How often a fit may change branches: each change moves the shared parameters a little."""


def find_branches(model: Model, data: FitData, at: Settled) -> list[NDArray]:
    """Where each push's own log mu_s may lie, the shared parameters as they are.

    These are the best minima of the push's cost on a fine grid, each an array (n,).
    """
    scatter = max(at.scatter, _LEAST_SCATTER)
    width = max(_LEAST_WIDTH, _SCATTERS * scatter)
    grid = np.linspace(-width, width, BATCH)
    n = data.n
    shared, own = np.tile(at.theta, (BATCH, 1)), np.tile(grid[:, None], (1, n))
    answers = compute_answers(model, data, shared, own)
    r = np.nan_to_num(weigh_residuals(data, at.weights, answers), nan=_NO_ANSWER)
    cost = np.sum(r**2, axis=2) + (grid[:, None] / scatter) ** 2
    padded = np.pad(cost, ((1, 1), (0, 0)), constant_values=np.inf)
    dip = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])
    order = np.argsort(np.where(dip, cost, np.inf), axis=0)
    return [grid[order[k]] for k in range(_BRANCHES)]


def settle_on_best_branches(model: Model, data: FitData, done: Settled) -> Settled:
    """The fit once every push's own mu_s is on the branch that fits it best."""
    for _ in range(_ROUNDS):
        other = rescan_push_friction(model, data, done, find_branches(model, data, done))
        if other is done:
            break
        again = settle(model, data, other)
        if again.components.criterion > done.components.criterion - ARRIVED:
            break
        done = again
    return done
