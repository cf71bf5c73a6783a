"""The step of a fit of many pushes against the dense matrix, and its search against another."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

from difffric.compute.arrow_jacobian import ArrowJacobian, Evaluation, search_minimum


def _dense(J):
    n, _, P = J.shared.shape
    return np.column_stack([J.apply(x) for x in np.eye(P + J.own.shape[2] * n)])


@pytest.mark.parametrize("own", [1, 2])
def test_the_arrow_is_solved_as_the_dense_matrix(own):
    rng = np.random.default_rng(2)
    n, P, m, damping = 5, 3, 4, 0.01
    J = ArrowJacobian(rng.normal(size=(n, m, P)), rng.normal(size=(n, m, own)), 1.3, np.full(P, 2))
    A, r = _dense(J), rng.normal(size=n * m + n + P)
    expected = np.linalg.solve(A.T @ A + damping * np.eye(A.shape[1]), A.T @ r)
    np.testing.assert_allclose(J.solve(r, damping), expected, rtol=1e-9, atol=1e-12)


def test_the_search_takes_the_steps_of_optimistix():
    t, y = np.linspace(0.1, 2.0, 7), np.array([[1.0, 0.7, 0.6, 0.3, 0.35, 0.2, 0.1]] * 2)

    def rows(x, np):  # two decays with rates of their own, one shared height
        return x[0] * np.exp(-np.exp(x[1:3, None]) * t) - y * np.array([[1.0], [1.2]])

    def penalised(x, np):
        return np.concatenate([rows(x, np).ravel(), 0.1 * x[1:3], 0.1 * (x[:1] - 1.0)])

    def evaluate(x):
        height = np.exp(-np.exp(x[1:3, None]) * t)
        by_rate = -x[0] * height * np.exp(x[1:3, None]) * t
        J = ArrowJacobian(height[:, :, None], by_rate[:, :, None], 0.1, np.full(1, 0.1))
        return Evaluation(penalised(x, np), J, None)

    start, solver = np.array([3.0, 2.0, -2.0]), optx.LevenbergMarquardt(rtol=1e-8, atol=1e-7)
    for most in (2, 4, 8, 60):  # the last: as far as either goes, where rounding decides the end
        x, found, steps = search_minimum(evaluate, start, most)
        theirs = optx.least_squares(
            lambda x, _: penalised(x, jnp), solver, start, max_steps=most, throw=False
        )
        atol = 0.0 if most < 60 else 1e-7
        np.testing.assert_allclose(x, theirs.value, rtol=1e-12 if most < 60 else 1e-8, atol=atol)
        assert abs(steps - int(theirs.stats["num_steps"])) <= 1
    assert found.r @ found.r < 0.2
    assert search_minimum(evaluate, np.full(3, np.nan), 60)[2] == 1


def test_a_step_that_fails_and_promised_no_more_than_it_is_worth_is_the_last():
    def evaluate(x):  # least where the slope jumps: there every step of the linear model fails
        r = np.array([3.0 + abs(x[0]), x[1], 0.0])
        slope = np.full((1, 1, 1), 1.0 if x[0] >= 0 else -1.0)
        return Evaluation(r, ArrowJacobian(slope, np.zeros((1, 1, 1)), 1.0, np.zeros(1)), None)

    steps = [search_minimum(evaluate, np.zeros(2), 60, worth)[2] for worth in (0.0, 1e3)]
    assert steps[1] == 2 < steps[0]
