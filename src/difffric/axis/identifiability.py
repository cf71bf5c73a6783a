"""What a recording of an axis leaves open, why, and which stretch would settle it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from difffric.axis.preparation import PreparedRecording
from difffric.axis.setup import COULOMB, MASS, OFFSET, VISCOUS, AxisSetup

_SAME_SPEED = 1.1
"""Ratio of the fastest run's speed to the slowest's up to which it is one speed."""
_CLEARLY_OTHER = 1.5
"""The same where the motion is imposed, and friction that builds up makes runs differ."""
_STEADY = 0.1
"""Share of its mean by which the speed varies within a run at most, for it to be one speed."""


def find_open(
    ready: PreparedRecording, setup: AxisSetup, names: Sequence[str], imposed: bool
) -> tuple[list[str], list[dict]]:
    """Return the free parameters to hold at the set-up's values, and what to say of each."""
    held, said = [], []
    signs = {run.sign for run in ready.runs}
    if len(signs) == 1 and OFFSET in names and COULOMB in names:
        word = "forwards" if signs == {1} else "backwards"
        held.append(OFFSET)
        said.append(
            {
                "parameters": [OFFSET, COULOMB],
                "reason": f"the axis moves {word} only, where an offset acts as Coulomb friction "
                f"does: the offset is held at {setup.offset:g} N, and coulomb_N holds for that",
                "next_stretch": "the same move back",
            }
        )
    if imposed and MASS in names:
        held.append(MASS)
        said.append(
            {
                "parameters": [MASS],
                "reason": "the forces of inertia drown in what else the force does (the motion is "
                f"too slow, or imposed by something else): the mass is held at {setup.mass:g} kg",
                "next_stretch": "a move with several times the acceleration",
            }
        )
    speeds, spread = _measure_speeds(ready)
    ratio = max(x.max() / x.min() for x in speeds)
    steady = spread < _STEADY or imposed
    is_one = steady and ratio < (_CLEARLY_OTHER if imposed else _SAME_SPEED)
    if is_one and VISCOUS in names and COULOMB in names:
        held.append(VISCOUS)
        said.append(_describe_one_speed(speeds, setup))
    return held, said


def _describe_one_speed(speeds: Sequence[np.ndarray], setup: AxisSetup) -> dict:
    means = [float(x.mean()) for x in speeds]
    usual = float(np.mean(means))
    said = " and back at ".join(f"{x:.3g} m/s" for x in means)
    return {
        "parameters": [VISCOUS, COULOMB],
        "reason": f"each way the axis moves at one speed ({said}), where viscous friction is as "
        f"constant as Coulomb friction: k_v is held at {setup.k_v:g} N s/m, and coulomb_N holds "
        "for that",
        "next_stretch": f"moves both ways at {3 * usual:.2g} m/s or {usual / 3:.2g} m/s",
    }


def _measure_speeds(ready: PreparedRecording) -> tuple[list[np.ndarray], float]:
    """Mean speed in each stretch [m/s], of each direction by itself, and by how much the speed
    varies within a run at most, as a share of it."""
    own: dict[tuple[int, int], list[np.ndarray]] = {}
    spread = 0.0
    for run, data in zip(ready.runs, ready.run_data, strict=True):
        speed = np.abs(data.point.speed)
        own.setdefault((run.sign, run.stretch), []).append(speed)
        spread = max(spread, float(np.std(speed) / np.mean(speed)))
    means = {key: float(np.mean(np.concatenate(speeds))) for key, speeds in own.items()}
    by_sign = [[v for (sign, _), v in means.items() if sign == s] for s in (1, -1)]
    return [np.array(x) for x in by_sign if x], spread
