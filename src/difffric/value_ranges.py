"""What a number of a file may be: the ranges of values, and how a message says them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
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

    def expected(self, found: float) -> str:
        """What a message says was expected where `found` was found instead."""
        finite = "finite " if np.isinf(found) and not self.infinite else ""
        return f"expected a {finite}number {self.words}".rstrip()


ANY = Range("", lambda x: x == x)
NOT_NEGATIVE = Range(">= 0", lambda x: x >= 0)
POSITIVE = Range("> 0", lambda x: x > 0)
RATIO = Range("> 0 and <= 1", lambda x: (x > 0) & (x <= 1))
SCATTER = Range(">= 0 and < 1", lambda x: (x >= 0) & (x < 1))
