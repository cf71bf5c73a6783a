"""The loss of contact: where a recorded force, falling, meets its level without contact."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.measurements.noise import Noise
from difffric.measurements.recordings import Channel
from difffric.measurements.reduction.contacts import SMOOTHEST, Contact
from difffric.measurements.reduction.edge_profile import find_edge_posterior, find_rough_edge
from difffric.measurements.reduction.edge_windows import fit_falls
from difffric.measurements.reduction.local_polynomials import (
    LocalEstimate,
    LocalFit,
    Stretch,
    sizes,
)

_SEEN = 6.0  # standard errors above the level at which there is a force for certain
_STEP = 12.0  # chi-square of a step at the edge that cannot be noise
_UNSEEN = 3.0  # and up to which there may be none


def find_release(
    force: Channel, coarse: Stretch, contact: Contact, noise: Noise, stop: float = np.nan
) -> LocalEstimate:
    """Where the force of a contact reaches the level after it; `value` is that level [N].

    A falling polynomial and a constant that meet: an edge fitted from both sides is neither
    early nor late, as a threshold on a noisy force is. How long the fall is, is not known: from
    the pusher's stop it may be a few samples, on a rebound half the contact. So the scale of the
    search grows from what the noise lets one see, as long as the fit stands it.

    `stop`: when the pusher was told to stop [s], NaN: not known. The force has a kink there, or
    jumps, and what it fell like before says nothing of what it does then. Where too few samples
    follow to fit a fall, the release is uniform between the last sample certain to have a force
    and the first that may have none.
    """
    tail = _tail(force, coarse, contact, noise)
    begin, certain = contact.segments[-1][0], tail.earliest - 1.2 * force.dt
    if begin < stop < certain:
        begin = stop
    if begin >= certain:
        return _after_kink(force, noise, tail, begin)
    found = _fall(force, noise, tail, begin)
    before = found is not None and found.time + 3 * found.time_se < stop
    if certain <= stop < tail.gone and not before:
        return _after_kink(force, noise, tail, stop)
    return found or _between(tail.level, tail.earliest, tail.gone, force.dt)


class _Tail(NamedTuple):
    """The force about a contact's end, and what of it can be told from noise."""

    near: Stretch
    total: NDArray
    """sums of the first points' height above the level"""
    sizes: list[int]
    spreads: NDArray
    """the noise of means over that many points"""
    level: float
    """after the contact"""
    earliest: float
    """until then the force is certain to last [s]"""
    edge: float
    """then it is probably lost, if it falls along a line"""
    gone: float
    """then it may be lost for all one can see"""

    unseen: float
    """how long a force no larger than the noise may last, if it falls as fast as it rose [s]"""

    def lasts(self, i: int, many: float) -> float:
        """How long, from point i on, the means are `many` standard errors above the level [s]."""
        mean = [
            k
            for k, spread in zip(self.sizes, self.spreads, strict=True)
            if i + k < len(self.total) and self.total[i + k] - self.total[i] > k * many * spread
        ]
        return max(mean, default=0) * self.near.dt


