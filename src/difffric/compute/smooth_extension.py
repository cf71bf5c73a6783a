"""Laws continued smoothly beyond the place where they begin, so that their derivatives stay numbers
at zero and a step may look past it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

_TINY = 1e-30
"""Added to an argument at zero: far below any compression or speed, and its square still a
number."""


def power(x: Float[Array, ""] | float, n: Float[Array, ""] | float) -> Float[Array, ""]:
    """x^n for x >= 0, continued to x < 0 as an odd function; exactly x for n = 1."""
    size = jnp.maximum(jnp.abs(x), _TINY)
    return x * jnp.exp((n - 1.0) * jnp.log(size))


def extend_odd(law: Callable[[Any], Any], x: Float[Array, ""]) -> Float[Array, ""]:
    """`law(x)`, continued to x < 0 by reflection through its value at zero.

    A step may look beyond the domain before its event is found there. Continued so, an affine
    law stays affine, any law stays smooth once, and a power law gives no NaN.
    """
    force = law(jnp.where(x < 0, -x, x) + _TINY)
    return jnp.where(x < 0, 2 * law(_TINY * jnp.ones_like(x)) - force, force)
