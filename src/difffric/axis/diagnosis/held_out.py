"""Errors on stretches that a fit has not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from difffric.axis.motion_model import MotionModel
from difffric.axis.noise_model import NoiseProblem
from difffric.axis.preparation import PreparedRecording
from difffric.axis.search import pose_step, search
from difffric.axis.setup import COULOMB

_FOLDS = 5
"""Groups of stretches, each of which is left out once."""


def judge_held_out(
    ready: PreparedRecording,
    values: Mapping[str, float],
    names: Sequence[str],
    imposed: bool,
    sizes: np.ndarray,
    model: MotionModel,
) -> float | None:
    """Return the error on stretches held out, in units of the noise of these sizes: 1 is perfect.

    Each fold is fitted anew without its stretches, which then give their own friction level and
    nothing else. None where there is only one stretch.
    """
    stretches = sorted({run.stretch for run in ready.runs})
    if len(stretches) < 2:
        return None
    folds = [stretches[i::_FOLDS] for i in range(min(_FOLDS, len(stretches)))]
    total, count = 0.0, 0
    for fold in folds:
        is_out = [x.run.stretch in fold for x in model.runs]
        train = model.select([i for i, out in enumerate(is_out) if not out])
        test = model.select([i for i, out in enumerate(is_out) if out])
        if len({x.run.sign for x in train.runs}) < len({x.run.sign for x in model.runs}):
            continue
        end = search(train.runs, values, names, imposed, sizes, hold_noise=True, model=train)
        step = pose_step(test, test.evaluate(end.values, [COULOMB]), end.values, [COULOMB])
        present = sorted({row.stretch for row in test.rows})
        own = []
        for row, level in zip(test.rows, step.levels, strict=True):
            column = np.zeros((len(level), len(present)))
            column[:, present.index(row.stretch)] = level
            own.append(column)
        problem = NoiseProblem(test.rows, step.targets, own, step.levels)
        fixed = sizes.copy()
        fixed[-1] = 0.0
        total += problem.solve(fixed)[0].chi2
        count += problem.n - len(present)
    return float(np.sqrt(total / count)) if count else None
