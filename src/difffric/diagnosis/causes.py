"""A cause as it is told: its size, and what it changes."""

from __future__ import annotations

import numpy as np

from difffric.rig.catalogue import component_of, numbers_of
from difffric.diagnosis.exploration import Candidate
from difffric.diagnosis.verdict import Cause
from difffric.estimation import ensemble as en
from difffric.estimation.ensemble import Fits, Task
from difffric.rig.catalogue import CATALOGUE, RATIO

_TEXT = {RATIO: "mu_k / mu_s is not what the set-up says"}


def cause_of(
    task: Task, plain: Fits, at: Fits, candidate: Candidate, alike, predicted: float, gain: float
) -> Cause:
    """A candidate with its numbers as they are in the fit `at` (ensembles of one); `gain` on
    held-out pushes, `predicted` by the score test."""
    effect, coordinates = candidate.effect, task.model.coordinates
    C = en.covariance(task, at)[0][task.conditions :, task.conditions :]
    names = numbers_of(effect)
    keys = ["ratio" if effect == RATIO else name.partition(".")[2] for name in names]
    errors = coordinates.errors(at.c[0], names, [*task.shared, *at.extra[0]], C)
    pairs = zip(coordinates.values(at.c[0], names), errors, strict=True)
    moved = at.mu[0, task.condition] + at.own[0] - plain.mu[0, task.condition] - plain.own[0]
    force, distance = changes(task, plain, at, effect)
    return Cause(
        id=effect,
        component=component_of(effect),
        text=_TEXT.get(effect) or CATALOGUE[effect].text,
        probability=1.0,
        confusable_with=alike,
        parameters=dict(zip(keys, pairs, strict=True)),
        chi2_drop=candidate.drop,
        chi2_drop_predicted=predicted,
        p_value=candidate.p_value,
        heldout_gain=gain,
        change_mu_s=float(np.sqrt(np.mean(moved**2))),
        change_peak_force=force,
        change_sliding_distance=distance,
    )


def changes(task: Task, plain: Fits, at: Fits, effect: str) -> tuple[float, float]:
    """Relative changes (rms over the pushes) of F_p and d that an effect makes, all else as it is
    in the fit `at`."""
    index = task.model.coordinates.indices(numbers_of(effect))
    c = np.repeat(at.c, 2 * task.n, axis=0)
    c[:, 0] = np.tile(at.mu[0, task.condition] + at.own[0], 2)
    c[task.n :, index] = plain.c[0, index]
    push = np.tile(np.arange(task.n), 2)
    told = task.model.answers(push, c, np.zeros((1, c.shape[1]))).model.reshape(2, task.n, 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        change = told[0] / told[1] - 1
    change = np.where(np.isfinite(change), change, 0.0)
    force, distance = np.sqrt(np.mean(change**2, axis=0)).tolist()
    return force, distance
