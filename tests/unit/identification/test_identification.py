"""Simulate, invert: mu_s comes back; where it cannot, the reason does."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difffric as df
from difffric.compute import pytrees
from difffric.identification.crossing import find_crossing
from difffric.identification.inversion import BRACKET, FLAT, invert
from difffric.rig import parameters
from difffric.simulation.sensitivities import regime_margin, sensitivity

PAPER = {"mass": 18.9, "mu_s": 0.141, "k": 8.0e5, "b": 1500.0, "k_v": 5.0}
QUANTITIES = ("peak_force", "sliding_distance")
rng = np.random.default_rng(7)


def random_rigs(n, stroke):
    """n random rigs around the paper's, with speeds [m/s]."""
    mass, k = rng.uniform(1, 40, n), np.exp(rng.uniform(np.log(1e5), np.log(5e6), n))
    zeta, mu_s = rng.uniform(0.02, 0.9, n), rng.uniform(0.05, 0.4, n)
    rig = df.spring_damper_rig(
        mass=jnp.array(mass),
        mu_s=jnp.array(mu_s),
        k=jnp.array(k),
        b=jnp.array(2 * zeta * np.sqrt(k * mass)),
        k_v=jnp.array(rng.uniform(0, 50, n)),
        mu_k_over_mu_s=jnp.full(n, 0.75),
        stroke=None if stroke is None else jnp.array(rng.uniform(*stroke, n)),
    )
    return pytrees.replicate(rig, n), rng.uniform(0.008, 0.09, n), mu_s


@pytest.mark.parametrize("stroke", [None, (3e-4, 2.5e-3)], ids=["no stroke", "stroke"])
def test_round_trip_to_1e_9_wherever_the_quantity_determines_mu_s(stroke):
    rigs, velocity, mu_s = random_rigs(300 if stroke is None else 100, stroke)
    point = eqx.filter_jit(eqx.filter_vmap(sensitivity))(rigs, velocity)
    for quantity in QUANTITIES:
        measured = np.asarray(getattr(point.observables, quantity))
        slope = np.asarray(getattr(point, quantity)["mu_s"])
        exists = np.isfinite(measured)
        answers = invert(rigs, velocity, np.where(exists, measured, np.nan), quantity)
        determined = exists & (np.abs(slope * mu_s) > 1e-6 * np.nan_to_num(measured))
        assert determined.sum() > 0.5 * exists.sum()
        for i in np.flatnonzero(determined):
            assert answers[i].value is not None, (quantity, i, answers[i].reason)
            all_roots = np.array(answers[i].alternatives or (answers[i].value,))
            assert np.abs(all_roots / mu_s[i] - 1).min() < 1e-9
        for i in np.flatnonzero(exists & (np.abs(slope * mu_s) < FLAT * np.nan_to_num(measured))):
            assert answers[i].value is None
            assert "does not depend on mu_s" in answers[i].reason


def test_every_root_gives_the_measured_distance():
    """With a 2 mm stroke d is not monotone in mu_s; each alternative is a true solution."""
    rig = pytrees.replicate(df.spring_damper_rig(**PAPER, stroke=2e-3), 40)
    velocity = np.linspace(0.013, 0.025, 40)
    mu_s = rng.uniform(0.05, 0.3, 40)
    observe = eqx.filter_jit(eqx.filter_vmap(df.observe))
    d = np.asarray(observe(parameters.with_values(rig, {"mu_s": mu_s}), velocity).sliding_distance)
    answers = invert(rig, velocity, d, "sliding_distance")
    assert max(len(a.alternatives) for a in answers) >= 3
    for a, v, target in zip(answers, velocity, d, strict=True):
        roots = jnp.array(a.alternatives)
        if not len(roots):
            continue
        copies = parameters.with_values(
            pytrees.pick(rig, np.zeros(len(roots), int)), {"mu_s": roots}
        )
        again = np.asarray(observe(copies, jnp.full(len(roots), v)).sliding_distance)
        np.testing.assert_allclose(again, target, rtol=1e-8)


