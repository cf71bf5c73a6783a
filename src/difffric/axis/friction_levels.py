"""The friction level of each stretch: what `identify` gives for an axis."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from difffric.axis.motion_model import MotionModel
from difffric.axis.noise_model import NoiseProblem
from difffric.axis.one_thread import hold_one_thread
from difffric.axis.preparation import PreparedRecording, keep_sliding, prepare_recording
from difffric.axis.recordings import AxisRecordings
from difffric.axis.result import AxisFit, AxisLevels, FrictionLevel
from difffric.axis.search import SearchEnd, find_start, pose_step
from difffric.axis.setup import COULOMB, MASS, VISCOUS, AxisSetup
from difffric.progress import Tell, silent

_STILL = "the axis does not move clearly in this stretch"


def find_levels(ready: PreparedRecording, end: SearchEnd) -> tuple[FrictionLevel, ...]:
    """Return each stretch's Coulomb friction with all else as fitted, whose errors are counted
    in."""
    others = [x for x in end.names if x != COULOMB]
    keep = [i for i, x in enumerate(end.names) if x != COULOMB]
    covariance = end.noise.covariance[np.ix_(keep, keep)]
    known = dict(zip(others, range(len(others)), strict=True))
    return _estimate(ready, end.values, end.imposed, known, covariance, end.noise.sizes)


def identify_axis(
    setup: AxisSetup | AxisFit, data: AxisRecordings, *, tell: Tell = silent
) -> AxisLevels:
    """Return the Coulomb friction of each stretch, by the set-up's other numbers, whose standard
    errors are counted in.

    Raises `InputError` where the data cannot be used.
    """
    setup = setup.setup if isinstance(setup, AxisFit) else setup
    tell("cutting the recording", 0.05)
    ready = prepare_recording(data, setup)
    with hold_one_thread():
        tell("identifying", 0.4)
        _, imposed = find_start(ready.run_data, setup.values, list(setup.values)[:1])
        ready = keep_sliding(ready) if imposed else ready
        said = {
            name: extras.standard_error
            for name, extras in setup.extras.items()
            if extras.standard_error and name in setup.values and name != COULOMB
        }
        said.pop("breakaway_N", None)
        known = {name: i for i, name in enumerate(said)}
        covariance = np.diag([x**2 for x in said.values()]) if said else np.zeros((0, 0))
        return AxisLevels(_estimate(ready, setup.values, imposed, known, covariance, None))


def _estimate(
    ready: PreparedRecording,
    values: Mapping[str, float],
    imposed: bool,
    known: Mapping[str, int],
    covariance: np.ndarray,
    sizes: np.ndarray | None,
) -> tuple[FrictionLevel, ...]:
    """Each stretch's level as a parameter of its own."""
    rate = 0.0 if imposed else max(values[VISCOUS] / values[MASS], 0.0)
    model = MotionModel(ready.run_data, rate, imposed)
    found = model.evaluate(values, list(known) or [COULOMB])
    step = pose_step(model, found, values, list(known) or [COULOMB])
    present = sorted({row.stretch for row in model.rows})
    own = []
    for row, level in zip(model.rows, step.levels, strict=True):
        column = np.zeros((len(level), len(present)))
        column[:, present.index(row.stretch)] = level
        own.append(column)
    problem = NoiseProblem(model.rows, step.targets, own, step.levels)
    without = [len(problem.rows[0].kernels)]
    if sizes is None:
        noise = problem.fit(without=without)
    else:
        fixed = sizes.copy()
        fixed[-1] = 0.0
        noise = problem.solve(fixed)[0]
    noise = problem.weigh_equally(noise) if imposed else noise
    variance = np.diag(noise.covariance).copy()
    if known:
        # What the levels answer to the other numbers: solve with their columns as targets.
        slopes = np.empty((len(present), len(known)))
        for k in range(len(known)):
            targets = [x[:, k] for x in step.columns]
            moved = NoiseProblem(model.rows, targets, own, step.levels).solve(noise.sizes)[0]
            slopes[:, k] = moved.step
        variance += np.einsum("ij,jk,ik->i", slopes, covariance, slopes)
    answers = []
    for k, stretch in enumerate(ready.data.stretches):
        if k not in present:
            answers.append(FrictionLevel(stretch.name, stretch.condition, None, None, _STILL))
            continue
        i = present.index(k)
        value = values[COULOMB] * (1 + float(noise.step[i]))
        error = values[COULOMB] * float(np.sqrt(variance[i]))
        answers.append(FrictionLevel(stretch.name, stretch.condition, value, error))
    return tuple(answers)
