"""A channel's noise: how large, and how much one sample says about the next.

Modelled as a stationary Gaussian AR(1) process, e_t = φ e_{t-1} + ..., which is white for φ = 0.
Estimated where nothing moves: before the push, and after the part has come to rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from difffric.errors import InputError
from difffric.measurements.recordings import Channel, Recordings

SHORTEST = 16
"""Samples that a quiet stretch must have to say anything of the noise."""
KNOWN_TO = 0.02
"""Relative error of the noise's standard deviation, which is estimated itself: residuals that are
larger than the noise by no more say nothing against a model."""
LONGEST = 1 << 18  # samples read of a quiet stretch: more would not say more
_SIGNIFICANT = 2.58  # standard deviations (1 %) from which a correlation is believed
_MOST = 0.999  # of |φ|: at 1 the process would not be stationary
_TREND = float(scipy.special.chdtri(2, 1e-5))  # chi-square of a trend that is no noise
_FIRST_REACH = 4096  # samples searched for the begin of the rest before more are looked at


@dataclass(frozen=True)
class Noise:
    """Stationary AR(1) noise, in the channel's unit."""

    level: float
    """standard deviation of one sample"""
    correlation: float = 0.0
    """of neighbouring samples, φ"""
    n: float = np.inf
    """samples that it was estimated from; 0: from differences of samples, taken to be white"""

    def effective(self, n: int) -> float:
        """How many independent samples the mean of n consecutive ones is worth."""
        phi = self.correlation
        ratio = (1 + phi) / (1 - phi) - 2 * phi * (1 - phi**n) / (n * (1 - phi) ** 2)
        return n / ratio

    def at(self, dt_ratio: float) -> Noise:
        """The noise of every `dt_ratio`-th sample alone."""
        phi = self.correlation
        return Noise(self.level, float(np.sign(phi) * abs(phi) ** dt_ratio), self.n)

    def average(self, n: int) -> Noise:
        """The noise of means of n consecutive samples.

        They are AR(1) again only where φ = 0; otherwise their variance and the correlation of
        neighbours are right.
        """
        phi = self.correlation
        variance = 1.0 / self.effective(n)
        neighbours = phi * ((1 - phi**n) / (1 - phi) / n) ** 2
        return Noise(self.level * np.sqrt(variance), neighbours / variance, self.n)


@dataclass(frozen=True)
class Whitening:
    """The linear map from n samples' residuals to independent ones of unit variance.

    Row i is `scale[i] * r[i] - back[i] * r[i - 1]`: exact for AR(1) noise with samples missing,
    (r_t - φ^g r_{t-g}) / (σ sqrt(1 - φ^{2g})). Rows of a Jacobian go through as residuals do.
    """

    scale: NDArray
    """(n,)"""
    back: NDArray
    """(n,); 0 where a series begins"""

    def __call__(self, rows: ArrayLike) -> NDArray:
        """`rows`, (n,) or (n, columns), whitened."""
        rows = np.asarray(rows)
        shape = (-1,) + (1,) * (rows.ndim - 1)
        out = self.scale.reshape(shape) * rows
        out[1:] -= self.back[1:].reshape(shape) * rows[:-1]
        return out


def make_whitening(index: ArrayLike, noise: Noise) -> Whitening:
    """The whitening of samples number `index` (n,) of a channel; g is the step between two.

    A new series, independent of the one before, begins wherever the index does not increase.
    """
    index = np.asarray(index)
    phi = noise.correlation
    gap = np.diff(index, prepend=index[:1])
    power = np.zeros(len(index))
    follows = gap > 0
    power[follows] = np.sign(phi) ** gap[follows] * abs(phi) ** gap[follows]
    scale = 1.0 / (noise.level * np.sqrt(1.0 - power**2))
    return Whitening(scale, scale * power)


def whiten_consecutive(rows: NDArray, noise: Noise) -> NDArray:
    """Rows (n, ...) of consecutive samples whitened, as `make_whitening` of 0 ... n - 1 does."""
    phi = noise.correlation
    out = rows / noise.level
    if phi:
        out[1:] -= phi * out[:-1]
        out[1:] /= math.sqrt(1 - phi**2)
    return out


