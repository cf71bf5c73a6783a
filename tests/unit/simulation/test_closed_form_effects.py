"""Effects that keep the closed form (a loss on rebound, a latch, a duration): stored reference
pushes with their derivatives, and the integrator in steps."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from difffric.rig import catalogue
from difffric.rig.rig import spring_damper_rig
from difffric.simulation.columns import VELOCITY, differentiate_columns, serves
from difffric.simulation.events import Regime
from difffric.simulation.observables import observe, regime_of
from difffric.simulation.stepping.integrator import RungeKutta
from difffric.simulation.trajectory import simulate
from tests.reference import effect_cases

PLAIN = (
    "mu_s",
    "mu_k_over_mu_s",
    "k_v_N_s_per_m",
    "k_N_per_m",
    "b_N_s_per_m",
    "mass_kg",
)
KEYS = {
    "rebound_damping": "b_N_s_per_m",
    "release_latch": "threshold_N",
    "pusher_duration": "duration_s",
}
MISSING = {"stroke_m": np.inf}
"""what a name is where the reference does not say it; 0 else"""
EVERY = effect_cases.load()


def make_rig(at, *effects):
    """A rig with these effects whose numbers are what `at` says of the reference's names."""
    rig = spring_damper_rig(
        mass=at("mass_kg"),
        mu_s=at("mu_s"),
        mu_k_over_mu_s=at("mu_k_over_mu_s"),
        k=at("k_N_per_m"),
        b=at("b_N_s_per_m"),
        k_v=at("k_v_N_s_per_m"),
        stroke=at("stroke_m"),
    )
    return catalogue.extended(rig, {e: {KEYS[e]: at(f"{e}.{KEYS[e]}")} for e in effects})


class Stored:
    """All stored pushes of one effect, and what NumPy says of them."""

    def __init__(self, effect: str):
        self.cases = [case for case in EVERY if case.group == effect]
        self.names = {name: name for name in PLAIN}
        self.names |= {VELOCITY: "velocity_m_per_s", f"{effect}.{KEYS[effect]}": None}
        self.names = {name: other or name for name, other in self.names.items()}
        rig = make_rig(self.read, effect)
        assert rig.affine and serves(rig)
        self.seen, self.by = differentiate_columns(
            rig, self.read("velocity_m_per_s"), [*self.names]
        )

    def read(self, name: str) -> np.ndarray:
        return np.array([case.rig.get(name, MISSING.get(name, 0.0)) for case in self.cases])


@pytest.fixture(scope="module", params=KEYS)
def stored(request):
    return Stored(request.param)


def test_the_course_is_the_reference_s(stored):
    words = np.array([regime.word for regime in Regime])
    assert words[stored.seen.regime].tolist() == [case.regime for case in stored.cases]
    assert stored.seen.contacts.tolist() == [case.contacts for case in stored.cases]


