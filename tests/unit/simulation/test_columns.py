"""Pushes in columns by NumPy are those that JAX follows, and mu_s is found in them likewise."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difffric.compute.pytrees import replicate
from difffric.identification.crossing import find_crossing, find_crossings_in_columns
from difffric.rig import parameters
from difffric.rig.contact import UnilateralSpringDamper
from difffric.rig.friction import Drift, ExtraLoad, Stribeck, Tilt, ViscousCoulomb, Waviness
from difffric.rig.pusher import ConstantSpeed, SpeedError
from difffric.rig.rig import Rig, spring_damper_rig
from difffric.rig.sensors import ForceSensor, Gain, Offset, Probe, ProbeScale, Saturation
from difffric.simulation.closed_form import ClosedForm
from difffric.simulation.columns import (
    VELOCITY,
    differentiate_columns,
    observe_columns,
    serves,
)
from difffric.simulation.events import Regime
from difffric.simulation.observables import observe
from difffric.simulation.sensitivities import sensitivity
from difffric.simulation.stepping.integrator import RungeKutta

N = 1344


def draw_rigs(n, stroked, seed=0):
    """(rigs, speeds): a sixth each without rail viscosity, without a damper, critically damped on
    approach, on rebound, with mu_k = mu_s, and none of it."""
    rng = np.random.default_rng(seed)
    mass, k = 10 ** rng.uniform(0, 2, n), 10 ** rng.uniform(4, 7, n)
    root = np.sqrt(k * mass)
    b, k_v = 2 * rng.uniform(0.1, 1.5, n) * root, rng.uniform(0, 50, n)
    ratio, kind = rng.uniform(0.5, 0.98, n), np.arange(n) % 6
    k_v = np.where(kind == 0, 0.0, np.where(kind == 3, 2 * root, k_v))
    b = np.where(kind == 1, 0.0, np.where(kind == 2, 2 * root - k_v, b))
    rigs = spring_damper_rig(
        mass=mass,
        mu_s=rng.uniform(0.02, 0.6, n),
        k=k,
        b=b,
        k_v=k_v,
        mu_k_over_mu_s=np.where(kind == 4, 1.0, ratio),
        stroke=10 ** rng.uniform(-3.5, -2, n) if stroked else None,
    )
    return rigs, 10 ** rng.uniform(-2.3, -0.7, n)


def same(ours, exact, scale, tolerance):
    """Both no numbers, or equal to the tolerance times the scale."""
    away = np.abs(ours - exact) / scale
    assert (np.isnan(ours) == np.isnan(exact)).all()
    assert np.nanmax(away) < tolerance, (np.nanmax(away), np.nanargmax(away))


@pytest.mark.parametrize("stroked", [False, True])
def test_columns_are_what_jax_follows(stroked):
    rigs, v = draw_rigs(N, stroked)
    names = [*parameters.names(rigs), VELOCITY]
    seen, by = differentiate_columns(rigs, v, names)
    exact = jax.jit(jax.vmap(sensitivity))(replicate(rigs, N), v)
    whole = exact.observables
    for code in ("reason", "regime", "stuck_first", "contacts", "kind"):
        np.testing.assert_array_equal(getattr(seen, code), getattr(whole, code))
    assert set(seen.regime) >= {Regime.PUSHED_TO_REST, Regime.RELEASED_BY_REBOUND}
    same(seen.peak_force, whole.peak_force, whole.peak_force, 1e-15)
    same(seen.sliding_distance, whole.sliding_distance, whole.sliding_distance, 1e-9)
    # A rebound damped critically comes to rest for t to infinity, or after long: rounding says.
    sure = np.arange(N) % 6 != 3
    same(seen.displacement[sure], whole.displacement[sure], whole.displacement[sure], 1e-9)
    same(seen.duration[sure], whole.duration[sure], whole.duration[sure], 1e-9)
    # Where b or k_v is zero, against what would damp critically.
    b = 2 * np.sqrt(rigs.contact.k * rigs.mass)
    sizes = {**parameters.values(rigs), "b_N_s_per_m": b, "k_v_N_s_per_m": b, VELOCITY: v}
    for row, name in enumerate(names):
        for ours, theirs, value in (
            (by.peak_force, exact.peak_force, whole.peak_force),
            (by.sliding_distance, exact.sliding_distance, whole.sliding_distance),
        ):
            slope = np.asarray(theirs[name])
            same(ours[row], slope, np.abs(slope) + np.abs(value) / sizes[name], 1e-8)


def test_effects_that_leave_the_laws_affine_are_served():
    friction = ViscousCoulomb(np.linspace(0.05, 0.3, 64), 0.75, 5.0)
    rig = Rig(
        18.9,
        Drift(ExtraLoad(Tilt(friction, 0.01), 3.0), 0.2, np.linspace(0.0, 1.0, 64)),
        UnilateralSpringDamper(8e5, 1500.0),
        SpeedError(ConstantSpeed(2e-3), 1.02),
        Saturation(Offset(Gain(ForceSensor(), 0.98), 0.3), 180.0),
        ProbeScale(Probe(), 1.01),
    )
    assert serves(rig)
    seen = observe_columns(rig, 0.05)
    exact = jax.jit(jax.vmap(lambda rig: observe(rig, 0.05)))(replicate(rig, 64))
    for ours, theirs in zip(seen, exact, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)
    assert 0 < np.sum(seen.peak_force == 180.0) < 64


def test_what_columns_do_not_serve():
    rig, _ = draw_rigs(3, False)
    assert serves(rig) and serves(rig, ClosedForm())
    assert not serves(rig, RungeKutta())
    assert serves(replace(rig, friction=Stribeck(rig.friction, 0.01)))
    assert not serves(replace(rig, friction=Waviness(rig.friction, 0.01)))
    assert not serves(replace(rig, mass=jnp.ones(3)))

    class Own(ViscousCoulomb):
        """A user's law, which may ask for JAX."""

    assert not serves(replace(rig, friction=Own(0.1)))


