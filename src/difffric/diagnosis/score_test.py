"""The score test of each effect at its null: what the effect would explain, told without a refit.

An effect at its null is the plain model. The derivative of the answers by the effect's number,
with all that is free already projected out, says to first order by how much -2 log likelihood
would drop and at which size of the effect (Rao's score test). One evaluation serves all effects.

The scatter of mu_s is estimated anew beside each effect: it has taken in what a drift does, and at
the scatter without it no drift would drop -2 log likelihood by more than the number of pushes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.diagnosis.starting_values import SMOOTH_AT_NULL
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits, NormalEquations
from difffric.rig.catalogue import KEYS, numbers_of

SIGNIFICANT = 1e-3
"""An effect is named where chance gives as much with less than this probability."""
_TRIALS, _OF_WAVES = 10, {"friction_waviness": 60}
"""How many independent looks a scan over a place, a speed or a period is worth, and one over
wavelengths that long slides tell apart."""
_LEAST_ROOM = 3
"""Numbers that one evaluation has columns for at least: the most that any effect has."""
_SCATTERS = np.geomspace(1.0, 0.03, 15)
"""Shares of the scatter without an effect that are tried beside it: a drift may explain nearly
all of it."""
OFF_NULL = {name: 1e-6 for name, (_, key) in KEYS.items() if key.inverse}
OFF_NULL |= {"pusher_lag.tau_s": 5e-4, "initial_gap.gap_m": 1e-6}
"""Coordinates near a null at which there is no derivative (of the inverse of an acceleration), none
that steps of finite length find (of a lag shorter than a step), or another one (of a gap, without
which the damper is there at once)."""


@dataclass(frozen=True)
class Score:
    """The score test of one effect at its null: no refit, linear in the effect."""

    drop: float
    """predicted drop of chi-square, the plain parameters and the scatter projected out"""
    visible: float
    """the square root of the drop that the effect would make at its typical size"""
    at: float = 0.0
    """the coordinate at which the drop is predicted; its standard error is 1 / `visible`"""


def run_score_tests(task: EnsembleTask, base: Fits, effects: Sequence[str]) -> dict[str, Score]:
    """Test each effect that has a derivative at its null on top of `base` (an ensemble of one)."""
    found: dict[str, Score] = {}
    testable = [effect for effect in effects if effect in SMOOTH_AT_NULL]
    groups = _split_into_groups(task, base, testable)
    if not groups:
        return found
    fits = ensemble.evaluate(task, ensemble.join(*(_free(task, base, x) for x in groups)))
    parts = ensemble.split_by_push(task, fits)
    shares = _SCATTERS if task.estimate_scatter and task.mu_free else _SCATTERS[:1]
    scatters = shares[:, None] * fits.scatter
    tried = [ensemble.normal_equations(task, fits, s, parts) for s in scatters]
    known = task.conditions + len(task.shared) + len(base.extra[0])
    for j, group in enumerate(groups):
        tests = [_test_group(task, base, fits.c[j], (x.H[j], x.g[j]), group) for x in tried]
        both = zip(tried, scatters[:, j], strict=True)
        left = [_predict_cost(x, j, known, s) for x, s in both]
        for effect, one in tests[0].items():
            with_it = min(x - test[effect].drop for x, test in zip(left, tests, strict=True))
            found[effect] = replace(one, drop=max(min(left) - with_it, 0.0))
    return found


def _predict_cost(tried: NormalEquations, j: int, known: int, scatter: float) -> float:
    """Return -2 log likelihood, but for a constant, of the fit j at a scatter, with the first
    `known` of its parameters where its linear model is best."""
    H, g = tried.H[j, :known, :known], tried.g[j, :known]
    step = ensemble.solve(H[None], g[None])[0]
    return float(tried.cost[j] + g @ step + np.log1p(scatter**2 * tried.z[j]).sum())


def _split_into_groups(task: EnsembleTask, base: Fits, effects: Sequence[str]) -> list[list[str]]:
    """Split effects into groups whose numbers the compiled program has directions for."""
    room = task.model.directions - 1 - len(task.shared) - len(base.extra[0])
    room = max(room, _LEAST_ROOM)
    groups: list[list[str]] = []
    for effect in effects:
        size = sum(len(numbers_of(x)) for x in groups[-1]) if groups else room
        if size + len(numbers_of(effect)) > room:
            groups.append([])
        groups[-1].append(effect)
    return groups


def _free(task: EnsembleTask, base: Fits, effects: Sequence[str]) -> Fits:
    """Return `base` with the numbers of effects free, where they have derivatives."""
    indices = task.model.coordinates.indices
    extra = (*base.extra[0], *(i for effect in effects for i in indices(numbers_of(effect))))
    return step_off_null(task, replace(base, extra=(extra,)))


def _test_group(
    task: EnsembleTask,
    base: Fits,
    c: NDArray,
    equations: tuple[NDArray, NDArray],
    effects: Sequence[str],
) -> dict[str, Score]:
    """Test effects whose numbers are free together at the coordinates c (K,), by the normal
    equations (H, g) there."""
    coordinates, (H, g) = task.model.coordinates, equations
    index = [coordinates.indices(numbers_of(effect)) for effect in effects]
    first = known = task.conditions + len(task.shared) + len(base.extra[0])
    found: dict[str, Score] = {}
    for effect, own in zip(effects, index, strict=True):
        mine = np.arange(first, first + len(own))
        first += len(own)
        S, r = _project_out(H, g, np.arange(known), mine)
        information = max(float(S[0, 0]), 0.0)
        if information < 1e-6 * max(H[mine[0], mine[0]], 1e-12):
            found[effect] = Score(0.0, 0.0)
            continue
        step = -np.linalg.solve(S, r)
        drop = float(r @ -step)
        if len(own) == 1:  # bounded at its null: what leads out of bounds explains nothing
            low, high = coordinates.bounds(coordinates.names[own[0]])
            drop *= low <= base.c[0, own[0]] + step[0] <= high
        at_best = float(c[own[0]] + step[0])
        found[effect] = Score(drop, float(np.sqrt(information)), at_best)
    return found


def _project_out(H: NDArray, g: NDArray, known: NDArray, mine: NDArray) -> tuple[NDArray, NDArray]:
    """Return the information and the gradient of the columns `mine` of normal equations (H, g),
    the columns `known` at their best for each value of these."""
    A = H[np.ix_(known, known)]
    scale = np.sqrt(np.maximum(np.diag(A), 1e-12))
    solve = np.linalg.pinv(A / np.outer(scale, scale), rcond=1e-12)
    X = H[np.ix_(known, mine)] / scale[:, None]
    S = H[np.ix_(mine, mine)] - X.T @ solve @ X
    r = g[mine] - X.T @ solve @ (g[known] / scale)
    return S, r


def step_off_null(task: EnsembleTask, fits: Fits) -> Fits:
    """Move free coordinates that have no derivative at their null to where they have one.

    All `fits` have the same numbers free.
    """
    c = fits.c.copy()
    for i in fits.extra[0]:
        name = task.model.coordinates.names[i]
        if name in OFF_NULL:
            c[:, i] = np.maximum(c[:, i], OFF_NULL[name])
    return replace(fits, c=c, gram=None, residual=None)


def compute_p_value(effect: str, drop: float, effects: int) -> float:
    """Return the probability of so large a drop of -2 log likelihood without any effect.

    `effects` is the number of effects that were looked for: they, and the looks that a scan of
    this one takes, are all counted (Bonferroni).
    """
    tail = scipy.stats.chi2.sf(max(drop, 0.0), len(numbers_of(effect)))
    return float(min(1.0, tail * count_looks(effect, effects)))


def count_looks(effect: str, effects: int) -> int:
    """Return how many independent looks a search among so many `effects` is worth that finds this
    one."""
    return effects * (1 if effect in SMOOTH_AT_NULL else _OF_WAVES.get(effect, _TRIALS))
