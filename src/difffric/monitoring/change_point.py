"""When a change came, and whether at once: the best step and the best ramp in judged numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.monitoring.shiryaev_roberts import FARTHEST

_APART = 4.0
"""By so much must chi-square prefer the one to the other."""


class Change(NamedTuple):
    """Where the numbers change, as indices of the first that is changed."""

    step: int
    ramp: int
    kind: str
    """`step`, `drift`, or `step or drift`"""

    @property
    def first(self) -> int:
        return self.ramp if self.kind == "drift" else self.step


def change_point(z: NDArray) -> Change:
    """The likeliest change in numbers (n, channels) that were standard normal before; NaN: none.

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
