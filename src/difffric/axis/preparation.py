"""A recording made ready for a fit: cut into stretches and runs, its speed and noise measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from difffric.axis.motion_model import RunData, choose_block_time, prepare_run
from difffric.axis.one_sign_runs import (
    MeasuredMotion,
    OneSignRun,
    cut_at_rests,
    estimate_encoder_noise,
    find_runs,
    keep_fast,
    measure_motion,
)
from difffric.axis.recordings import AxisRecordings, check_recordings, convert_to_newtons
from difffric.axis.setup import AxisSetup
from difffric.errors import InputError


@dataclass(frozen=True)
class PreparedRecording:
    """What a fit works on."""

    data: AxisRecordings
    motions: Sequence[MeasuredMotion]
    runs: Sequence[OneSignRun]
    run_data: Sequence[RunData]
    noise: float
    """[m] of one sample of the encoder, by third differences"""

    @property
    def usual_speed(self) -> float:
        """The speed that nine samples of ten stay below [m/s]."""
        return float(np.quantile(np.abs(np.concatenate([m.speed for m in self.motions])), 0.9))


def prepare_recording(data: AxisRecordings, setup: AxisSetup) -> PreparedRecording:
    """Return a recording in newtons, cut and with its runs.

    Raises `InputError` where it has none, or cannot be used.
    """
    data = check_recordings(convert_to_newtons(data, setup.gain))
    floor = 0.0 if setup.resolution is None else setup.resolution / np.sqrt(12.0)
    noise = float(np.median([estimate_encoder_noise(x.position) for x in data.stretches]))
    noise = max(noise, floor if setup.noise is None else setup.noise, 1e-15)
    motions = [measure_motion(x, noise) for x in data.stretches]
    if not data.are_given:
        data = replace(data, stretches=cut_at_rests(data, motions))
        motions = [measure_motion(x, noise) for x in data.stretches]
    runs = find_runs(data, motions, noise)
    if not runs:
        raise InputError(
            f"{data.source}: nowhere does the position move clearly one way for long enough "
            f"(its noise is {1e6 * noise:.3g} µm): a force without motion says only that the axis "
            "sticks; record longer or faster moves"
        )
    return PreparedRecording(data, motions, runs, _prepare_runs(data, motions, runs), noise)


def keep_sliding(ready: PreparedRecording) -> PreparedRecording:
    """Return the same recording with the fast parts of its runs only, for a motion that is
    imposed; as it is where that leaves none."""
    motions = keep_fast(ready.motions)
    runs = find_runs(ready.data, motions, ready.noise)
    if not runs:
        return ready
    return replace(ready, runs=runs, run_data=_prepare_runs(ready.data, motions, runs))


def _prepare_runs(
    data: AxisRecordings, motions: Sequence[MeasuredMotion], runs: Sequence[OneSignRun]
) -> list[RunData]:
    block = choose_block_time(runs, data.stretches)
    places = np.linspace(-0.5, 0.5, len(data)) if len(data) > 1 else np.zeros(1)
    return [
        prepare_run(r, data.stretches[r.stretch], motions[r.stretch], block, places[r.stretch])
        for r in runs
    ]