def test_the_root_that_the_force_supports_is_taken():
    rig = df.spring_damper_rig(**PAPER, stroke=2e-3)
    velocity, truth = np.linspace(0.013, 0.025, 30), rng.uniform(0.06, 0.3, 30)
    rigs = parameters.with_values(pytrees.replicate(rig, 30), {"mu_s": truth})
    seen = eqx.filter_jit(eqx.filter_vmap(df.observe))(rigs, velocity)
    d = np.asarray(seen.sliding_distance)
    some = np.isfinite(d)
    pushes = df.Pushes(
        velocity[some], np.asarray(seen.peak_force)[some], d[some],
        peak_force_se=np.full(some.sum(), 0.5), sliding_distance_se=np.full(some.sum(), 1e-6),
    )  # fmt: skip
    answers = df.identify(rig, pushes)
    assert sum(len(a.alternatives) > 1 for a in answers) >= 3
    for a, mu_s in zip(answers, truth[some], strict=True):
        assert a.mu_s_distance.value == pytest.approx(mu_s, rel=1e-8)


@pytest.mark.parametrize(
    ("quantity", "target", "says"),
    [
        ("peak_force", 1.0, "below the least"),
        ("peak_force", 1e4, "above the most"),
        ("sliding_distance", 10.0, "above the most"),
        ("sliding_distance", 1e-7, "below the least"),
    ],
)
def test_a_value_that_no_mu_s_gives_returns_the_bound_it_breaks(quantity, target, says):
    (answer,) = invert(
        pytrees.replicate(df.spring_damper_rig(**PAPER), 1), [0.05], [target], quantity
    )
    assert answer.value is None and says in answer.reason


def test_optimistix_root_differentiates_by_the_implicit_function():
    rig = df.spring_damper_rig(**PAPER)

    def mu_s(F):
        return find_crossing(rig, 0.05, F, True, BRACKET, True).mu_s

    F = df.observe(rig, 0.05).peak_force
    slope = sensitivity(rig, 0.05).peak_force["mu_s"]
    assert float(jax.jit(jax.jacfwd(mu_s))(F)) == pytest.approx(1 / float(slope), rel=1e-9)


def test_errors_and_weights_of_one_push():
    """The optimum is inverse variance; (7)'s weights are magnitudes that sum to one; both errors
    follow from the exact derivatives."""
    rig = df.spring_damper_rig(**PAPER)
    point = sensitivity(rig, 0.05)
    F, d = (float(getattr(point.observables, q)) for q in QUANTITIES)
    pushes = df.Pushes(
        [0.05], [F + 1.0], [d + 5e-5], peak_force_se=[0.7], sliding_distance_se=[3e-5]
    )
    (answer,) = df.identify(rig, pushes, range_ratio=4e4)
    s = [answer.mu_s_force.standard_error, answer.mu_s_distance.standard_error]
    assert s[0] == pytest.approx(0.7 / float(point.peak_force["mu_s"]), rel=0.05)
    w = np.array([s[0] ** -2, s[1] ** -2]) / (s[0] ** -2 + s[1] ** -2)
    mu = np.array([answer.mu_s_force.value, answer.mu_s_distance.value])
    assert answer.mu_s_optimal.value == pytest.approx(w @ mu, rel=1e-12)
    assert answer.mu_s_optimal.standard_error == pytest.approx((s[0] ** -2 + s[1] ** -2) ** -0.5)
    w_7 = np.array([answer.weights["force"], answer.weights["distance"]])
    assert w_7.sum() == pytest.approx(1.0) and (w_7 > 0).all()
    assert answer.mu_s_weighted.value == pytest.approx(w_7 @ mu, rel=1e-12)
    assert answer.mu_s_weighted.standard_error == pytest.approx(np.hypot(*(w_7 * s)), rel=1e-12)


def test_stated_errors_are_the_scatter_of_repeated_pushes():
    """2000 noisy pushes: the standard deviation of each estimate is its standard error."""
    rig, n = df.spring_damper_rig(**PAPER), 2000
    seen = df.observe(rig, 0.05)
    F = float(seen.peak_force) + 0.5 * rng.standard_normal(n)
    d = float(seen.sliding_distance) + 2e-5 * rng.standard_normal(n)
    se = {"peak_force_se": np.full(n, 0.5), "sliding_distance_se": np.full(n, 2e-5)}
    answers = df.identify(rig, df.Pushes(np.full(n, 0.05), F, d, **se))
    for name in ("mu_s_force", "mu_s_distance", "mu_s_weighted", "mu_s_optimal"):
        values = np.array([getattr(a, name).value for a in answers])
        stated = np.mean([getattr(a, name).standard_error for a in answers])
        assert values.std() == pytest.approx(stated, rel=0.1)  # 6 standard deviations
        assert abs(values.mean() - 0.141) < 4 * stated / np.sqrt(n) + 1e-5


