"""Where in a recorded force there is contact, and where the force jumps within it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from difffric.measurements.noise import Noise
from difffric.measurements.recordings import Channel
from difffric.measurements.reduction.local_polynomials import Stretch

SMOOTHEST = 40
"""Points that the search smooths over at most: what is longer than a contact hides its end."""
_SEEN = 6.0  # standard errors that a contact or a jump rises above the noise
_LEAST_JUMP = 0.04  # of the contact's maximum: a kink looks like a smaller jump


@dataclass(frozen=True)
class Contact:
    """One contact, from the search; times in seconds."""

    onset: float
    struck: bool
    """whether the force jumps at the onset"""
    end: float
    """roughly where it is lost; infinite where it lasts to the recording's end"""
    jumps: tuple[float, ...]
    """inside the contact"""
    top: float
    """largest smoothed force above the level [N]"""
    width: float
    """how long the force is above half of that [s]"""

    @property
    def segments(self) -> list[tuple[float, float]]:
        """(from, to): the pieces in which the force is continuous."""
        edges = [self.onset, *self.jumps, self.end]
        return list(pairwise(edges))


def _spread(kernel: NDArray, noise: Noise) -> float:
    """Standard deviation of a weighted sum of neighbouring samples."""
    own = np.correlate(kernel, kernel, "full")[len(kernel) - 1 :]  # by lag
    correlations = noise.correlation ** np.arange(len(own))
    return float(noise.level * np.sqrt(2 * own @ correlations - own[0]))


def _smooth(y: NDArray, size: int) -> NDArray:
    """Moving mean over `size` points, fewer at the ends."""
    size = min(size, len(y))
    points = np.full(len(y), float(size))
    before, behind = size // 2, (size - 1) // 2
    points[:before] -= np.arange(before, 0, -1)
    points[len(y) - behind :] -= np.arange(1, behind + 1)
    return np.convolve(y, np.ones(size), "same") / points


def _jumps(y: NDArray, size: int) -> tuple[NDArray, NDArray]:
    """(jump before point i, its kernel): lines through `size` points either side, extrapolated."""
    # Least squares: the weights by which a line through the points s = 1/2, 3/2, ... is read at 0.
    s = np.arange(size) + 0.5
    middle = size / 2
    weights = 1 / size - middle * (s - middle) / max(size * (size**2 - 1) / 12, 1)
    kernel = np.concatenate([-weights[::-1], weights])
    out = np.zeros(len(y))
    if len(y) >= 2 * size:
        out[size : len(y) - size + 1] = np.correlate(y, kernel, "valid")
    return out, kernel


def _locate(force: Channel, t: float, dt: float) -> float:
    """A jump found among blocks near t, between two samples: the best step there."""
    times, y = force.between(t - 1.5 * dt, t + 1.5 * dt)
    if dt < 1.5 * force.dt or len(y) < 4:
        return t
    cost = [y[:i].var() * i + y[i:].var() * (len(y) - i) for i in range(1, len(y))]
    i = int(np.argmin(cost))
    return float(times[i] + times[i + 1]) / 2


def find_contacts(force: Channel, coarse: Stretch, level: float) -> list[Contact]:
    """The contacts in `force`, seen in its block means `coarse`, above the reading `level` [N].

    Two passes: the duration of the largest contact sets how far the second one smooths.
    """
    f = coarse.y - level
    if len(f) < 8:
        return []
    smooth = _smooth(f, 8)
    at = int(np.argmax(smooth))
    above = smooth > 0.5 * smooth[at]
    width = int(above[at:].argmin() or above.sum())
    back = above[: at + 1][::-1]
    width += int(back.argmin() or len(back))
    size = min(max(1, width // 15), SMOOTHEST)
    smooth = _smooth(f, size)
    spread = coarse.noise.level / np.sqrt(coarse.noise.effective(size))
    top = smooth.max()
    if top < _SEEN * spread or top <= 0:
        return []
    high, low = max(_SEEN * spread, 5e-3 * top), max(2 * spread, 1e-3 * top)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], smooth > low, [0]])))
    spans = zip(edges[::2], edges[1::2], strict=True)
    runs = [(a, b) for a, b in spans if smooth[a:b].max() > high]
    reach = max(3, width // 20)
    jump, kernel = _jumps(f, reach)
    threshold = _SEEN * _spread(kernel, coarse.noise)
    found = []
    for a, b in runs:
        peak = float(smooth[a:b].max())
        lo, hi = max(a - size - 1, 0), min(a + size + 2, len(f))
        i = lo + int(np.argmax(jump[lo:hi]))
        struck = bool(jump[i] > max(threshold, 0.02 * peak))
        onset = float(coarse.t[i] - coarse.dt / 2 if struck else coarse.t[a])
        inside = []
        least = np.full(len(f), max(threshold, _LEAST_JUMP * peak))
        least[max(b - 3 * reach, 0) :] = max(threshold, 0.25 * peak)  # the edge at the loss itself
        size_of = np.abs(jump)
        first, stop = (i if struck else a) + reach, min(b + 1, len(f) - reach)
        for j in first + np.flatnonzero((size_of > least)[first:stop]):
            if size_of[j] == size_of[max(j - reach, 0) : j + reach + 1].max():
                inside.append(_locate(force, float(coarse.t[j]) - coarse.dt / 2, coarse.dt))
        if struck:
            onset = _locate(force, onset, coarse.dt)
        at_end = b == len(f)
        found.append(
            Contact(
                onset,
                struck,
                np.inf if at_end else float(coarse.t[b]),
                tuple(t for t in inside if t > onset),
                peak,
                float(np.sum(smooth[a:b] > peak / 2) * coarse.dt),
            )
        )
    return found