def test_force_and_distance_are_the_reference_s(stored):
    F_p = [case.peak_force for case in stored.cases]
    d = [np.nan if c.sliding_distance is None else c.sliding_distance for c in stored.cases]
    np.testing.assert_allclose(stored.seen.peak_force, F_p, rtol=1e-9)
    np.testing.assert_allclose(stored.seen.sliding_distance, d, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("what", ["peak_force", "sliding_distance"])
def test_derivatives_are_the_reference_s(stored, what):
    """Each, as a share of the largest logarithmic derivative of its push."""
    by, worst, compared = getattr(stored.by, what), 0.0, 0
    for i, case in enumerate(stored.cases):
        known = getattr(case, f"d_{what}")
        sizes = {name: abs(known[name] * case.rig[name]) for name in known if name in case.rig}
        for row, name in enumerate(stored.names.values()):
            if name in sizes:
                off = abs(by[row, i] - known[name]) * case.rig[name]
                worst, compared = max(worst, off / max(sizes.values())), compared + 1
    assert compared > 500
    assert worst < 1e-5


RIG = {"mass_kg": 18.9, "mu_s": 0.141, "mu_k_over_mu_s": 0.75, "k_v_N_s_per_m": 5.0}
RIG |= {"k_N_per_m": 6e5, "b_N_s_per_m": 300.0, "rebound_damping.b_N_s_per_m": 2600.0}
RIG |= {"release_latch.threshold_N": 12.0, "pusher_duration.duration_s": 0.046}


@pytest.mark.parametrize("stroke", [None, 8e-4])
def test_a_trajectory_is_the_stepper_s(stroke):
    """Force and position over the time, through a loss of contact within the spring's reach."""
    rig = make_rig({**RIG, "stroke_m": stroke}.get, "rebound_damping")
    t = np.linspace(0.0, 0.12, 400)
    closed, stepped = (simulate(rig, 0.02, integrator=x) for x in (None, RungeKutta()))
    np.testing.assert_allclose(closed.position(t), stepped.position(t), atol=2e-9)
    np.testing.assert_allclose(closed.force(t), stepped.force(t), atol=2e-3)


def test_all_three_together_are_the_stepper_s():
    """At the paper's speeds, of which the slowest meet the part again."""
    rig = make_rig({**RIG, "stroke_m": None}.get, *KEYS)
    for v in np.array([500, 1000, 2000, 5000]) / 60e3:
        a, b = (observe(rig, jnp.asarray(v), x) for x in (None, RungeKutta()))
        np.testing.assert_allclose(a.peak_force, b.peak_force, rtol=1e-8)
        np.testing.assert_allclose(a.sliding_distance, b.sliding_distance, rtol=1e-6)
        assert int(a.contacts) == int(b.contacts)


@pytest.mark.parametrize("integrator", [None, RungeKutta()], ids=["closed", "stepper"])
def test_a_latch_that_closes_makes_a_push_of_another_kind(integrator):
    """d jumps there, and a search for roots must know: a threshold beyond F_p is never reached."""
    low, high = (
        observe(
            make_rig(
                {**RIG, "release_latch.threshold_N": level, "stroke_m": 1e-3}.get, "release_latch"
            ),
            jnp.asarray(0.01),
            integrator,
        )
        for level in (12.0, 1e4)
    )
    assert (low.peak_force, low.contacts) == (high.peak_force, high.contacts)
    assert int(low.kind) != int(high.kind)
    assert float(low.sliding_distance) > 2 * float(high.sliding_distance)
    assert int(regime_of(np.asarray(low.kind))) == int(low.regime)


@pytest.mark.parametrize("b_r", [3e4, 4e4])
def test_a_damper_beyond_all_measure_is_the_stepper_s(b_r):
    """On either side of b_r k_v = k m, beyond which a part that was let go is not held again. (With
    ten times as much the stepper says that it cannot follow.)"""
    at = {**RIG, "k_v_N_s_per_m": 60.0, "k_N_per_m": 1e5, "stroke_m": 1e-3}
    rig = make_rig({**at, "rebound_damping.b_N_s_per_m": b_r}.get, "rebound_damping")
    a, b = (observe(rig, jnp.asarray(0.02), x) for x in (None, RungeKutta()))
    assert int(a.reason) == int(b.reason)
    np.testing.assert_allclose(a.peak_force, b.peak_force, rtol=1e-8)
    np.testing.assert_allclose(a.sliding_distance, b.sliding_distance, rtol=1e-6)


def test_no_loss_on_rebound_is_the_plain_contact():
    at = {**RIG, "stroke_m": 2e-3, "rebound_damping.b_N_s_per_m": 0.0}.get
    plain, damped = make_rig(at), make_rig(at, "rebound_damping")
    for v in (0.01, 0.03, 0.08):
        a, b = observe(plain, jnp.asarray(v)), observe(damped, jnp.asarray(v))
        np.testing.assert_allclose(a.sliding_distance, b.sliding_distance, rtol=1e-12)
        assert (a.peak_force, a.contacts) == (b.peak_force, b.contacts)
