"""A loss on rebound in closed form: stored reference pushes, and the integrator in steps."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from difffric.rig import catalogue
from difffric.rig.rig import spring_damper_rig
from difffric.simulation.columns import VELOCITY, differentiate_columns, serves
from difffric.simulation.events import Regime
from difffric.simulation.observables import observe
from difffric.simulation.stepping.integrator import RungeKutta
from difffric.simulation.trajectory import simulate
from tests.reference import effect_cases

NAMES = {
    "mu_s": "mu_s",
    "mu_k_over_mu_s": "mu_k_over_mu_s",
    "k_v_N_s_per_m": "k_v_N_s_per_m",
    "k_N_per_m": "k_N_per_m",
    "b_N_s_per_m": "b_N_s_per_m",
    "mass_kg": "mass_kg",
    "rebound_damping.b_N_s_per_m": "rebound_damping.b_N_s_per_m",
    VELOCITY: "velocity_m_per_s",
}
"""name in the library -> name in the reference"""
CASES = [case for case in effect_cases.load() if case.group == "rebound_damping"]


def make_rig(at):
    """A rig whose numbers are what `at` says of the reference's names."""
    rig = spring_damper_rig(
        mass=at("mass_kg"),
        mu_s=at("mu_s"),
        mu_k_over_mu_s=at("mu_k_over_mu_s"),
        k=at("k_N_per_m"),
        b=at("b_N_s_per_m"),
        k_v=at("k_v_N_s_per_m"),
        stroke=at("stroke_m"),
    )
    name = "rebound_damping.b_N_s_per_m"
    return catalogue.extended(rig, {"rebound_damping": {"b_N_s_per_m": at(name)}})


def read_column(name):
    missing = np.inf if name == "stroke_m" else 0.0
    return np.array([case.rig.get(name, missing) for case in CASES])


@pytest.fixture(scope="module")
def found():
    """All stored pushes, with their derivatives, by NumPy."""
    rig = make_rig(read_column)
    assert rig.affine and serves(rig)
    return differentiate_columns(rig, read_column("velocity_m_per_s"), list(NAMES))


def test_the_course_is_the_reference_s(found):
    seen, _ = found
    words = np.array([regime.word for regime in Regime])
    assert words[seen.regime].tolist() == [case.regime for case in CASES]
    assert seen.contacts.tolist() == [case.contacts for case in CASES]


def test_force_and_distance_are_the_reference_s(found):
    seen, _ = found
    d = np.array([np.nan if c.sliding_distance is None else c.sliding_distance for c in CASES])
    np.testing.assert_allclose(seen.peak_force, [c.peak_force for c in CASES], rtol=1e-9)
    np.testing.assert_allclose(seen.sliding_distance, d, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("what", ["peak_force", "sliding_distance"])
def test_derivatives_are_the_reference_s(found, what):
    """Each, as a share of the largest logarithmic derivative of its push."""
    by = getattr(found[1], what)
    worst = 0.0
    for i, case in enumerate(CASES):
        known = getattr(case, f"d_{what}")
        sizes = {name: abs(known[name] * case.rig[name]) for name in known if name in case.rig}
        largest = max(sizes.values(), default=0.0)
        for row, name in enumerate(NAMES.values()):
            if name in sizes:
                off = abs(by[row, i] - known[name]) * case.rig[name]
                worst = max(worst, off / largest)
    assert worst < 1e-5


@pytest.mark.parametrize("stroke", [None, 8e-4])
def test_a_trajectory_is_the_stepper_s(stroke):
    """Force and position over the time, through a loss of contact within the spring's reach."""
    at = {"mass_kg": 18.9, "mu_s": 0.141, "mu_k_over_mu_s": 0.75, "k_v_N_s_per_m": 5.0}
    at |= {"k_N_per_m": 6e5, "b_N_s_per_m": 300.0, "stroke_m": stroke}
    rig = make_rig({**at, "rebound_damping.b_N_s_per_m": 2600.0}.get)
    t = np.linspace(0.0, 0.12, 400)
    closed, stepped = (simulate(rig, 0.02, integrator=x) for x in (None, RungeKutta()))
    np.testing.assert_allclose(closed.position(t), stepped.position(t), atol=2e-9)
    np.testing.assert_allclose(closed.force(t), stepped.force(t), atol=2e-3)


def test_no_loss_on_rebound_is_the_plain_contact():
    plain = spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1500.0, k_v=5.0, stroke=2e-3)
    damped = catalogue.extended(plain, {"rebound_damping": {"b_N_s_per_m": 0.0}})
    for v in (0.01, 0.03, 0.08):
        a, b = observe(plain, jnp.asarray(v)), observe(damped, jnp.asarray(v))
        np.testing.assert_allclose(a.sliding_distance, b.sliding_distance, rtol=1e-12)
        assert (a.peak_force, a.contacts) == (b.peak_force, b.contacts)
