"""What a number of a file may be: its range, its unit, and how it turns into SI and back."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Range:
    """The values that a number may have. It must also be finite, unless `infinite` is set."""

    words: str
    """the range as a message says it, such as `> 0`"""
    holds: Callable[[Any], Any]
    """whether a number, or each of an array, is in the range"""
    infinite: bool = False
    """whether an infinite number may be in it"""

    def allows(self, x: ArrayLike) -> Any:
        """Whether a number, or each of an array, is in the range."""
        return self.holds(x) & (np.isfinite(x) | self.infinite)

    def describe_expected(self, found: float) -> str:
        """What a message says was expected where `found` was found instead."""
        finite = "finite " if np.isinf(found) and not self.infinite else ""
        return f"expected a {finite}number {self.words}".rstrip()


ANY = Range("", lambda x: x == x)
NOT_NEGATIVE = Range(">= 0", lambda x: x >= 0)
POSITIVE = Range("> 0", lambda x: x > 0)
RATIO = Range("> 0 and <= 1", lambda x: (x > 0) & (x <= 1))
SCATTER = Range(">= 0 and < 1", lambda x: (x >= 0) & (x < 1))

_FLOAT_DIGITS = (15, 16, 17)
"""Every number of 15 digits is a float's; no float needs more than 17 to be told from others."""


@dataclass(frozen=True)
class AbstractQuantity:
    """A quantity of a file: its key there, where its value goes, its range and its unit in SI,
    which is `unit / per`.

    File and SI turn into each other in decimal, rounded once: in binary a length could come back
    one digit off.
    """

    key: str
    """its name in files, with its unit"""
    attribute: str
    """its name in Python"""
    range: Range | None = None
    """None: the quantity is a text"""
    unit: str = "1"
    per: int = 1

    def to_si(self, number: Decimal) -> float:
        """The value [SI] of the file's number; beyond all floats it is infinite."""
        value = float(number)
        if not math.isfinite(value) or value == 0.0:
            return value
        return float(number * Decimal(self.unit) / self.per)

    def from_si(self, value: float) -> str:
        """The shortest number of the file that reads as the value [SI].

        Raises `ValueError` for one that is not finite.
        """
        if not math.isfinite(value):
            raise ValueError(f"{self.key} is {value}")
        exact = Decimal(repr(value)) / Decimal(self.unit) * self.per
        for digits in _FLOAT_DIGITS:
            short = repr(float(f"{exact:.{digits}g}"))
            if self.to_si(Decimal(short)) == value:
                return short
        return str(exact)
