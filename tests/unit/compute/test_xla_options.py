"""Programs that are compiled soon, and what a compiler may not know."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

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