def test_a_push_in_a_column_is_the_push_alone():
    rigs, v = draw_rigs(5000, True, seed=1)
    together = observe_columns(rigs, v)
    for i in (0, 5, 4095, 4096, 4999):
        alone = observe_columns(jax.tree.map(lambda x, i=i: x[i] if np.ndim(x) else x, rigs), v[i])
        for one, every in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one, every[i : i + 1])


@pytest.mark.parametrize("by_force", [True, False])
def test_mu_s_in_columns_is_what_jax_finds(by_force):
    """Of measured values that exist, and of distances that no mu_s gives: where the part only just
    leaves the tip, d begins with a jump."""
    rigs, v = draw_rigs(N, False)
    seen = observe_columns(rigs, v)
    target = seen.peak_force if by_force else seen.sliding_distance
    target = np.where(np.isnan(target), np.nanmin(target), target)
    bracket, rising = (np.full(N, 1e-3), np.full(N, 2.0)), np.full(N, by_force)
    found = find_crossings_in_columns(rigs, v, target, by_force, bracket, rising)
    search = jax.vmap(lambda *push: find_crossing(*push[:3], by_force, push[3], push[4]))
    exact = jax.jit(search)(replicate(rigs, N), v, target, bracket, rising)
    np.testing.assert_array_equal(found.solved, exact.solved)
    good = found.solved
    # F_p may hardly depend on mu_s, and then says as little of it.
    depends = np.abs(found.slope * found.mu_s) > 1e-3 * target
    np.testing.assert_allclose(found.mu_s[good & depends], exact.mu_s[good & depends], rtol=5e-12)
    np.testing.assert_allclose(found.slope[good], exact.slope[good], rtol=1e-8, atol=1e-8)
    again = observe_columns(parameters.with_values(rigs, {"mu_s": found.mu_s}), v)
    got = again.peak_force if by_force else again.sliding_distance
    np.testing.assert_allclose(got[good], target[good], rtol=1e-8)
    assert good.sum() > 0.4 * N and (by_force or (~good).any())


def test_no_jax_is_imported():
    program = """
import sys
import numpy as np
from difffric.identification.crossing import find_crossings_in_columns
from difffric.rig.rig import spring_damper_rig
from difffric.simulation.columns import differentiate_columns
rig = spring_damper_rig(mass=18.9, mu_s=np.array([0.1, 0.2]), k=8e5, b=1500.0, stroke=2e-3)
v = np.array([0.05, 0.06])
seen, _ = differentiate_columns(rig, v, ["mu_s", "mass_kg"])
bracket = np.full(2, 0.05), np.full(2, 0.5)
found = find_crossings_in_columns(rig, v, seen.peak_force, True, bracket, np.full(2, True))
np.testing.assert_allclose(found.mu_s, [0.1, 0.2])
heavy = {"jax", "equinox", "optimistix", "lineax", "diffrax"} & set(sys.modules)
assert not heavy, heavy
"""
    subprocess.run([sys.executable, "-c", program], check=True)
