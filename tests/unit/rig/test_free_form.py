"""Free forms: the curve that a compiled program follows is the sum of its splines."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

import difffric as df
from difffric.compute.number_tree import NumberTree
from difffric.rig.free_form import SPLINES, Curve, FreeLoss
from difffric.simulation.observables import observe
from difffric.simulation.stepping.integrator import RungeKutta
from tests.hidden import random_case
from tests.hidden.simulate import readings

END, BEND = 2.0, 0.1
KNOTS = np.arange(-3.0, SPLINES + 3)
"""of the splines that are centred at -1, 0, ... SPLINES"""


def evaluate(c: Any, x: Any) -> Any:
    """The same curve by SciPy's splines."""
    s = np.log1p(np.clip(x, 0, None) / BEND) / np.log1p(END / BEND)
    return BSpline(KNOTS, np.concatenate([[0.0], c, [0.0]]), 3)(np.minimum(s, 1) * (SPLINES - 1))


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_a_curve_is_the_sum_of_its_splines(seed):
    rng = np.random.default_rng(seed)
    c: Any = rng.normal(size=SPLINES)
    x: Any = rng.uniform(-0.5, 1.5 * END, 30)
    expected = evaluate(c, x)
    assert Curve(c, END, BEND)(x) == pytest.approx(expected, abs=1e-12)
    compiled = jax.vmap(Curve(jnp.asarray(c), END, BEND))(jnp.asarray(x))
    assert compiled == pytest.approx(expected, abs=1e-12)


def test_a_compiled_curve_has_the_derivatives_of_its_splines():
    rng = np.random.default_rng(0)
    c: Any = rng.normal(size=SPLINES)
    x: Any = np.append(rng.uniform(0, END, 20), END)

    def at(c, x):
        return Curve(c, END, BEND)(x)

    by_c, by_x = (jax.vmap(jax.jacfwd(at, k), (None, 0))(jnp.asarray(c), x) for k in (0, 1))
    assert by_c @ c == pytest.approx(evaluate(c, x), abs=1e-12)
    step = 1e-6
    inner = x[:-1]
    slope = (evaluate(c, inner + step) - evaluate(c, inner - step)) / (2 * step)
    assert by_x[:-1] == pytest.approx(slope, abs=1e-6)


class Constant(NumberTree):
    """Stands for a curve that is the same everywhere."""

    value: Any

    def __call__(self, x: Any) -> Any:
        return self.value + 0.0 * x


@pytest.mark.parametrize("per_speed", [0.0, 0.5])
def test_a_constant_loss_is_that_of_hunt_and_crossley(per_speed):
    """F_p and d of a contact `k z (1 + per_speed w)`, as the simulator of hidden effects has it,
    which shares no code with the library; without a loss they are the plain rig's."""
    case = random_case(41, scatter=0.0, n=3)
    hidden = case.with_effect("hysteresis", {"per_speed": per_speed}) if per_speed else case
    numbers = {"mu_s": case.pushes[0].mu_s, "stroke": case.stroke, "mass": case.rig["mass_kg"]}
    keys = {"k": "k_N_per_m", "b": "b_N_s_per_m", "k_v": "k_v_N_s_per_m"}
    rig = df.spring_damper_rig(**numbers, **{short: case.rig[key] for short, key in keys.items()})
    contact: Any = FreeLoss(rig.contact, Constant(jnp.asarray(per_speed * FreeLoss.w_r)))
    rig = replace(rig, contact=contact)
    for push, (F_p, d) in zip(case.pushes, readings(hidden), strict=True):
        seen = observe(rig, push.velocity, RungeKutta(1e-9))
        assert float(seen.peak_force) == pytest.approx(F_p, rel=1e-6)
        assert float(seen.sliding_distance) == pytest.approx(d, rel=1e-5)
