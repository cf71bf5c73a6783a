"""A baseline that is learnt from the numbers that are judged by it, without harm to the judgement.

Numbers y ~ N(mean, phi h) come in cells (a part at a speed), whose means and phi are not known,
with known h. A phi for each, as a speed at which the model hardly determines mu_s scatters more,
and is not to hide the others. The recursive residual of a number, against the mean of
those before it in its cell, is normal and independent of all before; over the phi that those leave
it is t-distributed; and so

    z = Phi^-1(T_nu(t))

is standard normal and independent from the second push of a cell on, whatever the means are
(Hawkins, The Statistician 36, 1987; Hawkins & Olwell, Cumulative Sum Charts, 1998, chapter 7).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field

import scipy

from difffric.monitoring.shiryaev_roberts import FARTHEST


@dataclass
class Spread:
    """What is known of phi: `prior` as much as so many numbers of variance `phi` h."""

    squares: float = 0.0
    count: float = 0.0

    @classmethod
    def known(cls, phi: float, prior: float) -> Spread:
        return cls(prior * phi, prior)

    @property
    def phi(self) -> float | None:
        """The estimate; None: there is none yet."""
        return self.squares / self.count if self.count > 0 and self.squares > 0 else None


@dataclass
class Mean:
    """The mean of a cell: sum of 1/h, and of y/h over it."""

    weight: float = 0.0
    value: float = 0.0

    def add(self, y: float, h: float) -> None:
        """With one number more."""
        self.weight += 1.0 / h
        self.value += (y - self.value) / h / self.weight

    def without(self, numbers) -> Mean:
        """As it was without these (y, h), which it has."""
        left = self.weight - sum(1.0 / h for _, h in numbers)
        if left < 1e-9 * self.weight:
            return Mean()
        moment = self.weight * self.value - sum(y / h for y, h in numbers)
        return Mean(left, moment / left)


@dataclass(frozen=True)
class Judged:
    """What a number was found to be."""

    z: float | None
    """None: there was nothing yet to hold it against"""
    squares: float = 0.0
    """what it added to the spread"""
    taken: bool = True
    """whether it went into its cell's mean"""


def judged(y: float, h: float, mean: Mean, spread: Spread) -> Judged:
    """Hold a number against those before, and add it to them.

    One that is further out than `evidence.FARTHEST` is kept out of the mean: a step is not to be
    learnt before it is found.
    """
    if mean.weight == 0:
        mean.add(y, h)
        return Judged(None)
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
    return Judged(z, square, near)


@dataclass
class Cells:
    """The means and spreads of all cells, for one channel."""

    prior: Spread
    means: dict[str, Mean] = field(default_factory=dict)
    spreads: dict[str, Spread] = field(default_factory=dict)

    def mean(self, cell: str) -> Mean:
        return self.means.setdefault(cell, Mean())

    def spread(self, cell: str) -> Spread:
        return self.spreads.setdefault(cell, Spread(self.prior.squares, self.prior.count))

    def judge(self, y: float, h: float, cell: str) -> Judged:
        """Hold a number of a cell against those before, and add it to them."""
        return judged(y, h, self.mean(cell), self.spread(cell))

    def as_dict(self) -> dict:
        """As a state file holds it."""
        return asdict(self)

    @classmethod
    def read(cls, saved: dict) -> Cells:
        """From what `as_dict` gave."""
        return cls(
            Spread(**saved["prior"]),
            {k: Mean(**x) for k, x in saved["means"].items()},
            {k: Spread(**x) for k, x in saved["spreads"].items()},
        )
