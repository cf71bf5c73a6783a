"""Laws continued smoothly beyond the place where they begin, so that their derivatives stay numbers
at zero and a step may look past it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from difffric.compute import arrays as xp

_TINY = 1e-30
"""Added to an argument at zero: far below any compression or speed, and its square still a
number."""


def power(x: Any, n: Any) -> Any:
    """x^n for x >= 0, continued to x < 0 as an odd function; exactly x for n = 1."""
    size = xp.maximum(xp.abs(x), _TINY)
    return x * xp.exp((n - 1.0) * xp.log(size))


def extend_odd(law: Callable[[Any], Any], x: Any) -> Any:
    """`law(x)`, continued to x < 0 by reflection through its value at zero.

    A step may look beyond the domain before its event is found there. Continued so, an affine
    law stays affine, any law stays smooth once, and a power law gives no NaN.
    """
    force = law(xp.where(x < 0, -x, x) + _TINY)
    return xp.where(x < 0, 2 * law(_TINY * xp.ones_like(x)) - force, force)
