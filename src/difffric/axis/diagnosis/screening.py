"""A look at every effect at once: what each would explain, under the noise as it was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from difffric.axis.effects import EFFECTS, list_effect_keys
from difffric.axis.motion_model import MotionModel
from difffric.axis.noise_model import NoiseProblem
from difffric.axis.preparation import PreparedRecording
from difffric.axis.search import SearchEnd, pose_step
from difffric.axis.setup import BREAKAWAY, COULOMB, MASS


@dataclass(frozen=True)
class Promise:
    """What an effect would explain."""

    effect: str
    drop: float
    """of chi-square, by its best grid point"""
    looks: int
    """independent places of the grid that it was looked for at"""
    start: dict[str, float]
    """its numbers, and others that it needs, where a fit begins"""
    names: tuple[str, ...]
    """what is then free in addition"""


_FINEST_PERIOD = 40.0
"""Periods in the range of motion at most."""
_PER_PERIOD = 3
"""Grid points in a period more or less over the range."""
_SPEEDS = 14
"""Grid points of a Stribeck speed, and of the speed of strengthening."""


def screen_effects(
    ready: PreparedRecording, end: SearchEnd, candidates: Sequence[str]
) -> list[Promise]:
    """Return what each candidate promises beside the parameters that were fitted."""
    model = end.model
    problem = pose_step(model, model.evaluate(end.values, end.names), end.values, end.names)
    scale = 1.0 if end.imposed else 1.0 / end.values[MASS]
    found = []
    for effect in candidates:
        shapes = _list_shapes(ready, end, effect)
        if not shapes:
            continue
        promise = _find_best(model, problem, end, effect, shapes, scale)
        if promise is not None:
            found.append(promise)
    return found


@dataclass(frozen=True)
class _GridPoint:
    """A point of an effect's grid: what the effect is there per unit of what is linear in it."""

    grid: Mapping[str, float]
    columns: Sequence[Sequence[NDArray]]
    """a run, then a linear size: forces (n,)"""


def _list_shapes(ready: PreparedRecording, end: SearchEnd, effect: str) -> list[_GridPoint]:
    """All points of an effect's grid."""
    runs, v = ready.run_data, end.values
    points = [run.point for run in runs]
    law = EFFECTS[effect].law
    keys = list_effect_keys(effect)
    if effect in ("cogging", "friction_waviness"):
        place = np.concatenate([p.position for p in points])
        extent = float(np.ptp(place))
        if extent <= 0:
            return []
        waves = np.arange(0.5, _FINEST_PERIOD, 1.0 / _PER_PERIOD)
        shapes = []
        for period in extent / waves:
            both = [[law.resist(p, v, 1.0, period, phase) for phase in (0.0, np.pi / 2)]
                    for p in points]  # fmt: skip
            shapes.append(_GridPoint({keys[1]: float(period)}, both))
        return shapes
    usual = ready.usual_speed
    if effect == "stribeck":
        return [
            _GridPoint(
                {keys[0]: float(speed)},
                [[p.sign * np.exp(-((p.speed / speed) ** 2))] for p in points],
            )
            for speed in np.geomspace(0.01 * usual, 0.7 * usual, _SPEEDS)
        ]
    if effect == "friction_strengthening":
        return [
            _GridPoint({keys[1]: float(speed)}, [[law.resist(p, v, 1.0, speed)] for p in points])
            for speed in np.geomspace(0.003 * usual, 0.5 * usual, _SPEEDS)
        ]
    if effect == "friction_direction":
        return [_GridPoint({}, [[law.resist(p, v, 0.0, 1.0)] for p in points])]
    if effect == "drive_delay":
        return [_GridPoint({}, [])]
    if effect == "friction_drift" and len(ready.data) < 3:
        return []
    return [_GridPoint({}, [[law.resist(p, v, 1.0)] for p in points])]


def _find_best(
    model: MotionModel,
    problem: NoiseProblem,
    end: SearchEnd,
    effect: str,
    shapes: Sequence[_GridPoint],
    scale: float,
) -> Promise | None:
    """The best point of an effect's grid."""
    v, keys = end.values, list_effect_keys(effect)
    runs = range(len(model.runs))
    if effect == "drive_delay":
        if model.imposed:
            return None
        width = 1
        slopes = model.evaluate({**v, keys[0]: 0.0}, [keys[0]]).slopes
        extra = [scale * x for x in slopes]
    else:
        width = len(shapes[0].columns[0])
        extra = [
            scale * model.respond_to(
                k, np.column_stack([force for s in shapes for force in s.columns[k]])
            )
            for k in runs
        ]  # fmt: skip
    drops = problem.screen(end.noise.sizes, extra, width)
    best = int(np.argmax(drops))
    size = _solve_size(problem, end, [x[:, best * width : (best + 1) * width] for x in extra])
    start, names, numbers = _make_start(effect, keys, shapes[best].grid, size, v)
    if start is None:
        return None
    looks = max(1, len(shapes) // _PER_PERIOD)
    return Promise(effect, float(drops[best]), looks, {**numbers, **start}, names)


def _solve_size(problem: NoiseProblem, end: SearchEnd, extra: Sequence[NDArray]) -> NDArray:
    """The best linear sizes of a shape beside all other parameters."""
    columns = [np.column_stack(x) for x in zip(problem.columns, extra, strict=True)]
    wider = NoiseProblem(problem.rows, problem.targets, columns, problem.levels)
    return wider.solve(end.noise.sizes)[0].step[problem.p :]


def _make_start(
    effect: str,
    keys: Sequence[str],
    grid: Mapping[str, float],
    size: NDArray,
    v: Mapping[str, float],
) -> tuple[dict[str, float] | None, tuple[str, ...], dict[str, float]]:
    """Where a fit with an effect begins, what is then free, and the numbers of the grid; None
    where the sign is not the effect's."""
    numbers = dict(grid)
    if effect in ("cogging", "friction_waviness"):
        amplitude = float(np.hypot(*size))
        phase = float(np.arctan2(size[1], size[0]))
        return {keys[0]: amplitude, keys[2]: phase}, tuple(keys), numbers
    if effect == "stribeck":
        if size[0] <= 0:
            return None, (), numbers
        coulomb = v[COULOMB]
        start = {BREAKAWAY: coulomb + float(min(size[0], 3 * coulomb))}
        return start, (keys[0], BREAKAWAY), numbers
    if effect == "friction_strengthening":
        if size[0] <= 0:
            return None, (), numbers
        return {keys[0]: float(size[0])}, tuple(keys), numbers
    if effect == "friction_direction":
        return {keys[0]: 0.0, keys[1]: float(size[0])}, (keys[1],), numbers
    return {keys[0]: float(size[0])}, (keys[0],), numbers