def _tail(force, coarse, contact: Contact, noise) -> _Tail:
    """The mean over the k samples from time t is above the level by more than noise can be: so
    the force lasts beyond t. The latest such t of all k is taken; a force that falls from there
    along a line is lost some k samples later.
    """
    reach = max(SMOOTHEST * coarse.dt, 20 * force.dt)
    after = coarse.between(contact.end + reach, np.inf)
    if len(after.t) < 16:
        after = coarse.between(coarse.t[-16] if len(coarse.t) > 16 else -np.inf, np.inf)
    level = float(np.mean(after.y))
    level_se = after.noise.average(len(after.y)).level
    back = reach
    while True:
        begin = max(contact.onset, contact.end - back)
        near = Stretch.of(force, begin, contact.end + reach, noise)
        total = np.concatenate([[0.0], np.cumsum(near.y - level)])
        ks = sizes(1, len(near.y) // 4)
        spreads = [np.hypot(near.noise.average(k).level, level_se) for k in ks]
        spreads = np.maximum(spreads, 2e-4 * contact.top)
        seen = (-1, -1)  # (the latest t's index, -k)
        for k, spread in zip(ks, spreads, strict=True):
            above = np.flatnonzero(total[k:] - total[:-k] > k * _SEEN * spread)
            seen = max(seen, (int(above[-1]), -k)) if len(above) else seen
        if seen[0] >= 0 or begin == contact.onset:
            break
        back *= 2
    i, k = seen[0], -seen[1]
    earliest = float(near.t[i] - near.block / 2) if i >= 0 else contact.end - near.dt
    edge = earliest + k * near.dt
    unseen = noise.level * contact.width / contact.top
    found = _Tail(near, total, ks, spreads, level, earliest, edge, edge, unseen)
    return found._replace(gone=max(edge, earliest + near.dt + found.lasts(i + 1, _UNSEEN)))


def _between(level: float, earliest: float, gone: float, dt: float) -> LocalEstimate:
    """A release of which only the bounds are known; half a sample of force may go unseen."""
    width = gone - earliest + dt / 2
    return LocalEstimate(level, np.nan, earliest + width / 2, width / np.sqrt(12))


def _after_kink(force, noise, tail: _Tail, kink: float) -> LocalEstimate:
    """The release where the force has a kink or a jump about where it is last seen."""
    near = tail.near
    i = int(np.searchsorted(near.t - near.block / 2, kink + 0.51 * force.dt))
    earliest, lasts = max(tail.earliest, kink), tail.lasts(i, 2.0)
    first = float(near.t[i]) if i < len(near.t) else kink + force.dt
    gone = max(first + lasts, earliest)
    if lasts:
        edge = max(tail.edge, (kink + gone) / 2)
        found = _fall(force, noise, tail._replace(earliest=earliest, edge=edge, gone=gone), kink)
        if found is not None:
            return found
    return _between(tail.level, earliest, gone + tail.unseen, force.dt)


def _fall(force, noise, tail: _Tail, begin: float) -> LocalEstimate | None:
    """The edge at the end of a fall that lasts since `begin` at most; None: too few samples."""
    earliest, edge = tail.earliest, tail.edge
    latest = max(tail.gone, edge + 3 * (edge - earliest)) + 2 * force.dt
    begin += 0.51 * force.dt
    flank = max(edge - begin, 4 * force.dt)
    scale = min(max(4 * (edge - earliest), 8 * force.dt, flank / 64), flank)
    best: tuple[tuple[float, float], LocalEstimate] | None = None
    failed = 0
    while True:
        after = max(2 * scale, 60 * force.dt)
        stretch = Stretch.of(force, max(begin, edge - scale), edge + after, noise)
        start = find_rough_edge(stretch, scale, (earliest, latest))
        found = _edge(stretch, start, scale, (earliest, latest))
        if found is not None:
            rank, fit, estimate = found
            if best is None or rank > best[0]:
                best, edge = (rank, estimate), estimate.time
            used = edge - stretch.t[fit.lo]
            failed = 0 if rank[0] > 0 and used > 0.4 * scale else failed + 1
        if scale >= flank or (failed > 2 and best and best[0][0] > 0):
            break
        scale = min(2.5 * scale, flank)
    return best[1] if best else None


def _edge(
    stretch: Stretch, edge: float, scale: float, within: tuple[float, float]
) -> tuple[tuple[float, float], LocalFit, LocalEstimate] | None:
    """(rank, fit, the edge), searched `within` these times; None where nothing falls.

    The rank is how well the fit passes and then the width of its window: not the error found for
    the edge, as noise that looks like a cliff makes that small.
    """
    best = None
    for _ in range(4):
        i = int(np.searchsorted(stretch.t, edge))
        n = len(stretch.t) - i
        if i < 2 or n < 3:
            return best
        found = [
            (min(fit.passed, 0.03), -(fit.se(1) if fit.passed else fit.reduced_chi2), degree, fit)
            for degree, fit in fit_falls(stretch, edge, scale, within[0])
        ]
        if not found:
            return best
        passed, width, degree, fit = max(found, key=lambda f: f[:2])
        posterior = find_edge_posterior(stretch, fit, degree, within, scale)
        if posterior is None:
            return best
        moved, (edge, spread, chi2) = abs(posterior[0] - edge), posterior
        stepped = fit.reduced_chi2 * max(fit.hi - fit.lo - degree - 2, 1)
        if chi2 > stepped + _STEP:  # the fall and the level do not meet
            passed = 0.0
        best = (passed, width), fit, LocalEstimate(fit.coefficients[0], fit.se(), edge, spread)
        if moved < spread / 2:
            break
    return best
