"""A quartic over one step, on the share of it from 0 to 1: where a guard falls through zero."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

Quartic = tuple[Array, ...]
"""Five coefficients, lowest power first."""


def fit_quartic(
    g_0: Float[Array, ""],
    d_0: Float[Array, ""],
    g_1: Float[Array, ""],
    d_1: Float[Array, ""],
    c_1: Float[Array, ""],
) -> Quartic:
    """The quartic on [0, 1] with the values g_0 and g_1 and the slopes d_0 and d_1 at its ends, and
    the curvature c_1 at 1."""
    # g_0 + d_0 x + x^2 (a + b x + c x^2)
    r = g_1 - g_0 - d_0
    s = d_1 - d_0
    q = 0.5 * c_1
    # a + b + c = r; 2a + 3b + 4c = s; a + 3b + 6c = q
    a = 6 * r - 3 * s + q
    b = -8 * r + 5 * s - 2 * q
    c = 3 * r - 2 * s + q
    return g_0, d_0, a, b, c


def evaluate(p: Quartic, x: Float[ArrayLike, ""]) -> Float[Array, ""]:
    """p at x."""
    return p[0] + x * (p[1] + x * (p[2] + x * (p[3] + x * p[4])))


def evaluate_slope(p: Quartic, x: Float[Array, ""]) -> Float[Array, ""]:
    """The derivative of p at x."""
    return p[1] + x * (2 * p[2] + x * (3 * p[3] + x * 4 * p[4]))


def look_back(p: Quartic, first: Float[Array, ""]) -> Float[Array, ""]:
    """How far before x = `first` p meets zero, in quarters of the step and from 0 to 1, as the
    straight line through p there and a quarter earlier has it; 0 where that line does not fall."""
    lo = evaluate(p, first - 0.25)
    hi = evaluate(p, first)
    fall = lo - hi
    return jnp.clip(jnp.where(fall > 0, -hi / jnp.where(fall > 0, fall, 1.0), 0.0), 0.0, 1.0)


def find_root(p: Quartic, x: Float[Array, ""]) -> Float[Array, ""]:
    """The root of p near x: four rounds of Newton's method, which stays within a quarter of x."""
    lo, hi = x - 0.25, x + 0.25
    for _ in range(4):
        rate = evaluate_slope(p, x)
        x = jnp.clip(x - evaluate(p, x) / jnp.where(rate == 0, 1.0, rate), lo, hi)
    return x
