"""Pushes stepped by NumPy are those of the closed form and of the compiled stepper."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difffric as df
from difffric.compute.lanes import differentiate, spread
from difffric.rig import catalogue, parameters
from difffric.simulation.closed_form import ClosedForm
from difffric.simulation.columns import differentiate_columns, observe_columns, serves
from difffric.simulation.observables import observe_segments
from difffric.simulation.segments import Push
from difffric.simulation.stepping.stepped_legs import SteppedLegs

N = 300


def _draw(effects, *, stroke=None, n=N):
    """(rig of columns, speeds) of random pushes, slow and fast, of contacts damped and not."""
    rng = np.random.default_rng(7)
    base = df.spring_damper_rig(
        mass=18.9,
        mu_s=rng.uniform(0.08, 0.25, n),
        k=rng.uniform(4e5, 9e5, n),
        b=rng.uniform(0, 2500, n) * (rng.random(n) > 0.4),
        k_v=rng.uniform(0, 30, n),
        stroke=stroke,
    )
    sizes = {
        "stribeck": {"v_s_m_per_s": rng.uniform(0.003, 0.1, n)},
        "quadratic_drag": {"c_N_s2_per_m2": rng.uniform(0, 500, n)},
        "rebound_damping": {"b_N_s_per_m": rng.uniform(0, 4000, n)},
        "release_latch": {"threshold_N": rng.uniform(3, 40, n)},
        "pusher_duration": {"duration_s": rng.uniform(0.03, 0.06, n)},
    }
    return catalogue.extended(base, {e: sizes[e] for e in effects}), rng.uniform(0.008, 0.085, n)


def _follow(rig, v, legs):
    with np.errstate(all="ignore"):
        push = Push(rig, spread(rig.pusher.speed(v), len(v)), legs)
        return spread(observe_segments(push, push.last_state()), len(v))


def _assert_same_course(stepped, exact):
    """Regimes, contacts, halts and the contact of the peak are the same. Before a slow tip a part
    sticks and slips to peaks that are equal but for rounding: which counts is left open there."""
    np.testing.assert_array_equal(stepped.kind >> 10, exact.kind >> 10)
    few = exact.contacts < 3
    np.testing.assert_array_equal(stepped.kind[few], exact.kind[few])
    assert np.mean(stepped.kind != exact.kind) < 0.01


ALL = ("rebound_damping", "release_latch", "pusher_duration")


@pytest.mark.parametrize(
    ("effects", "stroke"),
    [((), None), ((), 2e-3), (("rebound_damping",), 2e-3), (ALL, None)],
    ids=["once", "stroke", "rebound", "all"],
)
def test_steps_through_affine_laws_lead_where_the_closed_form_does(effects, stroke):
    rig, v = _draw(effects, stroke=stroke)
    exact, stepped = (_follow(rig, v, legs) for legs in (ClosedForm(), SteppedLegs()))
    _assert_same_course(stepped, exact)
    np.testing.assert_allclose(stepped.peak_force, exact.peak_force, rtol=1e-7)
    np.testing.assert_allclose(
        stepped.sliding_distance, exact.sliding_distance, rtol=2e-5, atol=1e-10
    )


@pytest.mark.parametrize("name", ["mu_s", "k_N_per_m", "mass_kg", "rebound_damping.b_N_s_per_m"])
def test_so_do_their_first_derivatives(name):
    rig, v = _draw(ALL, n=60)

    def slope(legs):
        def at(value):
            return _follow(parameters.with_values(rig, {name: value}), v, legs)

        given = np.asarray(parameters.values(rig)[name]) + 0 * v
        by = differentiate(at, given, np.ones((1, 1)))[1]
        return np.stack([np.broadcast_to(x, (1, 60))[0] for x in by[:2]])

    exact, stepped = slope(ClosedForm()), slope(SteppedLegs())
    size = np.maximum(np.nanmax(np.abs(exact), axis=1, keepdims=True), 1e-12)
    np.testing.assert_allclose(stepped / size, exact / size, atol=1e-5)


@pytest.mark.parametrize(
    ("effects", "stroke"),
    [
        (("stribeck",), None),
        (("quadratic_drag", "rebound_damping"), 2e-3),
        (("stribeck", *ALL), None),
    ],
    ids=["stribeck", "drag", "all"],
)
def test_friction_that_bends_with_the_speed_is_that_of_the_compiled_stepper(effects, stroke):
    """With a latch too: a tip that stops may let a damped rebound go at once, at any force."""
    rig, v = _draw(effects, stroke=stroke, n=100)
    assert serves(rig) and not rig.affine
    columns = observe_columns(rig, v)
    lanes = jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x, float), v.shape), rig)
    theirs = jax.jit(jax.vmap(df.observe))(lanes, jnp.asarray(v))
    np.testing.assert_array_equal(columns.regime, theirs.regime)
    np.testing.assert_array_equal(columns.contacts, theirs.contacts)
    np.testing.assert_allclose(columns.peak_force, theirs.peak_force, rtol=1e-6)
    np.testing.assert_allclose(
        columns.sliding_distance, theirs.sliding_distance, rtol=2e-5, atol=1e-10
    )


@pytest.mark.parametrize("name", ["stribeck.v_s_m_per_s", "mu_s", "pusher_duration.duration_s"])
def test_derivatives_are_those_of_differences(name):
    rig, v = _draw(("stribeck", *ALL), n=60)
    seen, by = differentiate_columns(rig, v, [name])
    value = np.asarray(parameters.values(rig)[name]) + 0 * v
    h = 1e-3 * value
    at = [
        observe_columns(parameters.with_values(rig, {name: value + s * h}), v)
        for s in (2, 1, -1, -2)
    ]
    smooth = np.all([one.kind == seen.kind for one in at], axis=0)
    assert smooth.mean() > 0.9
    for number, slope in (("peak_force", by.peak_force), ("sliding_distance", by.sliding_distance)):
        a, b, c, d = (getattr(one, number) for one in at)
        differences = (-a + 8 * b - 8 * c + d) / (12 * h)
        least = 1e-3 * np.nanmax(getattr(seen, number)) / value.max()
        size = max(np.nanmax(np.abs(slope)), least)
        both = smooth & np.isfinite(differences)
        np.testing.assert_allclose(slope[0][both] / size, differences[both] / size, atol=5e-4)


def test_a_null_size_is_the_law_without_the_effect():
    plain, v = _draw((), stroke=2e-3)
    for effect in ("stribeck", "quadratic_drag"):
        null = _follow(catalogue.extended(plain, {effect: {}}), v, SteppedLegs())
        without = _follow(plain, v, ClosedForm())
        np.testing.assert_allclose(null.peak_force, without.peak_force, rtol=1e-7)
        _assert_same_course(null, without)


@pytest.mark.parametrize(
    "effect",
    ["friction_waviness", "friction_patch", "presliding", "contact_hardening", "pusher_lag"],
)
def test_what_cannot_be_stepped_through_is_left_to_the_compiled_stepper(effect):
    rig = catalogue.extended(
        df.spring_damper_rig(mass=18.9, mu_s=0.1, k=8e5, b=500.0), {effect: {}}
    )
    assert not serves(rig)
    with pytest.raises(df.InputError, match="stepped legs need"):
        SteppedLegs().check(rig)


def test_a_latch_counts_where_the_part_rests_in_contact():
    """A latch closes at the first fall of the force, and counts whatever follows."""
    rig = df.spring_damper_rig(mass=18.9, mu_s=0.141, k=5.2e5, b=0.0)
    found = {"rebound_damping": {"b_N_s_per_m": 2400.0}, "pusher_duration": {"duration_s": 0.0496}}
    latch = {"release_latch": {"threshold_N": 25.0}}
    v = 500 / 60e3
    without = observe_columns(catalogue.extended(rig, found), v)
    counted = observe_columns(catalogue.extended(rig, {**found, **latch}), v)
    assert np.isnan(without.sliding_distance) == (without.reason != 0)
    assert counted.sliding_distance > 0 and counted.reason == 0
