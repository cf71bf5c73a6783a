"""Dual numbers: a value and how it changes along one or more directions, so that plain NumPy gives
exact derivatives of what is written for numbers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LEVELS = count(1)


def new_level() -> int:
    """The level of a derivative that begins now: above that of every one within which it is
    taken, so that the two are not confused."""
    return next(_LEVELS)


class Dual:
    """value + tangent * e, with e^2 = 0, elementwise.

    The value has the shape (n,), or () where all lanes share it; the tangent that shape, or
    (k, n) or (k, 1) for k directions. Duals of an outer derivative are plain numbers to an inner
    one, of a higher level, and may stand in it as value and tangent. Comparisons are those of the
    values; what does not change is a plain number.
    """

    __slots__ = ("level", "tangent", "value")
    __array_ufunc__ = None  # so that NumPy's arrays leave every operation with one to it
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, value: Any, tangent: Any, level: int):
        self.value, self.tangent, self.level = value, tangent, level

    def __repr__(self) -> str:
        return f"Dual({self.value!r}, {self.tangent!r}, level {self.level})"

    @property
    def shape(self) -> tuple[int, ...]:
        """The value's."""
        return np.shape(self.value)

    @property
    def ndim(self) -> int:
        """The value's."""
        return len(self.shape)

    def __neg__(self) -> Any:
        return Dual(-self.value, -self.tangent, self.level)

    def __pos__(self) -> Any:
        return self

    def __add__(self, other: Any) -> Any:
        a, da, b, db, level = _split_both(self, other)
        return Dual(a + b, db if da is None else da if db is None else da + db, level)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        a, da, b, db, level = _split_both(self, other)
        return Dual(a - b, -db if da is None else da if db is None else da - db, level)

    def __rsub__(self, other: Any) -> Any:
        return Dual(other - self.value, -self.tangent, self.level)

    def __mul__(self, other: Any) -> Any:
        a, da, b, db, level = _split_both(self, other)
        if da is None:
            return Dual(a * b, a * db, level)
        return Dual(a * b, da * b if db is None else da * b + a * db, level)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return divide(self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return divide(other, self)

    def __pow__(self, power: int) -> Any:
        slope = power * self.value ** (power - 1) if power != 2 else 2 * self.value
        return Dual(self.value**power, slope * self.tangent, self.level)

    def __lt__(self, other: Any) -> Any:
        return plain(self) < plain(other)

    def __le__(self, other: Any) -> Any:
        return plain(self) <= plain(other)

    def __gt__(self, other: Any) -> Any:
        return plain(self) > plain(other)

    def __ge__(self, other: Any) -> Any:
        return plain(self) >= plain(other)

    def __eq__(self, other: Any) -> Any:
        return plain(self) == plain(other)

    def __ne__(self, other: Any) -> Any:
        return plain(self) != plain(other)


def divide(x: Any, y: Any) -> Any:
    """x / y, where one of them is a dual number at least."""
    a, da, b, db, level = _split_both(x, y)
    q = a / b
    if db is None:
        return Dual(q, da / b, level)
    fall = -q * db
    return Dual(q, (fall if da is None else da + fall) / b, level)


def _split_both(x: Any, y: Any) -> tuple[Any, Any, Any, Any, int]:
    """(value, tangent, value, tangent, level) of two numbers, one of them dual at least."""
    if type(y) is not Dual:
        return x.value, x.tangent, y, None, x.level
    if type(x) is not Dual or x.level < y.level:
        return x, None, y.value, y.tangent, y.level
    if y.level < x.level:
        return x.value, x.tangent, y, None, x.level
    return x.value, x.tangent, y.value, y.tangent, x.level


def highest(args: Any) -> int:
    """The highest level among some numbers; 0 where none is dual."""
    level = 0
    for x in args:
        if type(x) is Dual and x.level > level:
            level = x.level
    return level


def split(x: Any, level: int) -> tuple[Any, Any]:
    """(value, tangent) as the derivative of this level sees a number; no tangent (None) where it
    does not change."""
    if type(x) is Dual and x.level == level:
        return x.value, x.tangent
    return x, None


def plain(x: Any) -> Any:
    """The number itself, without any tangent."""
    while type(x) is Dual:
        x = x.value
    return x


def are_simple(numbers: Sequence[Any]) -> bool:
    """Whether `RowsOfDuals` serves what is computed from these: all of one level, none a dual
    number of dual numbers."""
    duals = [x for x in numbers if type(x) is Dual]
    nested = any(type(x.value) is Dual or type(x.tangent) is Dual for x in duals)
    return not nested and len({x.level for x in duals}) <= 1


class RowsOfDuals:
    """Up to `most` numbers, one after the other, in the shape that those of `like` have together.

    Values stand in one array and derivatives in another, so that a weighted sum, which a
    Runge-Kutta step asks for again and again, is one product of matrices.
    """

    def __init__(self, like: Sequence[Any], most: int):
        self.level, self.count = highest(like), 0
        shape = np.broadcast_shapes(*(np.shape(plain(x)) for x in like))
        self.values = np.empty((most, *shape))
        self.tangents = None
        if self.level:
            tangents = (np.shape(split(x, self.level)[1]) for x in like if type(x) is Dual)
            self.tangents = np.empty((most, *np.broadcast_shapes(shape, *tangents)))

    def append(self, row: Any) -> None:
        """Put a number behind those that are there."""
        value, tangent = split(row, self.level)
        self.values[self.count] = value
        if self.tangents is not None:
            self.tangents[self.count] = 0.0 if tangent is None else tangent
        self.count += 1

    def weigh(self, weights: Sequence[float]) -> Any:
        """The sum of the rows with these weights."""
        value = self.weigh_values(weights)
        if self.tangents is None:
            return value
        return Dual(value, _weigh(weights, self.tangents), self.level)

    def weigh_values(self, weights: Sequence[float]) -> Any:
        """The same of the values alone."""
        return _weigh(weights, self.values)


class ListedRows:
    """The same for numbers of any kind, one after the other."""

    def __init__(self, like: Sequence[Any], most: int):
        self.rows: list[Any] = []

    def append(self, row: Any) -> None:
        """Put a number behind those that are there."""
        self.rows.append(row)

    def weigh(self, weights: Sequence[float]) -> Any:
        """The sum of the rows with these weights."""
        return sum(w * x for w, x in zip(weights, self.rows, strict=False) if w)

    def weigh_values(self, weights: Sequence[float]) -> Any:
        """The same of the values alone."""
        return sum(w * plain(x) for w, x in zip(weights, self.rows, strict=False) if w)


def _weigh(weights: Sequence[float], rows: NDArray) -> NDArray:
    n = len(weights)
    return (np.asarray(weights) @ rows[:n].reshape(n, -1)).reshape(rows.shape[1:])
