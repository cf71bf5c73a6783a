"""The solver of a step's normal equations against the dense matrix."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest

from difffric.compute.levenberg_marquardt import ArrowSolver
from difffric.estimation.mixed_model import FitPoint


@pytest.mark.parametrize("starts", [0, 5])
def test_the_arrow_is_solved_as_the_dense_matrix(starts):
    rng = np.random.default_rng(2)
    n, P, m = 5, 3, 4
    A, z, t = rng.normal(size=(n, m, P)), rng.normal(size=(n, m)), rng.normal(size=(n, m))

    def apply(x):
        rows = jnp.einsum("nmp,p->nm", A, x.theta) + z * x.eta[:, None]
        if starts:
            rows = rows + t * x.start[:, None]
        damped = jax.tree.map(lambda part: 0.1 * part, x)
        return (rows, x.eta, 2.0 * x.theta), damped

    x = FitPoint(jnp.zeros(P), jnp.zeros(n), jnp.zeros(starts))
    operator = lx.FunctionLinearOperator(apply, jax.eval_shape(lambda: x))
    shape = jax.eval_shape(apply, x)
    b = jax.tree.map(lambda part: jnp.asarray(rng.normal(size=part.shape)), shape)
    found = lx.linear_solve(operator, b, ArrowSolver()).value
    expected = lx.linear_solve(operator, b, lx.QR()).value
    for mine, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-12)
