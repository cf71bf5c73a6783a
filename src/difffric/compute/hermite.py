"""A quartic over one step, on the share of it from 0 to 1: where a guard falls through zero."""

from __future__ import annotations

import jax.numpy as jnp


def hermite(g_0, d_0, g_1, d_1, c_1):
    """Coefficients of the quartic on [0, 1] with these values, slopes, and curvature at 1."""
    # g_0 + d_0 x + x^2 (a + b x + c x^2)
    r = g_1 - g_0 - d_0
    s = d_1 - d_0
    q = 0.5 * c_1
    # a + b + c = r; 2a + 3b + 4c = s; a + 3b + 6c = q
    a = 6 * r - 3 * s + q
    b = -8 * r + 5 * s - 2 * q
    c = 3 * r - 2 * s + q
    return g_0, d_0, a, b, c


def value(p, x):
    """p at x."""
    return p[0] + x * (p[1] + x * (p[2] + x * (p[3] + x * p[4])))


def slope(p, x):
    """The derivative of p at x."""
    return p[1] + x * (2 * p[2] + x * (3 * p[3] + x * 4 * p[4]))


def before(p, first):
    """How far before `first` a straight line over the last quarter meets zero, in quarters."""
    lo = value(p, first - 0.25)
    hi = value(p, first)
    fall = lo - hi
    return jnp.clip(jnp.where(fall > 0, -hi / jnp.where(fall > 0, fall, 1.0), 0.0), 0.0, 1.0)


def root(p, x):
    """The root near x of the quartic p, by Newton within a quarter."""
    lo, hi = x - 0.25, x + 0.25
    for _ in range(4):
        rate = slope(p, x)
        x = jnp.clip(x - value(p, x) / jnp.where(rate == 0, 1.0, rate), lo, hi)
    return x
