"""The closed loop of centering: measure the ring, plan a push, make it, learn mu_s, and again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.centering.belief import Belief
from difffric.centering.landing import find_landings
from difffric.centering.machine import Machine, PushReadings
from difffric.centering.planning import SURE, Known, Plan, plan
from difffric.errors import InputError
from difffric.units import to_um

MEASURING = 2.0
"""[s] for a rotation of the ring"""
_MOST = 12
"""Pushes to one ring, unless said: who needs more has a rig that is not what is planned with."""
_SURPRISE = 30.0
"""Square of the deviation from which a measurement contradicts the probe: 1 in 3 million."""
_PROBE_SCALE = 1e-4
"""Relative standard error of the probe's scale: a digital linear probe's."""
_NODES, _FINER = 128, 40
"""Values of mu_s at which a push is followed to learn it, and the steps between two of them."""
_NONE = 1e12
"""chi^2 where the model has no such quantity."""


@dataclass(frozen=True)
class CenteringPush:
    """A push of the loop, and what was learnt from it."""

    plan: Plan
    readings: PushReadings
    mu_s: float | None
    """identified from this push; None where its readings say nothing"""
    mu_s_error: float | None
    """relative standard error"""
    known_mu_s: tuple[float, float]
    """mean of mu_s and its relative standard deviation, as known after the push"""
    before: NDArray
    """(2,) the offset as it was estimated before the push [m]"""
    after: NDArray
    """(2,) the offset as it was estimated after the push [m]"""


@dataclass(frozen=True)
class Centering:
    """How a ring was centred."""

    offset: NDArray
    """(2,) the last estimate [m]"""
    deviation: float
    """its standard deviation [m]"""
    probability: float
    """of the ring being within the tolerance"""
    pushes: tuple[CenteringPush, ...]
    events: tuple[tuple[str, float], ...]
    """("measure" or "push", when it was over [s])"""
    mu_s: Belief
    reason: str | None = None
    """why it ended without being centred"""
    notes: tuple[str, ...] = ()

    @property
    def time(self) -> float:
        """[s]"""
        return self.events[-1][1]

    @property
    def measurements(self) -> int:
        """How often the ring was measured."""
        return sum(what == "measure" for what, _ in self.events)


@dataclass
class _Loop:
    """Where the loop stands: the estimated offset, its covariance, and what was done."""

    machine: Machine
    offset: NDArray = field(default_factory=lambda: np.zeros(2))
    covariance: NDArray = field(default_factory=lambda: np.zeros((2, 2)))
    time: float = 0.0
    events: list[tuple[str, float]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def measure(self) -> None:
        """Measure the ring; note where that contradicts what the probe saw of the pushes."""
        ring = self.machine.measure()
        found = np.array([ring.x, ring.y])
        if self.events:
            apart = found - self.offset
            square = apart @ np.linalg.solve(self.covariance + ring.covariance, apart)
            if square > _SURPRISE:
                self.notes.append(
                    f"the ring was measured {to_um(np.hypot(*apart)):.1f} um from where the "
                    "probe's displacements put it: its scale, or what moves beside the part, is "
                    "not right"
                )
        self.offset, self.covariance = found, np.array(ring.covariance)
        self._log("measure", MEASURING)

    def push(self, velocity: float, stroke: float, handling: float) -> PushReadings:
        """Push the ring towards the axis (SI units) and keep count of where it then is."""
        direction = float(np.arctan2(self.offset[1], self.offset[0]))
        readings = self.machine.push(velocity, stroke, direction)
        along = np.array([np.cos(direction), np.sin(direction)])
        self.offset = self.offset - readings.displacement * along
        error = np.hypot(readings.displacement_se, _PROBE_SCALE * readings.displacement)
        self.covariance = self.covariance + error**2 * np.outer(along, along)
        self._log("push", readings.duration + handling)
        return readings

    def _log(self, what: str, seconds: float) -> None:
        """Note an event that took so long."""
        self.time += seconds
        self.events.append((what, self.time))

    @property
    def distance(self) -> tuple[float, float]:
        """Distance of the centre from the axis, and its standard deviation along the push [m]."""
        e = float(np.hypot(*self.offset))
        u = self.offset / e if e > 0 else np.array([1.0, 0.0])
        return e, float(np.sqrt(u @ self.covariance @ u))

    def find_probability(self, within: float) -> float:
        """Return the probability that the centre is within so many metres of the axis."""
        e, s = self.distance
        s = max(s, 1e-12)
        return float(scipy.special.ndtr((within - e) / s) - scipy.special.ndtr((-within - e) / s))


def centre(
    machine: Machine,
    known: Known,
    *,
    sure: float = SURE,
    measure_each: bool = False,
    verify: bool = False,
    identify: Callable[[Known, Plan, PushReadings], Belief | None] | None = None,
    most: int = _MOST,
    tell: Callable[[Centering], None] | None = None,
) -> Centering:
    """Push the ring until it is within the tolerance with the probability `sure`.

    The probe sees how far each push moved the part, so that the ring is measured anew only where
    the offset is no longer known well enough. With `measure_each` it is measured after every push
    instead, and the loop ends at a measured offset within the tolerance; with `verify` it is
    measured once more at the end. `identify` replaces how a push changes what is known of mu_s. At
    most `most` pushes are made. `tell` hears how the ring stands after each.

    Where the ring cannot be centred, the answer's `reason` says why.
    """
    loop, pushes, reason = _Loop(machine), [], None
    loop.measure()
    measured = True  # nothing has been pushed since

    def standing() -> Centering:
        _, deviation = loop.distance
        return Centering(
            offset=loop.offset,
            deviation=deviation,
            probability=loop.find_probability(known.within),
            pushes=tuple(pushes),
            events=tuple(loop.events),
            mu_s=known.mu_s,
            reason=reason,
            notes=tuple(loop.notes),
        )

    while True:
        e, deviation = loop.distance
        if (measure_each and e <= known.within) or loop.find_probability(known.within) >= sure:
            if not verify or measured:
                break
            loop.measure()
            measured = True
            continue
        if len(pushes) == most:
            reason = f"not centred after {most} pushes"
            break
        # A push cannot land more surely than it is known where it starts.
        if not measured and 2 * scipy.special.ndtr(known.within / deviation) - 1 < 0.5 * (1 + sure):
            loop.measure()
            measured = True
            continue
        try:
            before, planned = loop.offset, plan(known, e, deviation, sure)
        except InputError as error:  # out of reach, or less than any push moves the part
            reason = str(error)
            break
        step = planned.next
        readings = loop.push(step.velocity, step.stroke, known.handling)
        measured = False
        learnt = identify_push(known, step.velocity, step.stroke, readings)
        if identify is None:
            mu_s = known.mu_s.update_with_likelihood(learnt.log_mu_s, learnt.likelihood)
        else:
            mu_s = identify(known, planned, readings) or known.mu_s
        known = replace(known, mu_s=mu_s)
        after = known.mu_s.mean, before, loop.offset
        pushes.append(CenteringPush(planned, readings, learnt.mu_s, learnt.error, *after))
        if measure_each:
            loop.measure()
            measured = True
        if tell is not None:
            tell(standing())
    return standing()


class PushEvidence(NamedTuple):
    """What a push's force and distance say of its own mu_s."""

    mu_s: float | None
    """None where they do not tell one value"""
    error: float | None
    """relative standard error of `mu_s`"""
    log_mu_s: NDArray
    """(n,) logarithms that rise by equal steps"""
    likelihood: NDArray
    """(n,) of the readings at each of these; 1 at most"""


