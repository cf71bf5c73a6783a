"""The force at which an axis breaks away: where a rest ends, and what the drive gave then.

A stuck axis starts at the first sample whose force passes the break-away force, so that a rest is
left only at a force higher than all before it. Of these record forces the positions tell which one
it was: the fitted axis would have come from there to where it was measured. What each event so
says of the force, by likelihoods over a grid of it, is put together for all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import norm

from difffric.axis.one_sign_runs import MeasuredMotion, iterate_constant
from difffric.axis.recordings import AxisRecordings, AxisStretch
from difffric.axis.setup import COULOMB, MASS, OFFSET, VISCOUS


@dataclass(frozen=True)
class Breakaway:
    """The end of a rest: intervals of force, and how likely it broke away in each."""

    stretch: int
    sign: int
    edges: NDArray
    """(k + 1,) growing forces against the rest [N], by the friction level of the stretch"""
    logs: NDArray
    """(k,) log likelihood of each interval, the largest 0"""


@dataclass(frozen=True)
class BreakawayForce:
    """The break-away force from all ends of rests."""

    value: float
    """[N]"""
    standard_error: float
    spread: float
    """relative standard deviation from one event to the next, beside that of the level"""
    events: int


_DELAY = "drive_delay.delay_s"
_FOLLOWED = 0.03
"""Seconds of motion that tell when it began."""
_REST = 0.03
"""Seconds that a rest lasts at least."""
_MOVED = 5.0
"""Standard deviations of the encoder's noise by which an axis has left its rest."""
_FEWEST, _MOST_COLOUR = 30, 0.98
"""Samples of a rest that tell its noise, and the largest correlation of neighbours."""
_SPREADS = np.array([1e-3, 3e-3, 0.01, 0.03, 0.1])
"""Relative spreads of the force from one event to the next that are weighed."""
_OTHER_LAW = 6.0
"""Mean square, in those of the noise, that the best start leaves over from which on the axis does
not set off as the fitted one would: its positions then do not tell when it began."""
_OUTLIER = 0.1
"""Probability of an event that is none, such as a creep before the move."""


def find_breakaways(
    data: AxisRecordings,
    motions: Sequence[MeasuredMotion],
    values: Mapping[str, float],
    levels: Sequence[float],
    noise: float,
) -> list[Breakaway]:
    """Return the ends of rests at which the force told what the axis resisted.

    `levels` are the stretches' friction by the mean one; `noise` is that of the encoder [m], by
    which neighbours differ.
    """
    found = []
    for k, (stretch, motion) in enumerate(zip(data.stretches, motions, strict=True)):
        pieces = iterate_constant(motion.direction)
        own = {**values, COULOMB: values[COULOMB] * levels[k]}
        for (a, b, sign), (_, after, moving) in pairwise(pieces):
            if sign == 0 and moving != 0 and after - b >= 3:
                one = _weigh_starts(k, stretch, (a, b, after), moving, own, levels[k], noise)
                if one is not None:
                    found.append(one)
    return found


def combine_breakaways(events: Sequence[Breakaway], coulomb: float) -> BreakawayForce | None:
    """Return the break-away force that all events together make most likely, with its standard
    error; None where nothing sticks."""
    if not events:
        return None
    tops = [event.edges[1:][event.logs > -8].max() for event in events]
    grid = np.linspace(0.6 * coulomb, max(1.3 * max(tops), 1.5 * coulomb), 1500)
    best = None
    for spread in _SPREADS:
        logs = np.sum([_weigh_force(event, grid, spread) for event in events], axis=0)
        evidence = float(np.asarray(logsumexp(logs)))
        if best is None or evidence > best[0]:
            best = (evidence, logs, float(spread))
    assert best is not None
    weights = np.exp(best[1] - best[0])
    value = float(weights @ grid)
    variance = float(weights @ (grid - value) ** 2) + (grid[1] - grid[0]) ** 2 / 12
    return BreakawayForce(value, float(np.sqrt(variance)), best[2], len(events))


def _weigh_force(event: Breakaway, grid: NDArray, spread: float) -> NDArray:
    """Log likelihood of an event for each break-away force (grid,)."""
    below = norm.cdf((event.edges[None, :] - grid[:, None]) / (spread * grid[:, None]))
    inside = np.diff(below, axis=1)
    return np.log(inside @ np.exp(event.logs) * (1 - _OUTLIER) + _OUTLIER)


