"""What a push would say before it is made: its answer and its information on the parameters.

Nothing is fitted here. The program that fits is asked for the responses at a point, with weights
of zero, so that a batch of pushes costs milliseconds and compiles nothing that a fit does not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from difffric.estimation.descent import Model, descend, first_point
from difffric.estimation.residuals import SlidePush, TablePush
from difffric.estimation.stacked_data import SLIDES, TABLE, FitData, find_strokes, pad
from difffric.measurements.pushes import Pushes
from difffric.rig.rig import Rig


def design_data(rig: Rig, pushes: Pushes) -> tuple[Rig, FitData]:
    """The data of pushes, or of free slides, of which nothing was measured yet; and the rig, with a
    stroke where one of them has one."""
    n = len(pushes)
    if pushes.free_slides:
        kind, made = SLIDES, SlidePush(pushes.release_velocity, np.ones((n, 1)))
    else:
        rig, strokes = find_strokes(rig, pushes.stroke)
        kind, made = TABLE, TablePush(pushes.velocity, strokes, np.ones((n, 2)))
    m, none = len(made.channels), np.zeros(0)
    return rig, FitData(
        kind=kind,
        pushes=pad(made, n),
        n=n,
        weights=np.zeros((n, m)),
        group=np.full((n, m), -1),
        groups=(),
        counts=none,
        least=none,
        samples=0,
        guess=none,
        rough=np.zeros((n, m)),
    )


def responses(
    model: Model, data: FitData, theta: NDArray, pushes: Any, fixed: NDArray, selection: NDArray
) -> tuple[NDArray, NDArray]:
    """Derivatives (n, rows, coordinates) of the answers, and the answers F_p, d (n, 2), of n
    pushes of the data's kind at the shared coordinates `theta`.

    `pushes` are stacked as the data's are, `fixed` (n, coordinates) and `selection`
    (n, coordinates, free) as in a `Layout`. They go in batches as large as the data.
    """
    n, whole = len(fixed), jax.tree.leaves(data.pushes)[0].shape[0]
    rows, answers = [], []
    for i in range(0, n, whole):
        index = np.minimum(np.arange(i, i + whole), n - 1)
        batch = jax.tree.map(lambda a, index=index: jnp.asarray(np.asarray(a)[index]), pushes)
        weights = np.zeros((whole, data.weights.shape[1]))
        layout = replace(model.layout, selection=selection[index], fixed=fixed[index])
        model_ = replace(model, layout=layout)
        data_ = replace(data, pushes=batch, n=whole, weights=weights)
        at = first_point(model_, data_, theta)
        held = np.ones(len(theta), bool)
        end = descend(model_, data_, at, held, weights, 0.0, 1.0, steps=1)
        rows.append(np.asarray(end.rows)[..., :-1])
        answers.append(np.asarray(end.model))
    return np.concatenate(rows)[:n], np.concatenate(answers)[:n]


def information(
    derivatives: NDArray,
    weights: NDArray,
    selection: NDArray,
    scatter: float,
    free_start: bool = False,
) -> NDArray:
    """What each push adds to the information (n, free, free) on the shared coordinates.

    `derivatives` (n, rows, coordinates) and their `weights` (n, rows), 1 / standard deviation.
    The push's own mu_s, under the scatter, and its start offset are marginalised.
    """
    J = derivatives * weights[..., None]
    X, z, start = J @ selection, J[..., 0], J[..., -1]
    if free_start:
        size = np.einsum("nm,nm->n", start, start)
        unit = start / np.sqrt(np.where(size > 0, size, 1.0))[:, None]
        X = X - unit[..., None] * np.einsum("nm,nmp->np", unit, X)[:, None, :]
        z = z - unit * np.einsum("nm,nm->n", unit, z)[:, None]
    own = scatter**2 / (1.0 + scatter**2 * np.einsum("nm,nm->n", z, z))
    shared = np.einsum("nm,nmp->np", z, X)
    return np.einsum("nmp,nmq->npq", X, X) - np.einsum("n,np,nq->npq", own, shared, shared)