def identify_push(
    known: Known, velocity: float, stroke: float, readings: PushReadings
) -> PushEvidence:
    """Find mu_s of one push, at `velocity` [m/s] by `stroke` [m], from its force and distance.

    Where the part rests in contact there is no sliding distance, and its displacement counts
    instead. What was known before chooses the value among several mu_s for one distance. The
    likelihood has them all, and it also says how large a friction may be that held the part.
    """
    lo, hi = known.mu_s.quantiles(np.array([1e-4, 1 - 1e-4]))
    nodes = np.geomspace(max(0.6 * lo, 0.011), min(1.6 * hi, 1.9), _NODES)
    model = find_landings(known.rig, velocity, stroke, nodes, known.integrator)
    fine = np.linspace(np.log(nodes[0]), np.log(nodes[-1]), _FINER * _NODES)
    slid = np.isfinite(readings.sliding_distance)
    pairs = [
        (model.peak_force, readings.peak_force, readings.peak_force_se),
        (model.sliding_distance, readings.sliding_distance, readings.sliding_distance_se)
        if slid
        else (model.displacement, readings.displacement, readings.displacement_se),
    ]
    square = np.zeros_like(fine)
    for curve, value, error in pairs:
        if np.isfinite(value):
            at = np.interp(fine, np.log(nodes), np.nan_to_num(curve, nan=_NONE))
            # What changes within a step of mu_s is not told apart.
            slope = np.nan_to_num(np.gradient(curve, np.log(nodes)))
            width = np.hypot(error, np.interp(fine, np.log(nodes), slope) * (fine[1] - fine[0]))
            square += np.where(at < _NONE / 1e3, ((at - value) / width) ** 2, _NONE)
    prior = np.interp(fine, np.log(known.mu_s.mu_s), known.mu_s.next_push)
    best = int(np.argmin(square - 2 * np.log(prior + 1e-9 * prior.max())))
    while best + 1 < len(fine) and square[best + 1] < square[best]:
        best += 1
    while best > 0 and square[best - 1] < square[best]:
        best -= 1
    above = square >= square[best] + 1
    left, right = np.flatnonzero(above[:best]), np.flatnonzero(above[best:])
    likelihood = np.exp(-0.5 * (square - square.min()))
    if not (len(left) and len(right)) or square[best] >= _NONE:
        return PushEvidence(None, None, fine, likelihood)
    error = 0.5 * (fine[best + right[0]] - fine[left[-1]])
    return PushEvidence(float(np.exp(fine[best])), float(error), fine, likelihood)