def estimate_noise(stretches: Iterable[ArrayLike]) -> Noise:
    """The noise in stretches (each (n,)) in which nothing moves, each about a mean of its own.

    Level and lag-1 correlation are those of the greatest restricted likelihood, which allows
    for what the means take away (H. D. Patterson and R. Thompson, Biometrika 58 (1971)). A
    correlation that is not significant is 0.

    Raises `InputError` where no stretch has at least 16 samples.
    """
    arrays = [np.asarray(s, float) for s in stretches]
    arrays = [a - a.mean() for a in arrays if len(a) >= SHORTEST]
    if not arrays:
        raise InputError(f"no noise estimate: expected {SHORTEST} quiet samples in a row or more")
    n = sum(len(a) for a in arrays)
    squares = np.array([a @ a for a in arrays])
    if squares.sum() == 0.0:
        return Noise(0.0, 0.0, n)
    lengths = np.array([len(a) for a in arrays])
    freedom = n - len(arrays)
    products = np.array([a[1:] @ a[:-1] for a in arrays])
    ends = np.array([[a[0], a[-1]] for a in arrays])
    whole, inner, lagged = (
        float(x.sum()) for x in (squares, squares - np.sum(ends**2, axis=1), products)
    )
    at_ends = ends.sum(axis=1) ** 2

    def innovations(phi):
        """Sum of squares of the innovations about the best means, and the means' information."""
        # The sum of a stretch is zero, so that only its ends remain of 1' V^-1 a.
        information = (1 - phi) * (lengths - (lengths - 2) * phi)
        means = (phi * (1 - phi)) ** 2 * float((at_ends / information).sum())
        return whole + phi**2 * inner - 2 * phi * lagged - means, information

    def criterion(phi):
        rest, information = innovations(phi)
        lost = float(np.log(information).sum()) - len(arrays) * math.log(1 - phi**2)
        return freedom * math.log(rest) + lost

    phi, least = 0.0, _SIGNIFICANT / math.sqrt(n)
    # Where it rises at both bounds of what is not significant, the best one is not.
    if any(criterion(x) <= criterion(0.99 * x) for x in (least, -least)):
        best: Any = scipy.optimize.minimize_scalar(
            criterion, bounds=(-_MOST, _MOST), method="bounded"
        )
        phi = float(best.x) if abs(best.x) >= least else 0.0
    variance = innovations(phi)[0] / freedom
    return Noise(float(np.sqrt(variance / (1 - phi**2))), phi, n)


def estimate_difference_noise(samples: ArrayLike) -> Noise:
    """White noise's level from third differences of moving samples (n,), n >= 4.

    The median ignores jumps. Correlated noise shows only in part, so `n` is 0: a last resort.
    """
    third = np.diff(np.asarray(samples, float), 3)
    level = float(np.median(np.abs(third))) / (scipy.stats.norm.ppf(0.75) * np.sqrt(20.0))
    return Noise(level, 0.0, 0)


def raise_to_resolution(noise: Noise, samples: ArrayLike) -> Noise:
    """The noise, but no less than rounding of the samples (n,) makes it.

    A signal that rests within one step of its resolution shows no noise at all.
    """
    samples = np.asarray(samples, float)
    values = np.sort(samples)
    steps = values[1:] - values[:-1]
    step = steps[steps > 1e-9 * (values[-1:] - values[:1])].min(initial=np.inf)
    least = step / np.sqrt(12.0) if np.isfinite(step) else 0.0
    least = max(least, 1e-12 * float(np.abs(samples).max(initial=0.0)), 1e-30)
    return noise if noise.level >= least else Noise(float(least), 0.0, noise.n)


def read_quiet(channel: Channel) -> NDArray:
    """The samples before t = 0, without the last, which may lie beside the start."""
    return channel.between(max(channel.start, -LONGEST * channel.dt), -channel.dt)[1]


