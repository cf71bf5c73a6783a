"""How far a recorded pusher was from its command: y = v t up to the stroke, and then at rest.

The model moves its tip as commanded; what the recorded tip did else, the model cannot know.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from difffric.measurements.recordings import Recording
from difffric.number_text import format_number
from difffric.units import to_um

_SHORTEST = 8
"""Samples of its way that a tip must have to say how fast it was."""
_MIDDLE = (0.1, 0.9)
"""Shares of the way between which its speed is taken: it starts and stops outside."""


@dataclass(frozen=True)
class Tracking:
    """One recorded tip beside its command."""

    rms: float
    """root of the mean square deviation [m], from t = 0 to the end of the recording"""
    largest: float
    """the largest deviation [m], of either sign"""
    speed_ratio: float
    """the tip's mean speed over the commanded one; NaN where too few samples say it"""


def track_pusher(recording: Recording, stroke: float | None = None) -> Tracking | None:
    """The tip of a recording beside its command; None without a channel `pusher`, where it has no
    sample since t = 0, or where the recorded motion drives the push.

    `stroke` [m] is that of the rig, where the recording says none; without either the tip is taken
    to stop where it did. The tip's zero is arbitrary: it is read before t = 0, and where nothing
    was recorded then, the first sample since is as commanded.
    """
    if recording.pusher is None or recording.motion is not None:
        return None
    t, y = recording.pusher.time, recording.pusher.samples
    moving, v = t >= 0, recording.velocity
    if not moving.any():
        return None
    way = recording.stroke
    if np.isnan(way) and stroke is not None:
        way = float(stroke)
    quiet = y[t <= -recording.pusher.dt]
    t, y = t[moving], y[moving]
    y = y - (np.mean(quiet) if len(quiet) else y[0] - v * t[0])
    command = np.minimum(v * t, way if np.isfinite(way) else float(y[-1]))
    apart = y - command
    end = command[-1] / v
    inside = (t >= _MIDDLE[0] * end) & (t <= _MIDDLE[1] * end)
    speed = np.polyfit(t[inside], y[inside], 1)[0] if inside.sum() >= _SHORTEST else np.nan
    return Tracking(float(np.sqrt(np.mean(apart**2))), float(np.abs(apart).max()), float(speed / v))


def describe_tracking(
    recordings: Iterable[Recording], stroke: float | None = None
) -> tuple[str, ...]:
    """A note of how far the recorded tips were from their commands; none where none is recorded.

    `stroke` [m] as for `track_pusher`.
    """
    found = [(r.name, one) for r in recordings if (one := track_pusher(r, stroke)) is not None]
    if not found:
        return ()
    name, worst = max(found, key=lambda x: x[1].largest)
    rms = float(np.sqrt(np.mean([one.rms**2 for _, one in found])))
    where = f" ({name})" if name and len(found) > 1 else ""
    ratios = [one.speed_ratio for _, one in found if np.isfinite(one.speed_ratio)]
    speeds = ""
    if ratios:
        ends = dict.fromkeys(format_number(ratio, 4) for ratio in (min(ratios), max(ratios)))
        speeds = f", at {' to '.join(ends)} times its speed"
    return (
        f"the recorded pusher was up to {format_number(to_um(worst.largest), 3)} µm{where} from "
        f"its command, {format_number(to_um(rms), 3)} µm in the rms{speeds}: the model's keeps to "
        "the command",
    )
