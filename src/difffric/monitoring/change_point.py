"""The change point: when numbers changed, and whether at once, by the best step and best ramp."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.monitoring.shiryaev_roberts import FARTHEST

_APART = 4.0
"""By so much must chi-square prefer step or ramp to the other before one of them is named: two
standard deviations."""


class Change(NamedTuple):
    """Where numbers change, as indices of the first number that is changed."""

    step: int
    """if the change is a step"""
    ramp: int
    """if it is a ramp"""
    kind: str
    """`step`, `drift`, or `step or drift`"""

    @property
    def first(self) -> int:
        """Index of the first number that is changed, by the likelier kind."""
        return self.ramp if self.kind == "drift" else self.step


def find_change(z: NDArray) -> Change:
    """Find the likeliest change in numbers (n, channels) that were standard normal before it; NaN
    stands for a number that is missing.

    Of a step the generalised likelihood ratio is (sum z)^2 / n, of a ramp a = 1, 2, ...
    (sum a z)^2 / sum a^2, over all that come after it (Siegmund & Venkatraman, Annals of
    Statistics 23, 1995), summed over the channels.
    """
    there = np.isfinite(z)
    known = np.where(there, np.clip(z, -FARTHEST, FARTHEST), 0.0)
    n = len(z)
    step, ramp = np.zeros(n), np.zeros(n)
    for k in range(n):
        a = np.arange(1.0, n - k + 1)[:, None]
        here, tail = there[k:], known[k:]
        for gain, weight in ((step, np.ones_like(a)), (ramp, a)):
            size = (weight**2 * here).sum(axis=0)
            total = (weight * tail).sum(axis=0)
            gain[k] = (total**2 / np.where(size > 0, size, 1.0)).sum()
    first, begun = int(np.argmax(step)), int(np.argmax(ramp))
    better = ramp[begun] - step[first]
    kind = "drift" if better > _APART else "step" if better < -_APART else "step or drift"
    return Change(first, begun, kind)
