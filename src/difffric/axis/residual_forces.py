"""Forces and positions as a person looks at them: friction over speed, and each run predicted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from difffric.axis.effects import EFFECTS, Point, list_effect_keys
from difffric.axis.motion_model import MotionModel, RunData
from difffric.axis.result import AxisFit
from difffric.axis.setup import COULOMB, MASS, OFFSET, VISCOUS


@dataclass(frozen=True)
class MeasuredFriction:
    """Speed and friction at samples of all runs (n,), averaged over some hundredths of a second."""

    speed: NDArray
    position: NDArray
    friction: NDArray
    """what the drive gave less the force of inertia [N]"""
    law: NDArray
    """what the fitted law says [N]"""
    sign: NDArray


@dataclass(frozen=True)
class PredictedRun:
    """One run: positions (n,) as measured and as predicted from its own best start."""

    time: NDArray
    measured: NDArray
    predicted: NDArray


_SMOOTH = 0.04
"""Seconds that drawn forces are averaged over."""


def measure_friction(fit: AxisFit) -> MeasuredFriction:
    """Return the friction that the samples show, beside the fitted law."""
    v = fit.setup.values
    parts: list[tuple[NDArray, ...]] = []
    for run in fit.runs:
        step = run.tau[-1] / (len(run.tau) - 1)
        width = max(1, round(_SMOOTH / step))
        delay = v.get("drive_delay.delay_s", 0.0)
        late = max(0, round(delay / step))
        drive = run.force if fit.imposed else run.smooth_force
        force = np.concatenate([np.full(late, drive[0]), drive])[: len(drive)]
        left = force + v[OFFSET] - v[MASS] * run.acceleration * (not fit.imposed)
        smooth = uniform_filter1d(left, width)
        law = compute_friction(fit, run.point)
        inside = slice(width // 2, max(len(left) - width // 2, width // 2 + 1))
        sign = np.full(len(left), run.run.sign)
        speed, law = (uniform_filter1d(x, width) for x in (run.point.speed, law))
        columns = (speed, run.point.position, smooth, law, sign)
        parts.append(tuple(x[inside] for x in columns))
    speed, position, friction, law, sign = (
        np.concatenate([part[i] for part in parts]) for i in range(5)
    )
    return MeasuredFriction(speed, position, friction, law, sign)


def compute_friction(fit: AxisFit, point: Point) -> NDArray:
    """Return the friction and other resistance of a fitted axis at points (n,) [N]."""
    v = fit.setup.values
    law = point.sign * v[COULOMB] + v[VISCOUS] * point.speed
    for effect in [x for x in EFFECTS if x in fit.setup.effects and not EFFECTS[x].delays]:
        sizes = [v[key] for key in list_effect_keys(effect)]
        law = law + EFFECTS[effect].law.resist(point, v, *sizes)
    return law


def predict_runs(fit: AxisFit) -> list[PredictedRun]:
    """Return the positions of each run's blocks as measured, and as the fitted axis gives them
    with the friction level of the stretch."""
    v = fit.setup.values
    rate = max(v[VISCOUS] / v[MASS], 0.0)
    model = MotionModel(fit.runs, rate)
    found = model.evaluate(v, [COULOMB])
    shares = {k: (x.coulomb or v[COULOMB]) / v[COULOMB] - 1.0 for k, x in enumerate(fit.levels)}
    return [
        _predict(
            model, k, run, found.errors[k] + shares[run.run.stretch] * found.levels[k], v[MASS]
        )
        for k, run in enumerate(fit.runs)
    ]


def _predict(model: MotionModel, k: int, run: RunData, error: NDArray, mass: float) -> PredictedRun:
    """The run with its error in the rows put back into positions."""
    keep = model.rows[k].keep
    means = np.add.reduceat(run.tau, run.edges) / run.per_block
    x = np.add.reduceat(run.point.position, run.edges) / run.per_block
    return PredictedRun(run.begin + means, x, x - keep @ error / mass)
