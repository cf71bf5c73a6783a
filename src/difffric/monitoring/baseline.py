"""A baseline that is learnt from the numbers that are judged by it, without harm to the judgement.

Numbers y ~ N(mean, phi h) come in cells (a part at a speed). Their h are known, each cell's mean
and phi are not; each cell has a phi of its own, as a speed at which the model hardly determines
mu_s scatters more, and is not to hide the others. The recursive residual of a number, against the
mean of those before it in its cell, is normal and independent of all before; over the phi that
those leave it is t-distributed; and so

    z = Phi^-1(T_nu(t))

is standard normal and independent from the second push of a cell on, whatever the means are
(Hawkins, The Statistician 36, 1987; Hawkins & Olwell, Cumulative Sum Charts, 1998, chapter 7).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import scipy

from difffric.monitoring.shiryaev_roberts import FARTHEST


@dataclass
class Spread:
    """What is known of phi: the sum of squares of so many residuals."""

    squares: float = 0.0
    count: float = 0.0

    @classmethod
    def from_prior(cls, phi: float, count: float) -> Spread:
        """Return what is known as if `count` numbers had been seen that spread by `phi`."""
        return cls(count * phi, count)

    @property
    def phi(self) -> float | None:
        """The estimate of phi; None: there is none yet."""
        return self.squares / self.count if self.count > 0 and self.squares > 0 else None


@dataclass
class Mean:
    """The mean of a cell's numbers, weighted by 1/h."""

    weight: float = 0.0
    """sum of 1/h"""
    value: float = 0.0

    def add(self, y: float, h: float) -> None:
        """Take a number into the mean."""
        self.weight += 1.0 / h
        self.value += (y - self.value) / h / self.weight

    def remove(self, numbers: Sequence[tuple[float, float]]) -> Mean:
        """Return the mean as it was without some of its numbers (y, h)."""
        left = self.weight - sum(1.0 / h for _, h in numbers)
        if left < 1e-9 * self.weight:
            return Mean()
        moment = self.weight * self.value - sum(y / h for y, h in numbers)
        return Mean(left, moment / left)


@dataclass(frozen=True)
class Judgement:
    """What a number was found to be, against those before it."""

    z: float | None
    """standard normal while nothing changes; None: there was nothing yet to hold it against"""
    squares: float = 0.0
    """what the number added to the spread"""
    taken: bool = True
    """whether the number went into its cell's mean"""


def judge_number(y: float, h: float, mean: Mean, spread: Spread) -> Judgement:
    """Hold a number against those before it in its cell, and add it to them.

    A number further out than `shiryaev_roberts.FARTHEST` is kept out of the mean, as a step is not
    to be learnt before it is found.
    """
    if mean.weight == 0:
        mean.add(y, h)
        return Judgement(None)
    residual = (y - mean.value) / math.sqrt(h + 1.0 / mean.weight)
    phi, square, z = spread.phi, residual**2, None
    if phi is not None:
        t = residual / math.sqrt(phi)
        tail = scipy.special.stdtr(spread.count, -abs(t))
        z = math.copysign(float(-scipy.special.ndtri(max(tail, 1e-300))), t)
    near = z is None or abs(z) <= FARTHEST
    if near:
        mean.add(y, h)
    spread.squares += square
    spread.count += 1
    return Judgement(z, square, near)


@dataclass
class Baseline:
    """The means and spreads of all cells, for one channel (friction or contrast)."""

    prior: Spread
    """what is known of each cell's spread before its first push"""
    means: dict[str, Mean] = field(default_factory=dict)
    spreads: dict[str, Spread] = field(default_factory=dict)

    def get_mean(self, cell: str) -> Mean:
        """Return a cell's mean; a new cell gets an empty one."""
        return self.means.setdefault(cell, Mean())

    def get_spread(self, cell: str) -> Spread:
        """Return a cell's spread; a new cell gets the prior."""
        return self.spreads.setdefault(cell, Spread(self.prior.squares, self.prior.count))

    def judge(self, y: float, h: float, cell: str) -> Judgement:
        """Hold a number of a cell against those before it, and add it to them."""
        return judge_number(y, h, self.get_mean(cell), self.get_spread(cell))

    def as_dict(self) -> dict:
        """Return the baseline as a state file holds it."""
        return asdict(self)

    @classmethod
    def read(cls, saved: dict) -> Baseline:
        """Return the baseline that `as_dict` gave."""
        return cls(
            Spread(**saved["prior"]),
            {k: Mean(**x) for k, x in saved["means"].items()},
            {k: Spread(**x) for k, x in saved["spreads"].items()},
        )
