"""Many rings on simulated machines, each centred in several ways."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from difffric.centering.loop import Centering, centre
from difffric.centering.machine import PushReadings, SimulatedMachine
from difffric.centering.planning import Known
from difffric.centering.ring import Ring
from difffric.progress import Tell, silent
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.studies.other_centering import RIVALS, Rivals
from difffric.units import from_um

OURS = "difffric"
MU_S = (0.08, 0.25)
"""Range that hidden mu_s are drawn from, unless said: it has the paper's parts in it."""
OFFSETS = (from_um(5.0), from_um(5000.0))
"""Range that offsets are drawn from [m], unless said."""


@dataclass(frozen=True)
class HiddenRing:
    """A ring as it truly is, which the loop does not know."""

    offset: NDArray
    """(2,) [m]"""
    mu_s: float
    seed: int


@dataclass(frozen=True)
class CenteringRun:
    """One ring, centred in one way."""

    way: str
    ring: HiddenRing
    centering: Centering
    path: NDArray
    """(pushes + 1, 2) where the ring's centre truly was [m]"""

    def within(self, tolerance: float) -> NDArray:
        """Return whether the ring was truly within so many metres after each push (pushes,)."""
        return np.hypot(*self.path[1:].T) <= tolerance

    def is_centred(self, tolerance: float) -> bool:
        """Whether the ring truly was within so many metres in the end, and the loop said so."""
        return self.centering.reason is None and bool(np.hypot(*self.path[-1]) <= tolerance)


class _WatchedMachine:
    """A simulated machine, and where it moved the ring."""

    def __init__(self, machine: SimulatedMachine):
        self.machine, self.path = machine, [machine.offset]

    def measure(self) -> Ring:
        return self.machine.measure()

    def push(self, velocity: float, stroke: float, direction: float) -> PushReadings:
        found = self.machine.push(velocity, stroke, direction)
        self.path.append(self.machine.offset)
        return found


def draw_rings(
    n: int, seed: int, mu_s: tuple[float, float] = MU_S, offsets: tuple[float, float] = OFFSETS
) -> list[HiddenRing]:
    """Draw n rings: mu_s uniform in its range, the offset log-uniform in its [m], in any
    direction."""
    random = np.random.default_rng(seed)
    out = []
    for _ in range(n):
        e = float(np.exp(random.uniform(float(np.log(offsets[0])), float(np.log(offsets[1])))))
        phi = random.uniform(0, 2 * np.pi)
        at = e * np.array([np.cos(phi), np.sin(phi)])
        out.append(
            HiddenRing(at, float(random.uniform(mu_s[0], mu_s[1])), int(random.integers(2**32)))
        )
    return out


def run_rings(
    known: Known,
    rings: Sequence[HiddenRing],
    *,
    truth: Rig | None = None,
    ways: Sequence[str] = (OURS, *RIVALS),
    scatter: float | None = None,
    drift: float = 0.0,
    verify: bool = False,
    tell: Tell = silent,
) -> Iterator[CenteringRun]:
    """Centre each ring in each way, and yield each run as it ends.

    Every way meets the same ring, noise and scatter. `truth` is the rig behind the machine where it
    is not the one that is planned with.
    """
    rivals = Rivals(known) if set(ways) - {OURS} else None
    rig = known.rig if truth is None else truth
    for i, ring in enumerate(rings):
        tell(f"centring ring {i + 1} of {len(rings)}", i / len(rings))
        hidden = parameters.with_values(rig, {"mu_s": ring.mu_s})
        for way in ways:
            machine = SimulatedMachine(
                hidden,
                ring.offset,
                np.random.default_rng(ring.seed),
                drift=drift,
                scatter=known.mu_s.scatter if scatter is None else scatter,
            )
            watched = _WatchedMachine(machine)
            if way == OURS or rivals is None:
                found = centre(watched, known, verify=verify)
            else:
                found = rivals.centre(watched, way)
            yield CenteringRun(way, ring, found, np.array(watched.path))


def summarize_ways(found: Sequence[CenteringRun], within: float) -> dict[str, dict[str, float]]:
    """Return for each way the share of rings within the tolerance [m], and what they took."""
    return {
        way: _summarize([r for r in found if r.way == way], within)
        for way in dict.fromkeys(r.way for r in found)
    }


def _summarize(own: Sequence[CenteringRun], within: float) -> dict[str, float]:
    time = np.array([r.centering.time for r in own])
    pushes = np.array([len(r.centering.pushes) for r in own])
    return {
        "rings": len(own),
        "centred": float(np.mean([r.is_centred(within) for r in own])),
        "time_median_s": float(np.median(time)),
        "time_mean_s": float(time.mean()),
        "pushes_mean": float(pushes.mean()),
        "measurements_mean": float(np.mean([r.centering.measurements for r in own])),
    }
