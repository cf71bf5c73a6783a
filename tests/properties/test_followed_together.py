"""Many pushes followed in one loop are each the push that is followed alone."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import difffric as df
from difffric.compute import pytrees
from difffric.simulation.observables import observe, observe_steps
from difffric.simulation.stepping.integrator import RungeKutta
from difffric.simulation.stepping.path import follow, follow_together
from tests.effect_rigs import OPTIONS

VELOCITY = np.array([0.01, 0.03, 0.05, 0.08])
PLAIN = df.spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1500.0, k_v=5.0, stroke=2e-3)
EFFECTS = {"force_lowpass": {"tau_s": 1e-3}, "force_highpass": {"tau_s": 0.2}}


def rigs():
    real = df.rig.extended(PLAIN, EFFECTS)
    return pytrees.replicate(real, len(VELOCITY))


T = np.linspace(-1e-3, 0.2, 300)


def compile_follower(tolerance=1e-10):
    """A function of (rigs, until): force and position of each push at T, followed together to that
    time, and where each ends."""
    build_loop, t = partial(RungeKutta(tolerance).build_loop, blind=True), jnp.asarray(T)

    def together(rigs, v, until):
        paths = follow_together(build_loop, rigs, v, 400, until)
        return jax.vmap(lambda path: path.read(t, t))(paths), paths.end

    compiled = jax.jit(together, compiler_options=OPTIONS)
    return lambda rigs, until=np.inf: compiled(rigs, jnp.asarray(VELOCITY), jnp.asarray(until))


@pytest.fixture(scope="module")
def paths_until():
    """A function of a time to which the pushes are followed."""
    follower = compile_follower()
    return lambda until: follower(rigs(), until)


@pytest.fixture(scope="module")
def readings(paths_until):
    """(together, alone): force and position of each push at the same instants."""
    build_loop, t = partial(RungeKutta().build_loop, blind=True), jnp.asarray(T)

    def alone(rigs, v):
        return jax.lax.map(lambda one: follow(build_loop(*one), 400)[1].read(t, t), (rigs, v))

    each = jax.jit(alone, compiler_options=OPTIONS)(rigs(), jnp.asarray(VELOCITY))
    return paths_until(np.inf)[0], each


@pytest.mark.parametrize("channel", [0, 1], ids=["force", "position"])
def test_each_is_the_push_alone(readings, channel):
    together, alone = (np.asarray(x[channel]) for x in readings)
    size = np.abs(alone).max()
    np.testing.assert_allclose(together, alone, atol=1e-9 * size, rtol=0)


@pytest.mark.parametrize("channel", [0, 1], ids=["force", "position"])
def test_a_push_that_is_followed_to_a_time_is_the_whole_push_until_then(paths_until, channel):
    (whole, end), (part, stopped) = paths_until(np.inf), paths_until(0.05)
    before = T <= 0.05
    np.testing.assert_array_equal(
        np.asarray(part[channel])[:, before], np.asarray(whole[channel])[:, before]
    )
    assert np.asarray(end.over).all() and not np.asarray(stopped.over).any()
    assert not np.asarray(stopped.lost_track).any()
    assert (np.asarray(stopped.steps) < np.asarray(end.steps)).all()


def test_a_looser_tolerance_takes_fewer_steps_and_errs_by_less_than_is_seen(readings):
    found, end = compile_follower(1e-7)(rigs())
    for loose, exact in zip(found, readings[0], strict=True):
        size = np.abs(exact).max()
        np.testing.assert_allclose(loose, exact, atol=1e-5 * size, rtol=0)
    # Of the steps few are repeats: one for each event, at most.
    assert np.asarray(end.steps).sum() < 1.5 * np.asarray(end.strides).sum()


def test_the_peak_that_is_read_is_that_of_a_loop_that_senses():
    integrator = RungeKutta()
    blind = partial(integrator.build_loop, blind=True)
    t = jnp.linspace(0.0, 0.3, 1500)

    def look(rig, v):
        m, path = follow(blind(rig, v), 400)
        unfiltered = observe_steps(blind(rig, v), m).peak_force
        f = path.read(t, t)[0]
        sensed = observe(rig, v, integrator).peak_force
        return path.find_read_peak(t, f, unfiltered), unfiltered, sensed

    both = jax.jit(lambda r, v: jax.lax.map(lambda one: look(*one), (r, v)))
    found, unfiltered, sensed = (np.asarray(x) for x in both(rigs(), jnp.asarray(VELOCITY)))
    np.testing.assert_allclose(found, sensed, rtol=2e-5)
    assert (np.abs(unfiltered / sensed - 1) > 2e-3).all()


def test_a_step_that_led_to_no_number_is_not_read():
    """The first step of stiff bristles is far too long: what it led to is no number."""
    stiff = {"presliding": {"sigma_0_N_per_m": 1e9, "sigma_1_N_s_per_m": 5e4}}
    real = pytrees.replicate(df.rig.extended(PLAIN, {**EFFECTS, **stiff}), len(VELOCITY))
    (force, position), end = compile_follower(1e-7)(real)
    assert np.isfinite(force).all() and np.isfinite(position).all()
    assert np.asarray(end.over).all() and not np.asarray(end.lost_track).any()
