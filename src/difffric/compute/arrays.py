"""Array functions for equations that are written once: of JAX's arrays and tracers they are JAX's
own, of dual numbers NumPy's with an exact derivative, of all else NumPy's.

`from difffric.compute import arrays as xp`, and a law reads as it would with `jax.numpy`. JAX is
not imported here: where nothing else has imported it, no argument can be of its kind.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from difffric.compute.dual_numbers import Dual, highest, new_level, plain, split

inf, nan, pi = math.inf, math.nan, math.pi

_NOT_JAX = {float, int, bool, np.ndarray, np.float64, np.int64, np.bool_, Dual, type(None)}
"""Kinds that need not be asked whether they are JAX's."""


def uses_jax(*args: Any) -> bool:
    """Whether one of the arguments is an array or a tracer of JAX's, or a dual number of such."""
    for x in args:
        if type(x) is Dual:
            x = plain(x)
        if type(x) not in _NOT_JAX and (jax := sys.modules.get("jax")) is not None:
            kind = getattr(jax, "Array", None)  # none yet: another thread is importing it
            if kind is not None and isinstance(x, kind):
                return True
    return False


def _library(*args: Any) -> Any:
    """`jax.numpy` where an argument asks for it, else NumPy."""
    if uses_jax(*args):
        import jax.numpy

        return jax.numpy
    return np


def _elementwise(name: str, slope: Callable[[Any, Any], Any]) -> Callable[[Any], Any]:
    """The function of this name, whose derivative is `slope(x, its value)`."""

    def function(x: Any) -> Any:
        if type(x) is Dual:
            value = function(x.value)
            return Dual(value, slope(x.value, value) * x.tangent, x.level)
        return getattr(_library(x), name)(x)

    function.__name__ = function.__qualname__ = name
    return function


def _piecewise_constant(name: str) -> Callable[[Any], Any]:
    """The function of this name, which has no derivative: of a dual number, that of its value."""

    def function(x: Any) -> Any:
        x = plain(x)
        return getattr(_library(x), name)(x)

    function.__name__ = function.__qualname__ = name
    return function


exp = _elementwise("exp", lambda x, value: value)
expm1 = _elementwise("expm1", lambda x, value: value + 1.0)
log = _elementwise("log", lambda x, value: 1.0 / x)
log1p = _elementwise("log1p", lambda x, value: 1.0 / (1.0 + x))
sqrt = _elementwise("sqrt", lambda x, value: 0.5 / value)
sin = _elementwise("sin", lambda x, value: cos(x))
cos = _elementwise("cos", lambda x, value: -sin(x))
tan = _elementwise("tan", lambda x, value: 1.0 + value * value)
arctan = _elementwise("arctan", lambda x, value: 1.0 / (1.0 + x * x))
tanh = _elementwise("tanh", lambda x, value: 1.0 - value * value)
abs = _elementwise("abs", lambda x, value: where(x >= 0, 1.0, -1.0))
square = _elementwise("square", lambda x, value: 2.0 * x)

sign = _piecewise_constant("sign")
floor = _piecewise_constant("floor")
ceil = _piecewise_constant("ceil")
round = _piecewise_constant("round")
isfinite = _piecewise_constant("isfinite")
isinf = _piecewise_constant("isinf")
isnan = _piecewise_constant("isnan")


def arctan2(y: Any, x: Any) -> Any:
    """The angle of (x, y), from -pi to pi."""
    level = highest((y, x))
    if not level:
        return _library(y, x).arctan2(y, x)
    (b, db), (a, da) = split(y, level), split(x, level)
    squares = a * a + b * b
    turn = _sum(None if db is None else a * db, None if da is None else -b * da)
    return Dual(arctan2(b, a), turn / where(squares == 0, 1.0, squares), level)


def power(x: Any, n: Any) -> Any:
    """x^n for x > 0."""
    level = highest((x, n))
    if not level:
        return _library(x, n).power(x, n)
    (a, da), (m, dm) = split(x, level), split(n, level)
    value = power(a, m)
    by_base = None if da is None else m * power(a, m - 1.0) * da
    by_exponent = None if dm is None else value * log(a) * dm
    return Dual(value, _sum(by_base, by_exponent), level)


def where(condition: Any, new: Any, old: Any) -> Any:
    """`new` where the condition holds, else `old`; both have been computed, and what is left aside
    may be no number, nor may its derivative."""
    if type(new) is not Dual and type(old) is not Dual:
        return _library(condition, new, old).where(condition, new, old)
    level = highest((new, old))
    (a, da), (b, db) = split(new, level), split(old, level)
    tangent = where(condition, 0.0 if da is None else da, 0.0 if db is None else db)
    return Dual(where(condition, a, b), tangent, level)


