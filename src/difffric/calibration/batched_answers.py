"""F_p and d of a table's pushes at many points at once, which searches rank points by."""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from difffric.compute import pytrees
from difffric.compute.xla_options import compile_soon
from difffric.estimation.descent import Model, pose_problem
from difffric.estimation.following.respond_in_columns import respond_in_columns
from difffric.estimation.mixed_model import Problem
from difffric.estimation.stacked_data import FitData
from difffric.simulation.columns import serves
from difffric.timings import count_followed

BATCH = 256
"""Points whose answers are computed by one call: enough to keep a processor's vector units full,
few enough that a search which needs some dozens does not compute many in vain."""


@compile_soon
def _answer_batch(
    problem: Problem,
    thetas: Float[Array, "batch free"],
    s_etas: Float[Array, "n batch"],
) -> Float[Array, "n batch 2"]:
    """F_p and d at shared coordinates and at each push's own log mu_s beyond the shared one.

    One push after the other: a batch goes on for as long as its longest push, and the same push
    lasts about as long at all points.
    """

    def answer_push(given):
        push, selection, fixed, own = given

        def answer_at(theta, s_eta):
            c = (fixed + selection @ theta).at[0].add(s_eta)
            return push.respond(problem.rig, problem.integrator, c).model

        return jax.vmap(answer_at)(thetas, own)

    return jax.lax.map(answer_push, (problem.pushes, problem.selection, problem.fixed, s_etas))


def compute_answers(model: Model, data: FitData, thetas: NDArray, s_etas: NDArray) -> NDArray:
    """The model's (F_p, d), (batch, n, 2), at shared coordinates (batch, free) and at each push's
    own log mu_s beyond the shared one (batch, n).

    They are followed by NumPy, as fast here as a compiled program, all points at once; where that
    does not serve, the points go through the compiled program `BATCH` at a time.
    """
    if serves(model.rig, model.integrator):
        layout, n = model.layout, data.n
        c = layout.fixed + np.einsum("nkp,bp->bnk", layout.selection, thetas)
        c[..., 0] += s_etas
        pushes = pytrees.pick(data.pushes, np.tile(np.arange(n), len(thetas)))
        found = respond_in_columns(model.rig, pushes, c.reshape(-1, c.shape[2]), [])
        count_followed(1, (len(found.model), len(found.model)))
        return found.model.reshape(-1, n, 2)
    nothing = np.zeros(model.layout.n_free)
    problem = pose_problem(model, data, nothing > 0, nothing, 1.0, data.weights, 1.0)
    size, whole = problem.prior.shape[0], problem.weights.shape[0]
    out = []
    for lo in range(0, len(thetas), BATCH):
        theta, s_eta = np.zeros((BATCH, size)), np.zeros((whole, BATCH))
        part = thetas[lo : lo + BATCH]
        theta[: len(part), : part.shape[1]] = part
        s_eta[: data.n, : len(part)] = s_etas[lo : lo + BATCH].T
        out.append(np.asarray(_answer_batch(problem, theta, s_eta))[: data.n, : len(part)])
        count_followed(1, (data.n * len(part), whole * BATCH))
    return np.concatenate(out, axis=1).swapaxes(0, 1)


def stack_measured(data: FitData) -> NDArray:
    """(n, 2) the table's F_p and d, NaN where there is none."""
    both = np.asarray(data.pushes.measured)[: data.n]
    return both if both.shape[1] == 2 else np.column_stack([np.full(data.n, np.nan), both])


def weigh_residuals(data: FitData, weights: NDArray, answers: NDArray) -> NDArray:
    """(batch, n, m) weighted residuals of answers (batch, n, 2).

    They are NaN where the model gives no number for one that was measured.
    """
    seen = stack_measured(data)
    if weights.shape[1] == 1:
        seen, answers = seen[:, 1:], answers[..., 1:]
    return np.where(weights > 0, weights * (seen - answers), 0.0)
