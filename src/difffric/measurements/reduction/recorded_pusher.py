"""The reduction of pushes that their recorded pushers drive: the motions' errors are carried.

What the smoothed motion is off makes the modelled force off by k y + b V, for as long as the spline
remembers, and the part's speed where it leaves the tip by the impulse of that force. F_p and d have
their standard errors raised by what that makes of them. Fits of whole recordings know better what
the error does (`estimation.following.motion_errors`): the samples' noise stays as it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from difffric.measurements.recorded_motion import take_recorded_motion
from difffric.measurements.recordings import Recording, Recordings
from difffric.measurements.reduction.reduce import Reduced, Reduction, reduce_recordings
from difffric.rig import parameters
from difffric.rig.setup import Setup


def reduce_for(setup: Setup, data: Recordings, skip_bad: bool = False) -> Reduction:
    """The recordings reduced, as the set-up asks for them: with the motion of each tip, and its
    error carried, where its pusher is the recorded one.

    Raises `InputError` as `reduce_recordings` and `take_recorded_motion` do.
    """
    if not setup.recorded_motion:
        return reduce_recordings(data, skip_bad=skip_bad)
    reduction = reduce_recordings(take_recorded_motion(data, skip_bad), skip_bad=skip_bad)
    return carry_motion_error(reduction, setup)


def carry_motion_error(reduction: Reduction, setup: Setup) -> Reduction:
    """The reduction with what the smoothed motions are off counted in; k and b are the set-up's."""
    values = parameters.values(setup.rig)
    k, b = (float(values.get(name, 0.0)) for name in ("k_N_per_m", "b_N_s_per_m"))
    details: list[Reduced] = []
    errors = np.zeros((2, len(reduction.details)))
    for i, (recording, detail) in enumerate(
        zip(reduction.recordings, reduction.details, strict=True)
    ):
        mass = float(setup.rig.mass) if np.isnan(recording.mass) else recording.mass
        F, d = errors[:, i] = _find_errors(recording, detail, k, b, mass)
        details.append(
            replace(
                detail,
                peak_force_se=float(np.hypot(detail.peak_force_se, F)),
                sliding_distance_se=float(np.hypot(detail.sliding_distance_se, d)),
            )
        )
    pushes = replace(
        reduction.pushes,
        peak_force_se=np.hypot(reduction.pushes.peak_force_se, errors[0]),
        sliding_distance_se=np.hypot(reduction.pushes.sliding_distance_se, errors[1]),
    )
    return replace(reduction, pushes=pushes, details=tuple(details))


def _find_errors(
    recording: Recording, detail: Reduced, k: float, b: float, mass: float
) -> tuple[float, float]:
    """(of F_p [N], of d [m]): standard errors by the error of a push's smoothed motion.

    The part's speed where it leaves the tip is off by the impulse that the force's error gives it
    over half a period of the contact, and d, as the square of that speed, by twice its share.
    """
    force = recording.motion.force_error(k, b)
    lasts = np.pi * np.sqrt(mass / k)
    impulse = force * np.sqrt(min(recording.motion.memory, lasts) * lasts)
    share = impulse / mass / detail.release_velocity
    return force, float(np.nan_to_num(2 * share * detail.sliding_distance))