def minimum(x: Any, y: Any) -> Any:
    """The smaller of two; no number where one is none."""
    return _extreme("minimum", x, y)


def maximum(x: Any, y: Any) -> Any:
    """The larger of two; no number where one is none."""
    return _extreme("maximum", x, y)


def _extreme(name: str, x: Any, y: Any) -> Any:
    level = highest((x, y))
    if not level:
        return getattr(_library(x, y), name)(x, y)
    (a, da), (b, db) = split(x, level), split(y, level)
    value = _extreme(name, a, b)
    # Half of each at a tie, as JAX has it.
    share = where(plain(a) == plain(value), where(plain(b) == plain(value), 0.5, 1.0), 0.0)
    tangent = _sum(None if da is None else share * da, None if db is None else (1.0 - share) * db)
    return Dual(value, tangent, level)


def clip(x: Any, lower: Any, upper: Any) -> Any:
    """x, no less than `lower` and no more than `upper`."""
    return minimum(maximum(x, lower), upper)


def asarray(x: Any, dtype: Any = None) -> Any:
    """x as an array; a dual number is one."""
    return x if type(x) is Dual else _library(x).asarray(x, dtype)


def zeros_like(x: Any, dtype: Any = None) -> Any:
    """An array of x's shape that holds zeros."""
    x = plain(x)
    return _library(x).zeros_like(x, dtype)


def ones_like(x: Any, dtype: Any = None) -> Any:
    """An array of x's shape that holds ones."""
    x = plain(x)
    return _library(x).ones_like(x, dtype)


def full_like(x: Any, value: Any, dtype: Any = None) -> Any:
    """An array of x's shape that holds this value everywhere."""
    x = plain(x)
    return _library(x, value).full_like(x, value, dtype)


def stack(rows: Any) -> Any:
    """Arrays of one shape as the rows of one; not of dual numbers."""
    return _library(*rows).stack(rows)


def broadcast_arrays(*args: Any) -> Any:
    """The arrays in the shape that they have together; of dual numbers the values' alone."""
    return _library(*args).broadcast_arrays(*(plain(x) for x in args))


def logical_and(x: Any, y: Any) -> Any:
    """Where both hold."""
    return _library(x, y).logical_and(x, y)


def logical_or(x: Any, y: Any) -> Any:
    """Where one of them holds."""
    return _library(x, y).logical_or(x, y)


def logical_not(x: Any) -> Any:
    """Where it does not hold."""
    return _library(x).logical_not(x)


def _sum(x: Any, y: Any) -> Any:
    """Of two shares of a derivative, either of which may be none."""
    return y if x is None else x if y is None else x + y


def slope(law: Callable[[Any], Any], *like: Any) -> Any:
    """The derivative of an affine law; `like`: some of the numbers that it computes with, which
    say whether JAX does. Along one direction: `jax.jacfwd` would make rows of a matrix."""
    if uses_jax(*like):
        import jax

        return jax.jvp(law, (0.0,), (1.0,))[1]
    level = new_level()
    tangent = split(law(Dual(0.0, 1.0, level)), level)[1]
    return 0.0 if tangent is None else tangent


def follow_rule(
    function: Callable[..., Any], rule: Callable[..., Any], args: tuple[Any, ...]
) -> Any:
    """`function(*args)` by NumPy, one number or a tuple of them, whose derivative
    `rule(result, values, tangents)` tells; a tangent is None where an argument does not change."""
    level = highest(args)
    if not level:
        return function(*args)
    values, tangents = zip(*(split(x, level) for x in args), strict=True)
    result = follow_rule(function, rule, values)
    change = rule(result, values, tangents)
    if isinstance(result, tuple):
        return tuple(Dual(r, c, level) for r, c in zip(result, change, strict=True))
    return Dual(result, change, level)


def polynomial(coefficients: Any, x: Any) -> Any:
    """c_0 + c_1 x + c_2 x^2 + ..., by pairs (Estrin's scheme): half of Horner's chain of
    operations."""
    square = x * x
    pairs = [
        coefficients[i] + coefficients[i + 1] * x if i + 1 < len(coefficients) else coefficients[i]
        for i in range(0, len(coefficients), 2)
    ]
    total: Any = pairs[-1]
    for pair in pairs[-2::-1]:
        total = total * square + pair
    return total
