"""sin, cos, atan2, log1p and a quotient as the equations use them.

Of JAX's arrays and tracers they are the vectorised ones of `written_out`, of dual numbers and all
else NumPy's, with the same derivatives.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from difffric.compute.arrays import follow_rule, uses_jax, where


def sin_cos(x: Any) -> Any:
    """(sin x, cos x)."""
    if uses_jax(x):
        return _import_written_out().sin_cos(x)
    return follow_rule(lambda x: (np.sin(x), np.cos(x)), _turn, (x,))


def _turn(result, values, tangents):
    (s, c), (dx,) = result, tangents
    return c * dx, -s * dx


def angle(y: Any, x: Any) -> Any:
    """atan2(y, x), from -pi to pi; 0 at the origin."""
    if uses_jax(y, x):
        return _import_written_out().angle(y, x)
    return follow_rule(lambda y, x: np.arctan2(y + 0.0, x + 0.0), _swing, (y, x))


def _swing(result, values, tangents):
    (y, x), (dy, dx) = values, tangents
    square = x * x + y * y
    turn = (0.0 if dy is None else x * dy) - (0.0 if dx is None else y * dx)
    return turn / where(square == 0, 1.0, square)


def log1p(x: Any) -> Any:
    """ln(1 + x) for x >= 0, infinity included."""
    if uses_jax(x):
        return _import_written_out().log1p(x)
    return follow_rule(np.log1p, lambda result, values, along: along[0] / (1.0 + values[0]), (x,))


def quotient(x: Any, y: Any) -> Any:
    """x / y, whose derivative takes one more division, where JAX's own takes two."""
    return _import_written_out().quotient(x, y) if uses_jax(x, y) else x / y


def _import_written_out():
    from difffric.compute import written_out  # it imports JAX

    return written_out
