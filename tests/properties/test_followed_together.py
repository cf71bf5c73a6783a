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


@pytest.fixture(scope="module")
def readings():
    """(together, alone): force and position of each push at the same instants."""
    build_loop = partial(RungeKutta().build_loop, blind=True)
    t = jnp.linspace(-1e-3, 0.2, 300)

    def together(rigs, v):
        paths = follow_together(build_loop, rigs, v, 400)
        return jax.vmap(lambda path: path.read(t, t))(paths)

    def alone(rigs, v):
        return jax.lax.map(lambda one: follow(build_loop(*one), 400)[1].read(t, t), (rigs, v))

    return [
        jax.jit(f, compiler_options=OPTIONS)(rigs(), jnp.asarray(VELOCITY))
        for f in (together, alone)
    ]


@pytest.mark.parametrize("channel", [0, 1], ids=["force", "position"])
def test_each_is_the_push_alone(readings, channel):
    together, alone = (np.asarray(x[channel]) for x in readings)
    size = np.abs(alone).max()
    np.testing.assert_allclose(together, alone, atol=1e-9 * size, rtol=0)


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
