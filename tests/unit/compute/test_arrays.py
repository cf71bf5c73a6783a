"""Functions of arrays by NumPy are JAX's, and dual numbers differentiate them as JAX does."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difffric.compute import arrays as xp
from difffric.compute import elementary_functions
from difffric.compute.dual_numbers import Dual
from difffric.compute.event_root import find_falling_root
from difffric.compute.lanes import change_where, differentiate, join_lanes, repeat_while

X = np.array([-2.5, -0.7, 0.0, 0.3, 1.0, 4.0])
P = np.array([0.02, 0.5, 1.0, 2.0, 30.0])
EVERYWHERE = ("exp", "expm1", "sin", "cos", "tan", "arctan", "tanh", "abs", "square", "sign")
STEPS = ("floor", "ceil", "round", "zeros_like", "ones_like")
POSITIVE = ("log", "log1p", "sqrt")
OF_TWO = {
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "quotient": elementary_functions.quotient,
    "angle": elementary_functions.angle,
    "arctan2": xp.arctan2,
    "power": xp.power,
    "minimum": xp.minimum,
    "maximum": xp.maximum,
    "where": lambda a, b: xp.where(a > b, a, b * b),
    "clip": lambda a, b: xp.clip(a, 0.5, b),
    "polynomial": lambda a, b: xp.polynomial([1.0, 2.0, 3.0], a * b) + a**3 - b**2,
    "numbers": lambda a, b: (2.0 - a) / (1.0 + b) + 3.0 / b - (-a) * 2.0 + (a - 1.0) / 7.0,
}


def assert_agree(function, *at):
    """Value and derivative along (1, -2, ...) by dual numbers, in one direction and in two, are
    those of JAX."""
    along = [(-2.0) ** i * np.ones_like(x) for i, x in enumerate(at)]
    exact, slope = jax.jvp(function, [jnp.asarray(x) for x in at], [jnp.asarray(x) for x in along])
    value, by = differentiate(lambda at: function(*at), list(at), along)
    twice = differentiate(lambda at: function(*at), list(at), [np.stack([x, 3 * x]) for x in along])
    assert not isinstance(value, jax.Array)
    np.testing.assert_allclose(value, exact, rtol=2e-15, atol=1e-16)
    np.testing.assert_allclose(by, slope, rtol=1e-14, atol=1e-15)
    if np.any(by):
        np.testing.assert_allclose(twice[1], np.stack([by, 3 * by]), rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("name", [*EVERYWHERE, *STEPS, *POSITIVE])
def test_a_function_of_one_number(name):
    assert_agree(getattr(xp, name), P if name in POSITIVE else X)


@pytest.mark.parametrize("name", OF_TWO)
def test_a_function_of_two(name):
    a, b = (x.ravel() for x in np.meshgrid(P, P))
    assert_agree(OF_TWO[name], a, b)
    assert_agree(lambda a: OF_TWO[name](a, b), a)
    assert_agree(lambda b: OF_TWO[name](a, b), b)


@pytest.mark.parametrize("k", [0, 1])
def test_sine_and_cosine(k):
    assert_agree(lambda x: elementary_functions.sin_cos(x)[k], X)


def test_log1p_and_angles_at_the_ends_of_their_range():
    assert_agree(elementary_functions.log1p, P)
    assert elementary_functions.log1p(np.inf) == np.inf
    y, x = (a.ravel() for a in np.meshgrid(X[X != 0], X))
    assert_agree(elementary_functions.angle, y, x)
    assert elementary_functions.angle(np.zeros(1), np.zeros(1)) == 0
    assert elementary_functions.angle(np.array([-0.0]), np.array([-1.0])) == np.pi


def test_jax_arrays_and_tracers_stay_jax():
    assert isinstance(xp.exp(jnp.ones(3)), jax.Array)
    assert isinstance(xp.where(np.array([True]), 0.0, jnp.ones(1)), jax.Array)
    assert jax.jit(lambda x: xp.where(x > 1, xp.sqrt(x), 0.0))(4.0) == 2.0
    assert not xp.uses_jax(1.0, X, None, Dual(X, X, 1))


def test_derivatives_within_derivatives_are_not_confused():
    """d/dx (x d/dy (x y)) = 2 x, and not 3 x or x."""
    value, by = differentiate(lambda x: x * xp.slope(lambda y: x * y + 5.0), X, 1.0)
    np.testing.assert_array_equal(value, X * X)
    np.testing.assert_array_equal(by, 2 * X)
    assert xp.slope(lambda y: 3.0) == 0.0


def fall(t, args):
    c, d = args
    return c - t - d * t**3, -1.0 - 3.0 * d * t**2


def test_a_root_in_columns_is_the_root_of_each_lane():
    c, d = np.array([0.5, 1.0, 2.0, 1e-9]), np.array([0.0, 1.0, 10.0, 3.0])
    along = (np.array([1.0, 0.0, 2.0, 1.0]), np.array([0.0, 1.0, 1.0, 1.0]))

    def root(args):
        return find_falling_root(fall, args, 0.0, 3.0, 1.0)

    exact, slope = jax.vmap(lambda at, along: jax.jvp(root, (at,), (along,)))((c, d), along)
    value, by = differentiate(root, (c, d), along)
    np.testing.assert_allclose(value, exact, rtol=1e-15)
    np.testing.assert_allclose(by, slope, rtol=1e-14)


def test_each_lane_of_a_loop_goes_its_own_way():
    start = (np.array([1, 5, 30, 0]), np.zeros(4))

    def goes_on(s):
        return s[0] > 0

    def halve(s, by):
        return s[0] // by, s[1] + 1.5

    together = repeat_while(goes_on, halve, start, np.array([2, 3, 2, 2]))
    alone = [
        jax.lax.while_loop(goes_on, lambda s, by=by: halve(s, by), (n, 0.0))
        for n, by in zip(start[0], (2, 3, 2, 2), strict=True)
    ]
    np.testing.assert_array_equal(together, np.array(alone, float).T)


def test_a_change_concerns_its_lanes_alone():
    seen = []

    def change(s, factor):
        seen.append(s)
        return s * factor

    x = Dual(np.array([1.0, 2.0, 3.0]), np.eye(3), 1)
    new = change_where(np.array([True, False, True]), change, x, np.array([10.0, 20.0, 30.0]))
    np.testing.assert_array_equal(seen[0].value, [1.0, 3.0])
    np.testing.assert_array_equal(new.value, [10.0, 2.0, 90.0])
    np.testing.assert_array_equal(new.tangent, np.diag([10.0, 1.0, 30.0]))
    assert change_where(np.zeros(3, bool), change, x, 1.0) is x


def test_columns_join_where_some_do_not_change():
    joined = join_lanes([(np.ones(2), Dual(np.ones(2), np.ones((3, 1)), 1)), (X, X)])
    assert joined[0].shape == (8,) and joined[1].value.shape == (8,)
