"""The criterion of the variances against the dense model."""

from __future__ import annotations

import numpy as np
import pytest

from difffric.estimation import restricted_likelihood


def test_the_criterion_is_the_restricted_likelihood_of_the_dense_model():
    """-2 log L_R = log|V| + log|X' V^-1 X| + r' P r with V = R + s^2 Z Z'."""
    rng = np.random.default_rng(1)
    n, P = 6, 2
    J = rng.normal(size=(n, 2, 4))
    selection = np.zeros((n, 4, P))
    selection[:, 0, 0] = selection[:, 2, 1] = 1.0
    r, s_eta, group = rng.normal(size=(n, 2)), rng.normal(size=n), np.tile([0, -1], (n, 1))
    rows, weights = np.concatenate([J, r[..., None]], axis=2), np.tile([1.0, 2.0], (n, 1))
    linear = restricted_likelihood.linearise(
        rows, weights, group, [n], [1e-6], selection, np.zeros((3, 3)), s_eta, False
    )
    s, spread = 0.3, 0.7
    found, X, Xr, rr = linear.evaluate(s, np.array([spread]))
    sd = np.tile([spread, 0.5], n)
    Z = np.zeros((2 * n, n))
    for i in range(n):
        Z[2 * i : 2 * i + 2, i] = J[i, :, 0]
    V = np.diag(sd**2) + s**2 * Z @ Z.T
    design = (J @ selection).reshape(2 * n, P)
    y = r.ravel() - Z @ s_eta
    inverse = np.linalg.inv(V)
    information = design.T @ inverse @ design
    fitted = design.T @ inverse @ y
    expected = (
        np.linalg.slogdet(V)[1]
        - n * np.log(0.25)  # of the known rows: a constant that is left out
        + np.linalg.slogdet(information)[1]
        + y @ inverse @ y
        - fitted @ np.linalg.solve(information, fitted)
    )
    assert found == pytest.approx(expected, rel=1e-10)
    np.testing.assert_allclose(X, information, rtol=1e-10)
    np.testing.assert_allclose(Xr, fitted, rtol=1e-10)
    assert rr == pytest.approx(y @ inverse @ y, rel=1e-10)
