"""The likelihood with each push's own mu_s integrated out, and the optimum that it has."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

import difffric as df
from difffric.calibration.marginal.marginal_likelihood import (
    MarginalLikelihood,
    minus_2_log_likelihood,
)
from difffric.calibration.marginal.push_integrals import integrate_pieces
from difffric.calibration.profiles import profile
from difffric.rig.setup import Extras, Setup
from studies.slides import GUESS, TRUTH, make_slides
from tests.reference import data as reference

EXAMPLES = Path(__file__).parents[3] / "examples"


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


def test_the_pull_of_residuals_is_the_derivative_of_the_integral():
    rng = np.random.default_rng(3)
    grid = np.sort(rng.uniform(-3, 3, (7, 4)), axis=0)
    # From pieces along which hardly anything changes to those with the peak inside.
    r = rng.normal(0, 1, (7, 4, 3)) * [1e-6, 1.0, 30.0]
    found, h = integrate_pieces(grid, r), 1e-5
    for k in range(7):
        for row in range(3):
            step = np.zeros_like(r)
            step[k, :, row] = h
            change = integrate_pieces(grid, r + step).log - integrate_pieces(grid, r - step).log
            assert found.pull[k, :, row] == pytest.approx(-change / (2 * h), abs=1e-5)
    assert found.share.sum(axis=0) == pytest.approx(1.0)


@pytest.mark.parametrize("spreads", ["given", "estimated"])
def test_fishers_identity_gives_the_slope_of_the_likelihood(spreads):
    data = make_slides(1, 60, 0.057)
    if spreads == "estimated":
        data = replace(data, sliding_distance_se=None, release_velocity_se=None)
    fit = df.fit(GUESS, data)
    state, P = fit.state, len(fit.free)
    likelihood = MarginalLikelihood(state.model, state.data, state.at)
    # Away from the optimum, where the slope is not zero.
    x = np.concatenate([fit.theta, [np.log(fit.scatter)], np.log(state.at.spreads)])
    size = np.concatenate([np.sqrt(np.diag(fit.covariance)), np.full(len(x) - P, 0.1)])
    x = x + size

    def look(x):
        return likelihood.evaluate(x[:P], np.exp(x[P]), np.exp(x[P + 1 :]))

    slope = look(x).gradient * size
    for j in range(len(x)):
        step = np.zeros_like(x)
        step[j] = 0.1 * size[j]
        rise = look(x + step).value - look(x - step).value
        assert slope[j] == pytest.approx(rise / 0.2, abs=0.02)


def test_scatter_of_friction_does_not_hide_its_rise_with_speed():
    """The joint mode of k_v and each slide's own mu_s gives a quarter of it."""
    fits = [df.fit(GUESS, make_slides(seed, 402, 0.057)) for seed in range(4)]
    found = np.array([fit.value("k_v_N_s_per_m") for fit in fits])
    errors = [fit.standard_error("k_v_N_s_per_m") for fit in fits]
    assert all(fit.converged for fit in fits)
    assert found.mean() == pytest.approx(TRUTH.k_v, abs=2.5 * np.mean(errors) / np.sqrt(4))
    ends = profile(fits[0], ["k_v_N_s_per_m"])["k_v_N_s_per_m"]
    assert ends.note is None
    assert ends.intervals[0.95] == pytest.approx(ends.gaussian[0.95], abs=0.1 * errors[0])


def test_without_a_scatter_the_mode_is_the_optimum():
    def fit_at(scatter):
        known = {"friction.mu_s_scatter": Extras(free=False)}
        return df.fit(Setup(GUESS, scatter, known), make_slides(2, 40, 0.0))

    mode, optimum = fit_at(0.0), fit_at(1e-5)
    size = np.sqrt(np.diag(mode.covariance))
    assert optimum.theta / size == pytest.approx(mode.theta / size, abs=0.01)
    assert optimum.covariance == pytest.approx(mode.covariance, rel=0.01)


def test_an_estimated_spread_as_large_as_the_distances_is_told():
    made = make_slides(1, 60, 0.03)
    shuffled = np.random.default_rng(0).permutation(made.sliding_distance)
    unknown = {"sliding_distance_se": None, "release_velocity_se": None}
    fit = df.fit(GUESS, replace(made, sliding_distance=shuffled, **unknown))
    assert any("the spread of d was estimated as" in note for note in fit.notes)
    (note,) = df.fit(GUESS, replace(made, **unknown)).notes
    assert note.startswith("free slides tell mu_k alone")


@pytest.mark.slow
def test_a_rounding_does_not_change_where_a_fit_ends():
    setup, pushes = df.load_setup(EXAMPLES / "setup.toml"), df.load(EXAMPLES / "pushes.csv")
    fits = [
        df.fit(setup, replace(pushes, velocity=pushes.velocity * (1 + rounding)))
        for rounding in (0.0, 1e-12, -1e-12)
    ]
    size = np.sqrt(np.diag(fits[0].covariance))
    for fit in fits:
        assert fit.theta / size == pytest.approx(fits[0].theta / size, abs=0.02)
        assert np.sqrt(np.diag(fit.covariance)) == pytest.approx(size, rel=0.03)
