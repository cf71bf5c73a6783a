"""A push obeys mechanics, whatever the rig: statements that need no reference solution."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import difffric as df
from difffric.simulation.events import Mode
from difffric.simulation.oscillator import Oscillator, ViscousSlide
from difffric.simulation.segments import Push
from difffric.units import GRAVITY
from tests.reference import ode

PAPER = {"mass": 18.9, "mu_s": 0.141, "k": 8.0e5, "b": 1500.0, "k_v": 5.0}

rigs = st.fixed_dictionaries(
    {
        "mass": st.floats(0.5, 50),
        "mu_s": st.floats(0.03, 0.5),
        "k": st.floats(1e4, 1e7),
        "b": st.floats(0, 5e3),
        "k_v": st.floats(0, 100),
        "mu_k_over_mu_s": st.floats(0.4, 1.0),
    }
)
speeds = st.floats(0.002, 0.1)
strokes = st.floats(5e-5, 5e-3)


def follow(rig, velocity):
    return df.simulate(df.spring_damper_rig(**rig), velocity)


@settings(max_examples=60, deadline=None)
@given(rigs, speeds, strokes)
def test_momentum_is_conserved(rig, velocity, stroke):
    """The impulse of contact and friction forces is the change of momentum: m u = int F dt.

    Checked through the equation itself at random instants: m u' = F_contact - friction.
    """
    push = df.simulate(df.spring_damper_rig(**rig, stroke=stroke), velocity)
    if push.reason is not None and "more than" in push.reason:
        return
    t = np.linspace(0, float(push.stop_time), 401)[1:-1]
    h = 1e-6 * float(push.stop_time)
    force, _, speed = (np.asarray(a) for a in push.evaluate(t))
    slope = (np.asarray(push.speed(t + h)) - np.asarray(push.speed(t - h))) / (2 * h)
    mu_k = rig["mu_s"] * rig["mu_k_over_mu_s"]
    balance = force - mu_k * rig["mass"] * GRAVITY - rig["k_v"] * speed
    # Away from events: where the slope is the same a little later.
    edges = np.asarray(push.segments.t)
    edges = edges[np.isfinite(edges)]
    clear = np.abs(t[:, None] - edges).min(axis=1) > 2 * h
    sliding = clear & (speed > 1e-9)
    scale = np.max(np.abs(balance)) + 1.0
    np.testing.assert_allclose(rig["mass"] * slope[sliding], balance[sliding], atol=2e-5 * scale)


@settings(max_examples=60, deadline=None)
@given(rigs, speeds, strokes)
def test_a_push_only_pushes_and_never_goes_back(rig, velocity, stroke):
    push = df.simulate(df.spring_damper_rig(**rig, stroke=stroke), velocity)
    if push.reason is not None and "more than" in push.reason:
        return
    t = np.linspace(-1e-3, 1.2 * float(push.stop_time), 2001)
    force, position, speed = (np.asarray(a) for a in push.evaluate(t))
    assert (force >= -1e-9 * float(push.peak_force)).all()
    assert (speed >= -1e-12).all()
    assert (np.diff(position) >= -1e-15).all()
    assert force.max() <= float(push.peak_force) * (1 + 1e-12)
    assert position[0] == 0 and force[0] == 0


@settings(max_examples=60, deadline=None)
@given(rigs, speeds, strokes)
def test_d_is_the_distance_from_the_last_loss_of_contact_to_rest(rig, velocity, stroke):
    push = df.simulate(df.spring_damper_rig(**rig, stroke=stroke), velocity)
    if push.reason is not None:
        assert np.isnan(float(push.sliding_distance))
        return
    modes, times = (np.asarray(a) for a in (push.segments.mode, push.segments.t))
    used = np.flatnonzero(np.isfinite(times))
    free = used[modes[used] == Mode.FREE]
    # The last run of free segments starts at the last loss of contact.
    last = free[-1]
    while last - 1 in used and (modes[last - 1] == Mode.FREE or times[last - 1] == times[last]):
        last -= 1
    while modes[last] != Mode.FREE:
        last += 1
    x = np.asarray(push.position(np.array([times[last], float(push.stop_time) + 1.0])))
    assert x[1] - x[0] == pytest.approx(float(push.sliding_distance), rel=1e-9, abs=1e-15)


@settings(max_examples=100, deadline=None)
@given(rigs, speeds)
def test_a_rebound_gives_at_most_twice_the_speed(rig, velocity):
    """For mu_k/mu_s of 0.6 and more, d <= 4 v^2 / (2 mu_k g)."""
    rig = {**rig, "mu_k_over_mu_s": max(rig["mu_k_over_mu_s"], 0.6)}
    push = follow(rig, velocity)
    if push.reason is None:
        mu_k = rig["mu_s"] * rig["mu_k_over_mu_s"]
        assert float(push.sliding_distance) <= 4 * velocity**2 / (2 * mu_k * GRAVITY) * (1 + 1e-12)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.05, 3.0), st.floats(0.01, 1.2), st.floats(0.1, 10.0), st.floats(0.5, 20.0))
def test_similarity_with_k_v_zero(epsilon, zeta, mass, stiffness):
    """With k_v = 0 only epsilon, zeta and mu_k/mu_s matter: F_p / F_S and d k / F_S are theirs."""

    def scaled(mass, k, mu_s):
        F_S = mu_s * mass * GRAVITY
        velocity = epsilon * F_S / np.sqrt(k * mass)
        rig = {"mass": mass, "k": k, "mu_s": mu_s, "b": 2 * zeta * np.sqrt(k * mass)}
        push = follow(rig, velocity)
        return push.regime, float(push.peak_force) / F_S, float(push.sliding_distance) * k / F_S

    one, two = scaled(1.0, 1e5, 0.1), scaled(mass, 1e5 * stiffness, 0.2)
    assert one[0] == two[0]
    assert one[1] == pytest.approx(two[1], rel=1e-9)
    assert one[2] == pytest.approx(two[2], rel=1e-6, nan_ok=True)


def test_an_endless_stroke_is_the_missing_one():
    none, endless = (df.spring_damper_rig(**PAPER, stroke=s) for s in (None, np.inf))
    for velocity in (0.01, 0.03, 0.08):
        a, b = df.observe(none, velocity), eqx.filter_jit(df.observe)(endless, velocity)
        assert float(a.peak_force) == pytest.approx(float(b.peak_force), rel=1e-14)
        assert float(a.sliding_distance) == pytest.approx(float(b.sliding_distance), rel=1e-12)


@pytest.mark.parametrize("stroke", [None, 3e-4, 2e-3])
@pytest.mark.parametrize("velocity", [0.01, 0.03, 0.08])
def test_traces_agree_with_an_independent_integration(velocity, stroke):
    push = df.simulate(df.spring_damper_rig(**PAPER, stroke=stroke), velocity)
    t = np.linspace(0, 1.05 * float(push.stop_time), 300)
    edges = np.asarray(push.segments.t)
    t = t[np.abs(t[:, None] - edges[np.isfinite(edges)]).min(axis=1) > 1e-9]
    p = PAPER
    other = ode.push(
        p["mass"], p["mu_s"], 0.75, p["k_v"], p["k"], p["b"], velocity, stroke, times=t
    )
    np.testing.assert_allclose(push.force(t), other.force, atol=1e-8 * float(push.peak_force))
    np.testing.assert_allclose(push.position(t), other.position, atol=1e-14)


def test_traces_differentiate_like_finite_differences():
    t = jnp.linspace(1e-3, 0.03, 7)

    def trace(mu_s):
        push = Push.of(df.spring_damper_rig(**{**PAPER, "mu_s": mu_s}), 0.05)
        return jnp.stack(df.Trajectory.of(push).evaluate(t))

    exact = jax.jit(jax.jacfwd(trace))(0.141)
    h = 1e-6
    differences = (trace(0.141 + h) - trace(0.141 - h)) / (2 * h)
    np.testing.assert_allclose(exact, differences, rtol=1e-6, atol=1e-8)


def test_many_pushes_in_one_vmapped_call():
    velocity = jnp.linspace(0.02, 0.08, 5)
    rig = df.spring_damper_rig(**PAPER)
    t = jnp.linspace(0, 0.05, 11)
    together = jax.jit(jax.vmap(lambda v: df.Trajectory.of(Push.of(rig, v)).force(t)))(velocity)
    alone = np.stack([df.simulate(rig, float(v)).force(t) for v in velocity])
    np.testing.assert_allclose(together, alone, rtol=1e-12)


damping = st.sampled_from([0.0, 1e-9, 1e-3, 0.2, 1 - 1e-9, 1.0, 1 + 1e-9, 1.5, 30.0])


@settings(max_examples=200, deadline=None)
@given(damping, st.floats(-1, 1), st.floats(-1, 1), st.floats(0, 20))
def test_the_oscillator_flows_through_every_damping(zeta, p, dp, t):
    """flow(s) then flow(t - s) is flow(t), and the energy-like form decays exactly."""
    osc = Oscillator(jnp.asarray(zeta), jnp.asarray(1.0))
    whole = osc.flow(p, dp, t)
    half = osc.flow(*osc.flow(p, dp, 0.5 * t), 0.5 * t)
    np.testing.assert_allclose(half, whole, atol=2e-13)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from([0.0, 1e-12, 1e-6, 1e-2, 0.2, 3.0]), st.floats(1e-6, 10.0))
def test_the_slide_ends_at_rest(rate, u):
    slide = ViscousSlide(jnp.asarray(1.0), jnp.asarray(rate))
    t, s = slide.rest(u)
    distance, speed = slide.flow(u, t)
    assert float(distance) == pytest.approx(float(s), rel=1e-12)
    assert abs(float(speed)) <= 1e-13 * max(1.0, u)


def test_32_bits_are_refused():
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(df.InputError, match="jax_enable_x64"):
            df.simulate(df.spring_damper_rig(**PAPER), 0.05)
    finally:
        jax.config.update("jax_enable_x64", True)


@pytest.mark.parametrize("velocity", [0.0, -1.0, np.nan, np.inf, "fast", np.array([0.05, 0.06])])
def test_an_impossible_speed_is_refused(velocity):
    with pytest.raises(df.InputError, match="velocity"):
        df.simulate(df.spring_damper_rig(**PAPER), velocity)


@pytest.mark.parametrize("name", ["mass", "mu_s", "k"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_an_impossible_parameter_is_refused(name, value):
    with pytest.raises(df.InputError, match="expected a number > 0"):
        df.simulate(df.spring_damper_rig(**{**PAPER, name: value}), 0.05)


@pytest.mark.parametrize("answer", [df.fit, df.identify])
def test_an_impossible_rig_is_refused_by_whatever_takes_it(answer):
    pushes = df.Pushes([0.05], [174.0], [3.5e-3], mu_s_gauge=[0.14])
    with pytest.raises(df.InputError, match="expected a number > 0"):
        answer(df.spring_damper_rig(**{**PAPER, "k": -1.0}), pushes)


def test_a_slide_almost_without_friction_is_stopped_by_viscosity():
    """As mu_s vanishes d tends to m u / k_v, and never overflows to nothing."""
    d = [float(df.observe(df.spring_damper_rig(**{**PAPER, "mu_s": mu}), 0.05).sliding_distance)
         for mu in (1e-100, 1e-200)]  # fmt: skip
    assert d[1] == pytest.approx(d[0], rel=1e-9) and d[0] > 0.1


@pytest.mark.parametrize("stroke", [0.0, -1e-3, np.nan])
def test_an_impossible_stroke_is_refused(stroke):
    with pytest.raises(df.InputError, match="stroke"):
        df.simulate(df.spring_damper_rig(**PAPER), 0.05, stroke=stroke)
