"""What a sampling rate costs: F_p and d as samples of an exact push give them.

The largest sample misses the peak, and a loss of contact is seen late. The numbers behind section
IV.B of "Real-Time Identification of Sliding Friction Using LabVIEW FPGA": force read by the motion
card's DSP, or by an FPGA.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.errors import InputError
from difffric.identification.inversion import invert
from difffric.rig.rig import Rig
from difffric.simulation.events import Mode
from difffric.simulation.trajectory import Trajectory

_BLOCK = 1 << 16  # times asked for at once: always so many, so that one program is compiled
_FARTHEST = 6.0  # standard deviations of jitter
_GRID = 257  # points in which a segment's peak is looked for


@dataclass(frozen=True)
class Sampler:
    """When samples are taken: due every 1 / rate, each off by normal jitter, and none while other
    tasks hold the sampler.

    The first sample that falls due in a hold-up is taken late, at its end; the others are missing.
    Hold-ups begin at random (Poisson) and last uniformly long.

    Raises `InputError` for a number outside its range.
    """

    rate: float
    """[Hz]"""
    jitter: float = 0.0
    """standard deviation of a sample's instant [s]"""
    held: float = 0.0
    """share of the time in which other tasks hold it, hence of samples that are late or missing"""
    longest: float = 0.0
    """the longest hold-up [s]"""

    def __post_init__(self):
        ranges = {
            "rate: expected a number > 0": 0 < self.rate < np.inf,
            "jitter: expected a number >= 0": 0 <= self.jitter < np.inf,
            "held: expected a number >= 0 and < 1": 0 <= self.held < 1,
            "longest: expected a number >= 0, and > 0 where held is": (
                0 <= self.longest < np.inf and (self.longest > 0 or self.held == 0)
            ),
        }
        wrong = [text for text, good in ranges.items() if not good]
        if wrong:
            raise InputError(f"{'; '.join(wrong)}: got {self}")

    def times(self, phase: ArrayLike, end: float, random: np.random.Generator) -> NDArray:
        """Return the instants [s] at which n runs take their samples (n, samples); inf: missing.

        Each run has one beyond `end` [s].

        `phase` (n,), in [0, 1), is when a sample falls due after t = 0, in units of 1 / rate.
        """
        phase = np.atleast_1d(np.asarray(phase, float))[:, None]
        astray = _FARTHEST * self.jitter
        # What is due before t = 0 may come after it.
        early = astray + (self.longest if self.held else 0.0)
        number = np.arange(-np.ceil(early * self.rate), np.ceil((end + astray) * self.rate) + 2)
        due = (number + phase) / self.rate
        if self.jitter:
            normal = random.standard_normal(due.shape).clip(-_FARTHEST, _FARTHEST)
            due = np.sort(due + self.jitter * normal)
        return self._preempt(due, random) if self.held else due

    def _preempt(self, due: NDArray, random: np.random.Generator) -> NDArray:
        """Return what becomes of samples (n, samples) [s] under hold-ups, which may overlap."""
        gap = 0.5 * self.longest / max(-np.log1p(-self.held), 1e-15)  # rarer than that is never
        first, last = due.min() - self.longest, due.max()
        mean = (last - first) / gap
        shape = (len(due), int(mean + 10 * np.sqrt(mean)) + 10)
        start = first + np.cumsum(random.exponential(gap, shape), axis=1)
        until = np.maximum.accumulate(start + random.uniform(0, self.longest, shape), axis=1)
        until = np.pad(until, ((0, 0), (1, 0)), constant_values=-np.inf)
        begun = [np.searchsorted(s, d, side="right") for s, d in zip(start, due, strict=True)]
        taken = np.maximum(due, np.take_along_axis(until, np.stack(begun), axis=1))
        return np.where(np.diff(taken, axis=1, prepend=-np.inf) > 0, taken, np.inf)


FPGA = Sampler(200e3, jitter=25e-9)
"""The paper's "reliable 200 kHz"; one tick of a 40 MHz clock as jitter is assumed."""

DSP = Sampler(1 / 1010e-6, jitter=30e-6, held=0.05, longest=3e-3)
"""The paper's 1010 µs a sample, "slowed further by other threads"; by how much is assumed."""


class SampledPush(NamedTuple):
    """F_p [N] and d [m] of n runs as samples give them, (n,) each."""

    peak_force: NDArray
    """the largest sample"""
    sliding_distance: NDArray
    """from the first sample not above the threshold, to rest; NaN: the push has none, or no sample
    is above the threshold"""


