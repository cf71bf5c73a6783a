"""What filters let through of a push, stride by stride."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import polynomial
from scipy.integrate import solve_ivp

from difffric.rig.catalogue import extended
from difffric.rig.rig import spring_damper_rig
from difffric.simulation.observables import observe, observe_steps
from difffric.simulation.stepping.dense_output import OnePole
from difffric.simulation.stepping.integrator import RungeKutta
from difffric.simulation.stepping.path import follow
from difffric.simulation.stepping.sensor_readout import Filters, filter_strides


@pytest.mark.parametrize("tau, slowness", [(2e-4, 0.5), (5e-3, 40.0), (0.0, 300.0)])
def test_filters_of_some_strides_solve_their_equations_one_after_the_other(tau, slowness):
    """tau f' = N - f for either pole, N a polynomial of each stride's share; a stride that is not
    there changes nothing."""
    rng = np.random.default_rng(4)
    h, there = np.array([1e-3, 2e-3, 1.0, 4e-4]), np.array([True, True, False, True])
    N = 10 * rng.standard_normal((8, 4))
    state = (jnp.asarray(3.0), jnp.asarray(-1.0))
    filters = Filters(jnp.asarray(tau), jnp.asarray(slowness))
    after, passed = filter_strides(filters, N, jnp.asarray(h), jnp.ones(4), there, state)
    share = 1 / (1 - tau * slowness)
    ends = [float(x) for x in state]
    for k in np.flatnonzero(there):
        for j, pole in enumerate((tau, 1 / slowness)):
            if pole == 0:
                ends[j] = float(polynomial.polyval(1.0, N[:, k]))
                continue

            def slope(t, f, k=k, pole=pole):
                return (polynomial.polyval(t / h[k], N[:, k]) - f) / pole

            found = solve_ivp(slope, (0, h[k]), [ends[j]], "DOP853", rtol=1e-11, atol=1e-11)
            ends[j] = float(found.y[0, -1])
        row = type(passed)(*(x[k] for x in passed))
        assert float(row.value(1.0)) == pytest.approx(share * (ends[0] - ends[1]), rel=1e-7)
    np.testing.assert_allclose(after, ends, rtol=1e-7)


@pytest.mark.parametrize("ratio", [1.0, 0.3, 1e-2, 1e-9, 1.01, 30.0, np.inf])
def test_the_few_powers_of_a_filters_answer_are_its_series(ratio):
    """f' = ratio (N - f), f(0) = 1, over the whole stride: against 40 terms of its power series
    where they converge, and N less ratio^-1 N' plus what decays where they do not. A force that is
    as smooth as an integrator's step, and one whose eight powers are all as large."""
    n, share = np.arange(8), np.linspace(0, 1, 21)
    for N, error in ((0.9**n / [math.factorial(k) for k in n], 1e-12), ((-1.0) ** n, 1e-8)):
        found = OnePole.of(jnp.asarray(N), jnp.asarray(1.0), jnp.asarray(1e-3), 1e-3 / ratio)
        values = np.array([float(found.value(s)) for s in share])
        if ratio <= 1:
            f = [1.0]
            for k in range(40):
                f.append(ratio * ((N[k] if k < 8 else 0.0) - f[k]) / (k + 1))
            exact = polynomial.polyval(share, f)
        else:
            p = sum((-1 / ratio) ** k * _differentiate(N, k) for k in range(8))
            exact = polynomial.polyval(share, p)
            exact += (1 - p[0]) * np.exp(-ratio * share) if np.isfinite(ratio) else 0.0
        np.testing.assert_allclose(values, exact, atol=error, rtol=0)


def _differentiate(coefficients, times):
    """The coefficients of a polynomial's derivative, as many as its own."""
    return np.pad(polynomial.polyder(coefficients, times), (0, times))[:8]


@pytest.mark.parametrize("effect", ["force_lowpass", "force_highpass", "sample_clipping"])
def test_a_sensor_without_its_effect_reads_the_plain_peak(effect):
    """Also where steps of no length are taken, long after the peak: such a step's speed, by how far
    it led, was rounding alone, and the damper made 50 N of it."""
    rig = spring_damper_rig(
        mu_s=0.18418489938970847, k_v=5.577, mass=5.13, k=1.366e6, b=2455.0, stroke=2e-3
    )
    rig = extended(rig, {"initial_gap": {"gap_m": 0.00026989814974262544}})
    integrator = RungeKutta(1e-7)
    plain = observe(rig, 0.5 / 60, integrator)
    seen = observe(extended(rig, {effect: {}}), 0.5 / 60, integrator)
    assert float(seen.peak_force) == pytest.approx(float(plain.peak_force), rel=1e-9)
    assert float(seen.sliding_distance) == pytest.approx(float(plain.sliding_distance), rel=1e-6)


@pytest.mark.parametrize("delay", [0.0, 3e-4])
def test_a_late_position_lengthens_d_by_as_much_whether_or_not_it_is_sensed(delay):
    """Followed by what the part does, as recordings are, and read late afterwards, the distance is
    that of a push whose sensors are followed with it."""
    rig = spring_damper_rig(mu_s=0.15, k_v=5.0, mass=18.9, k=8e5, b=1500.0, stroke=1e-3)
    rig = extended(rig, {"channel_skew": {"delay_s": delay}})
    v = jnp.asarray(0.05)
    loop = RungeKutta(1e-9).build_loop(rig, v, blind=True)
    end, path = follow(loop, 256)
    late = float(path.measure_late_distance())
    slid = float(observe_steps(loop, end).sliding_distance)
    seen = observe(rig, v, RungeKutta(1e-9))
    speed = float(path.evaluate(end.t_lost - delay / 2)[2])
    assert late == pytest.approx(speed * delay, rel=1e-3, abs=1e-12)
    assert slid + late == pytest.approx(float(seen.sliding_distance), rel=1e-9)