def count_still(samples: ArrayLike, noise: Noise) -> int:
    """How many samples at the end of `samples` (n,) show no trend; 0 where even 8 do.

    The stretch grows by steps of a fifth until a slope and a curvature together are significant
    (p < 1e-5), and then is halved in on.
    """
    last_first = np.asarray(samples, float)[::-1]
    reach = _FIRST_REACH
    while True:
        still = _measure_trends(last_first[:reach], noise) < _TREND
        found, size = 0, 8
        while size <= len(still) and still[size - 1]:
            found, size = size, int(1.2 * size) + 1
        if size <= len(still) or len(still) == len(last_first):
            break
        reach *= 8
    if not found:
        return 0
    moving = min(size, len(still) + 1)  # the least size known to fail, or to be too large
    while moving - found > 1:
        middle = (found + moving) // 2
        found, moving = (middle, moving) if still[middle - 1] else (found, middle)
    return found


def _measure_trends(y: NDArray, noise: Noise) -> NDArray:
    """Chi-square (n,) of a slope and a curvature together in the first 1 ... n of y (n,).

    All from running sums: AR(1) noise looks the same backwards, so a stretch may be whitened from
    the end that all of them share. NaN for less than three samples.
    """
    u = np.arange(len(y)) / max(len(y), 1)
    rows = np.stack([np.ones(len(y)), u, u * u, y - y[:1]], axis=1)
    one, u, v, y = np.ascontiguousarray(whiten_consecutive(rows, noise).T)
    pairs = np.stack([one * one, one * u, one * v, one * y, u * u, u * v, u * y, v * v, v * y])
    oo, ou, ov, oy, uu, uv, uy, vv, vy = np.cumsum(pairs, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Cholesky's elimination, by hand for all stretches at once
        slope = uu - ou * ou / oo
        mixed = (uv - ou * ov / oo) / slope
        right = uy - ou * oy / oo
        bend = vv - ov * ov / oo - mixed * mixed * slope
        chi2 = right**2 / slope + (vy - ov * oy / oo - mixed * right) ** 2 / bend
    chi2[:2] = np.nan
    return chi2


def estimate_quiet_noise(channel: Channel, at_rest: float = np.inf) -> Noise:
    """The noise of one channel: before t = 0, and from time `at_rest` [s] on.

    Without enough of either, from differences of its first samples.
    Raises `InputError` for fewer than 16 samples.
    """
    if channel.n < SHORTEST:
        raise InputError(f"{channel.n} samples say nothing of the noise: expected {SHORTEST}")
    after = channel.between(at_rest, at_rest + LONGEST * channel.dt)[1]
    stretches = [s for s in (read_quiet(channel), after) if len(s) >= SHORTEST]
    everything = channel.read(0, min(channel.n, LONGEST))
    found = estimate_noise(stretches) if stretches else estimate_difference_noise(everything)
    return raise_to_resolution(found, everything)


def pool_noise(recordings: Recordings, which: str) -> Noise:
    """The noise of channel `which` (`force`, `position`), from the quiet time of all pushes.

    Where channels differ in rate, each push needs its own (`estimate_quiet_noise`): raises
    `InputError`, as it does where no push has the channel.
    """
    channels = [c for r in recordings if (c := getattr(r, which)) is not None]
    if not channels:
        raise InputError(f"{recordings.source}: no push has a channel {which}".lstrip(": "))
    if np.ptp([c.dt for c in channels]) > 1e-6 * channels[0].dt:
        raise InputError(f"{recordings.source}: channels {which} differ in rate".lstrip(": "))
    stretches = [s for c in channels if len(s := read_quiet(c)) >= SHORTEST]
    if not stretches:
        single = [estimate_quiet_noise(c) for c in channels]
        return single[int(np.argsort([s.level for s in single])[len(single) // 2])]
    first = channels[0].read(0, min(channels[0].n, LONGEST))
    return raise_to_resolution(estimate_noise(stretches), first)