def sample_push(
    push: Trajectory,
    sampler: Sampler,
    phase: ArrayLike,
    *,
    threshold: float = 0.0,
    noise: float = 0.0,
    seed: int = 0,
) -> SampledPush:
    """Read F_p and d in each of n runs over the same push; `phase` (n,) as for `Sampler.times`.

    Contact is lost where the force is last seen to fall to `threshold` [N], and the position is
    read at that sample, exactly. `noise` [N] is a sample's standard deviation.
    """
    random = np.random.default_rng(seed)
    t = sampler.times(phase, _find_release(push), random)
    force = np.where(
        np.isfinite(t), _evaluate_in_blocks(push.force, np.where(np.isfinite(t), t, -1.0)), 0
    )
    if noise:
        force = force + noise * random.standard_normal(t.shape)
    force = np.where(np.isfinite(t), force, -np.inf)
    touching = np.where(force > threshold, t, -np.inf).max(axis=1)
    seen = np.where(t > touching[:, None], t, np.inf).min(axis=1)
    slid = float(push.position(push.stop_time)) - _evaluate_in_blocks(push.position, seen)
    exists = np.isfinite(touching) & (push.reason is None)
    return SampledPush(force.max(axis=1), np.where(exists, slid, np.nan))


def estimate_friction(rig: Rig, velocity: float, seen: SampledPush) -> tuple[NDArray, NDArray]:
    """Return mu_s from the force and mu_s from the distance, (n,) each, by the exact inverse of the
    rig's model at `velocity` [m/s]. NaN: no mu_s gives the value."""

    def invert_all(target, quantity):
        found = invert(rig, np.full(len(target), velocity), target, quantity)
        return np.array([np.nan if x.value is None else x.value for x in found])

    return (
        invert_all(seen.peak_force, "peak_force"),
        invert_all(seen.sliding_distance, "sliding_distance"),
    )


def mean_loss(push: Trajectory, rate: float) -> float:
    """Return how much the largest regular sample is below F_p [N], in the mean over the phase, to
    leading order.

    That is `-f'' / (24 rate^2)` at a smooth peak, and `|f'| / (2 rate)` where the force jumps to
    its peak, as by the damper's step at t = 0, or from it.
    """

    def slope(t):
        return jax.jvp(push.force, (t,), (1.0,))[1]

    t, spacing = _find_peak(push)
    first, second = map(float, jax.jvp(slope, (t,), (1.0,)))
    # A parabola whose vertex is here: a smooth peak. Else the force jumps at this end of a segment.
    if second < 0 and abs(first / second) <= spacing:
        t -= first / second
        return -float(jax.jvp(slope, (t,), (1.0,))[1]) / (24 * rate**2)
    return abs(first) / (2 * rate)


def _find_peak(push: Trajectory) -> tuple[float, float]:
    """Return when the force is largest [s] on a grid over each segment in contact, and the spacing
    of that grid [s]."""
    edges = np.unique(np.minimum(np.asarray(push.segments.t), _find_release(push)))
    inset = 1e-9 * np.diff(edges)  # at an edge itself a derivative is none of one side's
    times = np.linspace(edges[:-1] + inset, edges[1:] - inset, _GRID, axis=1)
    force = _evaluate_in_blocks(push.force, times)
    row, column = np.unravel_index(np.argmax(force), force.shape)
    return float(times[row, column]), float(times[row, 1] - times[row, 0])


def _find_release(push: Trajectory) -> float:
    """Return a time [s] by which contact is lost for good, or else that of the last event."""
    free = np.asarray(push.segments.mode) == Mode.FREE
    t = np.asarray(push.segments.t)[free]
    t = t[np.isfinite(t)]
    return float(t.max()) if push.reason is None and t.size else float(push.stop_time)


def _evaluate_in_blocks(function: Callable, t: NDArray) -> NDArray:
    """Evaluate a function of times (n,) at times [s] of any number and shape."""
    flat = np.asarray(t, float).ravel()
    out = np.empty(-(-flat.size // _BLOCK) * _BLOCK)
    for lo in range(0, flat.size, _BLOCK):
        block = flat[lo : lo + _BLOCK]
        padded = np.pad(block, (0, _BLOCK - block.size), mode="edge")
        out[lo : lo + _BLOCK] = function(padded)
    return out[: flat.size].reshape(t.shape)
