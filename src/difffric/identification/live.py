"""mu_s of each push while the next is not yet made: ready before the first, and then fast."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from difffric.acquisition.card import VOLTS_PER_WORD
from difffric.acquisition.push import Acquired, Command
from difffric.compute.pytrees import pick
from difffric.errors import DifffricError
from difffric.identification.combination import combine
from difffric.identification.estimates import PushFriction
from difffric.identification.resolved_pushes import Calibration, ResolvedPushes
from difffric.identification.tabulated_model import TabulatedModel, compute_range_ratio
from difffric.measurements.checks import check_data
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.measurements.reduction.reduce import Reduced, Reduction, reduce_recordings
from difffric.progress import Tell, silent
from difffric.rig.rig import Rig
from difffric.rig.sensors import ForceSensor
from difffric.rig.setup import Setup
from difffric.simulation.families import MU_S, SPEEDS_MM_MIN
from difffric.simulation.segments import default_integrator
from difffric.units import from_mm_min

_NOISE = 8.0  # standard deviations by which the largest of many samples may exceed the force
_LATE = 1e-3  # [s] by which the two ways to see the loss of contact may differ


@dataclass(frozen=True)
class LivePush:
    """What one push said as soon as it had ended."""

    acquired: Acquired
    friction: PushFriction | None
    """None: not identified, and `reason` says why"""
    reduced: Reduced | None
    reason: str | None
    problems: tuple[str, ...]
    """where the reduction contradicts what the card itself saw, a sentence each"""
    seconds: float
    """from the push's last sample to this answer"""


class LiveIdentifier:
    """mu_s of pushes of known speed and stroke on the rig of a set-up, by force, distance, (7) and
    the optimal combination, as `identify` gives them.

    All that can be done before the first push is done when it is made: the programs are compiled,
    and the model is solved over mu_s for each push that will be commanded.
    """

    def __init__(
        self,
        setup: Setup,
        commands: Sequence[Command],
        *,
        tell: Tell = silent,
    ):
        self._setup, rig = setup, setup.rig
        known, integrator = Calibration.read(setup), default_integrator(rig)
        tell("compiling", 0.0)
        speeds = from_mm_min(SPEEDS_MM_MIN)
        ratio = compute_range_ratio(rig, speeds, MU_S, integrator)
        self._curves: dict[Command, TabulatedModel] = {}
        self._resolved: dict[Command, ResolvedPushes] = {}
        for command in dict.fromkeys(commands):
            alone = Pushes(velocity=_one(command.velocity), stroke=_one(command.stroke))
            resolved = ResolvedPushes.of(known, alone, integrator=integrator, range_ratio=ratio)
            self._resolved[command] = resolved
            self._curves[command] = TabulatedModel.of(
                pick(resolved.models.rigs, 0), command.velocity, integrator
            )
        for command in self._curves:
            with suppress(DifffricError):  # at a low rate there is nothing to reduce
                self._reduce(_rehearsal(command, rig.force_sensor))
            F, d = self._curves[command].at(0.14)
            said = Pushes(
                velocity=_one(command.velocity), peak_force=_one(F), sliding_distance=_one(d),
                peak_force_se=_one(1e-2), sliding_distance_se=_one(1e-7),
            )  # fmt: skip
            self._friction(command, said)

    def __call__(self, acquired: Acquired, recording: Recording) -> LivePush:
        """What a push says."""
        friction, reduced, problems = None, None, ()
        reason = acquired.fault or (f"{acquired.lost} samples lost" if acquired.lost else None)
        if reason is None:
            try:
                reduction = self._reduce(recording)
                reduced = reduction.details[0]
                friction = self._friction(acquired.command, reduction.pushes)
                friction = replace(friction, name=acquired.name)
                reason = "; ".join(filter(None, [friction.reason, reduced.reason])) or None
                problems = find_contradictions(acquired, recording, reduced, self._setup.rig)
            except DifffricError as error:  # a push without contact, or one that never rests
                reason = " ".join(str(error).split())
        seconds = time.monotonic() - acquired.ended
        return LivePush(acquired, friction, reduced, reason, problems, seconds)

    def _reduce(self, recording: Recording) -> Reduction:
        return reduce_recordings(check_data(Recordings((recording,)), self._setup.rig))

    def _friction(self, command: Command, pushes: Pushes) -> PushFriction:
        curve, resolved = self._curves[command], self._resolved[command].with_readings(pushes)
        F, d = float(pushes.peak_force[0]), float(pushes.sliding_distance[0])
        force = [curve.invert(F, "peak_force")]
        distance = [curve.choose_by_force(curve.invert(d, "sliding_distance"), F)]
        gradient, regimes = resolved.differentiate(force, distance)
        return combine(resolved, force, distance, gradient, regimes).row(0)


def _one(value: float) -> NDArray:
    return np.array([value])


def find_contradictions(
    acquired: Acquired, recording: Recording, reduced: Reduced, rig: Rig
) -> tuple[str, ...]:
    """Where the reduction of a push denies what the card itself saw, a sentence each.

    The card's peak hold is of single samples: it is above the reduction's F_p by as much as noise
    makes the largest of them, and never below it.
    """
    hardware, force, found = acquired.hardware, recording.force, []
    assert force is not None
    step = VOLTS_PER_WORD / rig.force_sensor.sensitivity
    held, F_p = hardware.peak_word * step, reduced.peak_force
    noise = 0.0 if reduced.noise_force is None else reduced.noise_force.level
    slack = 5 * reduced.peak_force_se + step
    if not np.isnan(F_p + slack) and not -slack <= held - F_p <= slack + _NOISE * noise:
        found.append(f"the card held a peak of {held:.5g} N, the reduction found {F_p:.5g} N")
    seen = reduced.release_time
    if not np.isnan(seen):
        latched = force.start + force.dt * hardware.release_sample
        late = _LATE + 5 * reduced.release_time_se + 2 * force.dt
        if not hardware.released:
            found.append(f"the card saw no loss of contact, the reduction one at {seen:.5g} s")
        elif abs(latched - seen) > late:
            found.append(
                f"the card latched the loss of contact at {latched:.5g} s, the reduction found it "
                f"at {seen:.5g} s"
            )
    return tuple(found)


def _rehearsal(command: Command, sensor: ForceSensor) -> Recording:
    """What a push looks like, without physics: a half-wave of force, and a travel that ends."""
    rate, end = float(sensor.rate), command.stroke / command.velocity
    t = (np.arange(np.ceil(rate * (end + 0.06))) + 0.5) / rate - 0.02
    random, s = np.random.default_rng(0), np.clip(t / end, 0.0, 1.0)
    top = 0.2 * float(sensor.range)
    force = top * (np.sin(np.pi * s) + 1e-3 * random.standard_normal(len(t)))
    position = command.stroke * np.sin(0.5 * np.pi * s) + 1e-7 * random.standard_normal(len(t))
    channels = (Channel.of(x, 1 / rate, t[0], u) for x, u in ((force, "N"), (position, "m")))
    return Recording(command.velocity, *channels, mass=command.mass, stroke=command.stroke)
