"""How two optima are compared: each push's own mu_s integrated out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

import difffric as df
from difffric.calibration.marginal.marginal_likelihood import minus_2_log_likelihood
from difffric.calibration.marginal.push_integrals import integrate_pieces
from tests.reference import data as reference


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_the_integral_over_a_line_of_residuals_is_exact(seed):
    rng = np.random.default_rng(seed)
    grid = np.sort(rng.uniform(-3, 3, 6))[:, None]
    r = rng.normal(0, 3, (6, 1, 2))

    def density(x):
        at = [np.interp(x, grid[:, 0], r[:, 0, j]) for j in range(2)]
        return np.exp(-0.5 * np.sum(np.square(at))) / np.sqrt(2 * np.pi)

    pieces = zip(grid[:-1, 0], grid[1:, 0], strict=True)
    total = sum(quad(density, a, b, epsabs=0, epsrel=1e-10)[0] for a, b in pieces)
    assert integrate_pieces(grid, r).log[0] == pytest.approx(np.log(total), abs=1e-7)


def test_where_the_model_is_smooth_the_linear_likelihood_is_the_integral():
    rng = np.random.default_rng(4)
    rig = reference.Rig(
        m=18.9, mu_s=0.14, ratio=0.75, k_v=8.0, k=8e5, b=1500.0, scatter=0.02, stroke=2e-3
    )
    fast = [p for p in reference.make_pushes(rig, rng) if p.velocity > 0.03]
    rough = df.spring_damper_rig(mass=rig.m, mu_s=0.16, k=7e5, b=1800.0, k_v=5.0)
    fit = df.fit(rough, df.Pushes(**reference.measure(fast, rng)))
    model, data, at = fit.state.model, fit.state.data, fit.state.at
    assert data.n >= 5 and at.scatter > 0.005
    rows = np.asarray(at.end.rows)[: data.n] * at.weights[..., None]
    z, r = rows[..., 0], rows[..., -1]
    shared = r - z * at.s_eta[:, None]  # the residuals at the shared mu_s
    linear = 0.0
    for x, slope in zip(shared, z, strict=True):
        V = np.eye(2) + at.scatter**2 * np.outer(slope, slope)
        linear += x @ np.linalg.solve(V, x) + np.linalg.slogdet(V)[1]
    assert minus_2_log_likelihood(model, data, at) == pytest.approx(linear, abs=0.2)
