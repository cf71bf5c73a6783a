"""Powers that are safe where a law begins: derivatives stay numbers at zero."""

from __future__ import annotations

import jax.numpy as jnp

_TINY = 1e-30


def power(x, n):
    """x^n for x >= 0, continued to x < 0 as an odd function; exactly x for n = 1."""
    size = jnp.maximum(jnp.abs(x), _TINY)
    return x * jnp.exp((n - 1.0) * jnp.log(size))


def odd(law, x):
    """`law(x)`, continued to x < 0 by reflection through its value at zero.

    A step may look beyond the domain before its event is found there. Continued so, an affine
    law stays affine, any law stays smooth once, and a power law gives no NaN.
    """
    force = law(jnp.where(x < 0, -x, x) + _TINY)
    return jnp.where(x < 0, 2 * law(_TINY * jnp.ones_like(x)) - force, force)
