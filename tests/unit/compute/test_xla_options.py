"""Programs that are compiled soon, and what a compiler may not know."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from difffric.compute import xla_options
from difffric.compute.programs.store import keep_known_options


def test_a_program_compiled_soon_gives_the_same_numbers(monkeypatch):
    def f(x, n):
        return jnp.sin(x) * n

    x = jnp.linspace(0.0, 1.0, 7)
    assert np.allclose(xla_options.compile_soon(f)(x, 2), f(x, 2), rtol=1e-14)
    unknown = {"no_such_option": False}
    monkeypatch.setattr(xla_options, "_SOON", unknown)
    assert keep_known_options(unknown) is None
    assert np.allclose(xla_options.compile_soon(f)(x, 3), f(x, 3), rtol=1e-14)


def test_held_numbers_and_their_derivatives_are_the_same():
    given = {"x": jnp.array([1.5, -0.0, jnp.inf, 1e-300]), "n": jnp.array([3, -1]), "at": 2}
    given |= {"is": jnp.array([True, False]), "none": None}
    for held in (xla_options.hold(given), jax.jit(xla_options.hold)(given)):
        assert jax.tree.structure(held) == jax.tree.structure(given)
        for a, b in zip(jax.tree.leaves(held), jax.tree.leaves(given), strict=True):
            np.testing.assert_array_equal(a, b)
            assert jnp.result_type(a) == jnp.result_type(b)
    assert jnp.isnan(xla_options.hold(jnp.array(jnp.nan)))

    def cube(x):
        return xla_options.hold(xla_options.hold(x) ** 3)

    x, slope = 1.7, jax.jacfwd(cube)
    for f, expected in ((cube, x**3), (slope, 3 * x**2), (jax.jacfwd(slope), 6 * x)):
        assert float(jax.jit(f)(x)) == pytest.approx(expected, rel=1e-14)


def test_what_is_held_is_computed_once():
    """A chain that eight results need, and their derivatives."""

    def count(hold):
        def f(x):
            for n in range(40):
                x = x * (x + n)
            x = hold(x)
            return [jnp.abs(x - k) for k in range(8)]

        def along(x):
            return jax.jvp(f, (x,), (jnp.ones_like(x),))

        return jax.jit(along).lower(jnp.ones(16)).compile().as_text().count(" add(")

    assert count(xla_options.hold) < 0.5 * count(lambda x: x)