def test_margin_is_the_distance_to_the_slip_edge():
    """Where b v = mu_s F_N the part changes between sticking first and slipping at once."""
    rig = df.spring_damper_rig(**PAPER)
    edge = 1500.0 * 0.05 / float(rig.F_N)
    for relative, side in ((0.2, "both"), (5e-4, "left"), (-5e-4, "right")):
        mu_s = edge / (1 + relative)
        margin = regime_margin(parameters.with_values(rig, {"mu_s": mu_s}), 0.05)
        assert margin.side == side
        assert margin.margin == pytest.approx(abs(relative), rel=1e-5)


def test_unknown_noise_gives_no_error_bar_and_no_optimum():
    pushes = df.Pushes([0.05], [174.0], [3.5e-3])
    (answer,) = df.identify(df.spring_damper_rig(**PAPER), pushes)
    assert answer.mu_s_force.value is not None and answer.mu_s_force.standard_error is None
    assert answer.mu_s_optimal.value is None and "noise" in answer.reason


def test_calibration_finds_the_rig_from_a_start_a_factor_of_three_off():
    truth = df.spring_damper_rig(**PAPER)
    v, mu_s = np.tile(np.linspace(0.015, 0.08, 8), 2), np.repeat([0.12, 0.2], 8)
    rigs = parameters.with_values(pytrees.replicate(truth, 16), {"mu_s": mu_s})
    seen = jax.vmap(df.observe)(rigs, jnp.asarray(v))
    F = np.asarray(seen.peak_force) + 0.5 * rng.standard_normal(16)
    d = np.asarray(seen.sliding_distance) + 1e-6 * rng.standard_normal(16)
    start = df.spring_damper_rig(**{**PAPER, "k": 2.5e6, "b": 550.0, "k_v": 20.0})
    fit = df.fit(start, df.Pushes(v, F, d, mu_s_gauge=mu_s))
    assert fit.converged
    for name, exact in (("k_N_per_m", 8e5), ("b_N_s_per_m", 1500.0), ("k_v_N_s_per_m", 5.0)):
        assert abs(fit.value(name) - exact) < 4 * fit.standard_error(name)
        assert fit.standard_error(name) < 0.3 * exact
    assert 0.25 < fit.spread_force < 0.9
    assert 0.5e-6 < fit.spread_distance < 1.8e-6


@pytest.mark.parametrize("free", [(), ("k",)])
def test_a_calibration_refuses_what_it_cannot_free(free):
    pushes = df.Pushes([0.05], [174.0], [3.5e-3], mu_s_gauge=[0.14])
    with pytest.raises(df.InputError, match=r"free: .*some of mu_s, mu_k_over_mu_s"):
        df.fit(df.spring_damper_rig(**PAPER), pushes, free=free)


@pytest.mark.parametrize("name", ["peak_force", "mu_s_gauge", "peak_force_se", "stroke"])
def test_measurements_must_be_positive(name):
    with pytest.raises(df.InputError, match=f"{name} of push 1 is -1.0: expected > 0"):
        df.Pushes([0.05, 0.05], **{name: [1.0, -1.0]})


def test_a_spread_that_was_not_estimated_is_not_used():
    """Fitted on distances alone, nothing is known of the force: no error bar and no optimum."""
    rig = df.spring_damper_rig(**PAPER)
    v = np.linspace(0.02, 0.08, 6)
    d = [
        float(df.observe(rig, x).sliding_distance) * (1 + 0.01 * (-1) ** i) for i, x in enumerate(v)
    ]
    fit = df.fit(rig, df.Pushes(v, None, d, mu_s_gauge=np.full(6, 0.141)), free=("b_N_s_per_m",))
    assert np.isnan(fit.spread_force) and fit.spread_distance > 0
    (answer,) = df.identify(fit, df.Pushes([0.05], [174.0], [3.5e-3]))
    assert answer.mu_s_force.standard_error is None and answer.mu_s_optimal.value is None
    assert "noise" in answer.reason