def _weigh_starts(
    k: int,
    stretch: AxisStretch,
    samples: tuple[int, int, int],
    sign: int,
    values: Mapping[str, float],
    level: float,
    noise: float,
) -> Breakaway | None:
    """What the end of a rest says, or None where it says nothing; `samples` are the rest's first,
    the one after its last, and the one after the motion that follows."""
    a, end, after = samples
    t, x = stretch.time, sign * stretch.position
    acts = np.searchsorted(t, t - values.get(_DELAY, 0.0), side="right") - 1
    force = sign * (stretch.force[np.maximum(acts, 0)] + values[OFFSET])
    step = float(np.median(np.diff(t)))
    far = min(after, len(x))
    home = float(np.median(x[a : a + max(5, round(_REST / step))]))
    size, colour = _measure_rest(x[a:end], noise)
    gone = np.flatnonzero(x[a:far] - home > max(_MOVED * size, 1e-12))
    if not len(gone):
        return None
    left = a + int(gone[0])
    if (left - a) * step < _REST:
        return None
    last = min(far, left + max(4, round(_FOLLOWED / step)))
    begin = max(a, left - round(4 * _FOLLOWED / step))
    home = float(np.mean(x[a : max(a + 3, left - (left - a) // 3)]))
    before = float(force[a + min(3, begin - a) : begin].max(initial=-np.inf))
    records, highest = [], before
    for s in range(begin, min(left + 1, last)):
        if force[s] > highest:
            records.append(s)
            highest = float(force[s])
    records = [s for s in records if force[s] > 0.3 * values[COULOMB]]
    if not records:
        return None
    seen = x[begin:last] - home
    costs = []
    innovation = size**2 * (1 - colour**2)
    for s in records:
        model = np.zeros(last - begin)
        model[s - begin :] = _slide(force[s:last], step, values)
        off = seen - model
        off = off - np.mean(off[: max(s - begin, 1)])
        costs.append(float(((off[1:] - colour * off[:-1]) ** 2).sum()))
    # The fitted axis is not quite the real one: what the best start leaves over is noise, too.
    best = float(np.min(costs))
    sigma2 = max(innovation, best / max(last - begin - 2, 1))
    edges = np.array([max(before, 0.0), *(force[s] for s in records)]) / level
    if records[int(np.argmin(costs))] <= a + 3:
        return None
    logs = -(np.array(costs) - best) / (2 * sigma2)
    if best > _OTHER_LAW * innovation * (last - begin):
        logs[:] = 0.0
    return Breakaway(k, sign, edges, logs)


def _measure_rest(x: NDArray, noise: float) -> tuple[float, float]:
    """Return the standard deviation of the positions (n,) of a rest [m], `noise` at least, and the
    correlation of neighbours.

    What neighbours differ by says less than all of a coloured noise: an axis at rest would seem to
    leave it all the time.
    """
    off = x - np.median(x)
    size = float(np.median(np.abs(off)) / norm.ppf(0.75))
    if len(x) < _FEWEST or size <= noise:
        return noise, 0.0
    off = off[np.abs(off) < _MOVED * size]
    colour = float(off[1:] @ off[:-1]) / max(float(off @ off), 1e-300)
    return size, float(np.clip(colour, 0.0, _MOST_COLOUR))


def _slide(force: NDArray, step: float, values: Mapping[str, float]) -> NDArray:
    """Distance gone at each sample under forces (n,) from rest, each held for a step, friction
    against the motion.

    Exact within a step: where viscous friction brakes within some samples, a speed that is held
    from sample to sample was late by half of one.
    """
    u, s, path = 0.0, 0.0, np.empty(len(force))
    coulomb, mass = values[COULOMB], values[MASS]
    rate = max(values[VISCOUS] / mass, 1e-6 / step)
    fades = float(np.exp(-rate * step))
    lasting = (1 - fades) / rate
    for i, one in enumerate(force):
        path[i] = s
        steady = (one - coulomb) / mass / rate
        s += max(steady * (step - lasting) + u * lasting, 0.0)
        u = max(steady + (u - steady) * fades, 0.0)
    return path
