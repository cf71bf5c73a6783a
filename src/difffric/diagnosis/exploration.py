"""The search for one more cause: score test, scan over sizes, refits, held-out pushes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.diagnosis.candidates import LOCAL, grid
from difffric.diagnosis.shape_scan import SHAPED, shape_starts, within_the_way
from difffric.estimation import ensemble as en
from difffric.estimation import ensemble_refits
from difffric.estimation.ensemble import Fits, Task, subset_of
from difffric.rig.catalogue import KEYS, RATIO, numbers_of
from difffric.rig.scales import Scales

_LEADERS, _SCORED = 5, 3
"""Effects that are refitted to all pushes: the best of the scan, and of the score test."""
_BLIND = 1.0
"""Standard deviations at its typical size below which an effect's score test sees nothing."""
_TESTED = 6
"""Effects that the score tests choose where the misfit is small."""
_TRIALS = 10
"""How many independent looks a scan over a wavelength, a place or a speed is worth."""
_ROUNDS = 15
_SURE, _FAIR = 3, 0.3
_REOWNED = 14
"""Fits of a scan whose pushes' own mu_s are looked for afresh."""
_BESIDE = {name: 1e-6 for name, (_, key) in KEYS.items() if key.inverse}
_BESIDE |= {"pusher_lag.tau_s": 5e-4}
"""Coordinates beside a null at which there is no derivative (of the inverse of an acceleration), or
none that steps of finite length find (of a lag shorter than a step)."""


@dataclass(frozen=True)
class Score:
    """The score test of one effect at its null: no refit, linear in the effect."""

    drop: float
    """predicted drop of chi-square, the plain parameters and the scatter projected out"""
    visible: float
    """the square root of the drop that the effect would make at its typical size"""
    at: float = 0.0
    """the coordinate where it leads; its standard error is 1 / `visible`"""


@dataclass(frozen=True)
class Candidate:
    """One effect, refitted on top of what is there already."""

    effect: str
    fits: Fits
    """an ensemble of one"""
    drop: float
    """of -2 log likelihood, against the fit without it"""
    predicted: float
    p_value: float
    """of so large a drop by chance, all effects and looks counted"""
    penalised_drop: float
    """less what its numbers would buy in any case"""


def score_tests(task: Task, base: Fits, effects: Sequence[str]) -> dict[str, Score]:
    """The score test of each effect that has one."""
    coordinates = task.model.coordinates
    room = task.model.directions - 1 - len(task.shared) - len(base.extra[0])
    room = max(room, 3)
    local = [e for e in effects if e in LOCAL]
    out = {}
    chunks: list[list[str]] = []
    for e in local:
        size = sum(len(numbers_of(x)) for x in chunks[-1]) if chunks else room
        if size + len(numbers_of(e)) > room:
            chunks.append([])
        chunks[-1].append(e)
    for chunk in chunks:
        index = [[coordinates.index(x) for x in numbers_of(e)] for e in chunk]
        extra = (*base.extra[0], *(i for one in index for i in one))
        at = en.evaluated(task, beside_null(task, replace(base, extra=(extra,))))
        found = en.normal(task, at)
        H, g = found.H[0], found.g[0]
        known = task.conditions + len(task.shared) + len(base.extra[0])
        keep = np.arange(known)
        first = known
        for e, own in zip(chunk, index, strict=True):
            mine = np.arange(first, first + len(own))
            first += len(own)
            A = H[np.ix_(keep, keep)]
            scale = np.sqrt(np.maximum(np.diag(A), 1e-12))
            solve = np.linalg.pinv(A / np.outer(scale, scale), rcond=1e-12)
            X = H[np.ix_(keep, mine)] / scale[:, None]
            S = H[np.ix_(mine, mine)] - X.T @ solve @ X
            r = g[mine] - X.T @ solve @ (g[keep] / scale)
            information = max(float(S[0, 0]), 0.0)
            if information < 1e-6 * max(H[mine[0], mine[0]], 1e-12):
                out[e] = Score(0.0, 0.0)
                continue
            step = -np.linalg.solve(S, r)
            drop = float(r @ -step)
            if len(own) == 1:  # bounded at its null: what leads out of bounds explains nothing
                low, high = coordinates.bounds(coordinates.names[own[0]])
                drop *= low <= base.c[0, own[0]] + step[0] <= high
            out[e] = Score(drop, float(np.sqrt(information)), float(at.c[0, own[0]] + step[0]))
    return out


def beside_null(task: Task, fits: Fits) -> Fits:
    """The fits (all with the same numbers free) where what is free has a derivative."""
    c = fits.c.copy()
    for i in fits.extra[0]:
        name = task.model.coordinates.names[i]
        if name in _BESIDE:
            c[:, i] = np.maximum(c[:, i], _BESIDE[name])
    return replace(fits, c=c, gram=None, residual=None)


def starts_of(
    task: Task, base: Fits, effect: str, scales: Scales, some: NDArray, far: bool = True
) -> Fits:
    """Starts for one effect on top of `base` (an ensemble of one), wherever it may be."""
    if effect in SHAPED:
        return shape_starts(task, base, effect, scales, some, far)
    coordinates = task.model.coordinates
    rows = np.array([coordinates.point(values) for values in grid(effect, scales)])
    fits = _at(task, base, effect, rows)
    if effect == RATIO:  # what slides stays as it is, and mu_s with what sticks moves
        mine = coordinates.indices(numbers_of(effect))
        fits = replace(fits, mu=fits.mu - (rows - base.c[:, mine]))
    return fits


def promising(task: Task, base: Fits, effect: str, scales: Scales) -> bool:
    """Whether one step from any size on an effect's grid promises to be better than `base`, on some
    pushes."""
    some = subset_of(task)
    fits = en.evaluated(task, starts_of(task, base, effect, scales, some), some)
    _, promised = _promised(task, fits)
    return bool(promised.min() < en.penalised(task, base, some)[0])


def score_starts(
    task: Task, base: Fits, effects: Sequence[str], scores: dict[str, Score]
) -> tuple[Fits, list[str]]:
    """Where the score tests lead, the rest of the model where it would be beside each effect; for
    effects that explain anything."""
    known = [e for e in effects if e in scores and scores[e].drop > 0]
    if not known:
        return base.pick(np.zeros(0, int)), known
    parts = []
    for e in known:
        index = task.model.coordinates.indices(numbers_of(e))
        parts.append(beside_null(task, _at(task, base, e, base.c[:, index])))
    fits = en.evaluated(task, en.together(*parts))
    return replace(ensemble_refits.moved(task, fits, 0.0), residual=None), known


def _at(task: Task, base: Fits, effect: str, rows: NDArray) -> Fits:
    """`base` with these coordinates (m, numbers) of an effect, which are free."""
    index = task.model.coordinates.indices(numbers_of(effect))
    fits = base.pick(np.zeros(len(rows), int))
    c = fits.c.copy()
    c[:, index] = rows
    extra = ((*base.extra[0], *index),) * len(rows)
    return replace(fits, extra=extra, c=c, gram=None, residual=None, damping=None)


def explore(
    task: Task,
    base: Fits,
    effects: Sequence[str],
    scales: Scales,
    scores: dict[str, Score],
    tell: Callable[[float], None] = lambda share: None,
    far: bool = True,
) -> list[Candidate]:
    """The leading effects, each refitted on top of `base`, the best first.

    `far`: whether the misfit is so large that what is linear at an effect's null may be wrong.
    """
    search = _far if far else _near
    fits, behind = search(task, base, list(effects), scales, scores, tell)
    before = float(en.criterion(task, base)[0])
    fits, behind = _within_reach(task, fits, behind, before)
    fits = ensemble_refits.refitted(
        task, ensemble_refits.reowned(task, fits) if far else fits, _ROUNDS
    )
    again = ensemble_refits.reowned(task, fits) if far else ensemble_refits.resettled(task, fits)
    fits = ensemble_refits.refitted(task, again, _ROUNDS) if again is not fits else fits
    tell(0.95)
    value = en.criterion(task, fits)
    out = []
    for j in range(fits.m):
        effect = behind[j]
        if not within_the_way(task, fits.c[j], effect, scales):
            continue
        drop = before - float(value[j])
        k = len(numbers_of(effect))
        out.append(
            Candidate(
                effect, fits.pick([j]), drop, _drop(scores.get(effect)),
                p_value(effect, drop, len(effects)), drop - k * task.price,
            )
        )  # fmt: skip
    return sorted(out, key=lambda c: -c.penalised_drop)


def _near(task: Task, base: Fits, effects: list[str], scales, scores, tell):
    """(the leading effects' fits, their names) where what is linear at the null is right: the
    score tests choose, and all pushes are looked at, as each may hold what little there is. What a
    score test does not see (a dwell, where nothing sticks at the null) is looked for on a grid."""
    by_score = sorted((e for e in effects if e in scores), key=lambda e: -scores[e].drop)
    fits, behind = score_starts(task, base, by_score[:_TESTED], scores)
    parts = [fits] if fits.m else []
    for e in effects:
        if e not in scores or scores[e].visible < _BLIND:
            new = starts_of(task, base, e, scales, np.arange(task.n), far=False)
            parts.append(new)
            behind = [*behind, *[e] * new.m]
    fits = en.evaluated(task, en.together(*parts))
    tell(0.3)
    _, promised = _promised(task, fits)
    keep = []
    for e in dict.fromkeys(behind):
        mine = np.array([j for j, x in enumerate(behind) if x == e])
        keep += mine[np.argsort(promised[mine])[:2]].tolist()
    fits, behind = ensemble_refits.refitted(task, fits.pick(keep), 3), [behind[j] for j in keep]
    # What shows only where a push sticks is a matter of branches.
    jumps = [j for j, e in enumerate(behind) if e not in scores or scores[e].visible < _BLIND]
    if jumps:
        branch = ensemble_refits.resettled(task, fits.pick(jumps))
        fits = ensemble_refits.replaced(
            fits, np.array(jumps), ensemble_refits.refitted(task, branch, 3)
        )
    tell(0.6)
    cost = en.criterion(task, fits)
    charged = cost + task.price * np.array([len(numbers_of(e)) for e in behind])
    best = sorted(_first_of_each(cost, behind), key=lambda j: charged[j])[:_LEADERS]
    return fits.pick(best), [behind[j] for j in best]


def _far(task: Task, base: Fits, effects: list[str], scales, scores, tell):
    """The same where the misfit is large: sizes on a grid, from some pushes to all of them."""
    # A table's pushes are followed in less time: all of them, by more effects.
    quick = not task.model.recordings
    some = np.arange(task.n) if quick else subset_of(task)
    # Beside a strong effect the plain fit has bent each push's own mu_s: start from equal ones too.
    bases = [base, replace(base, own=np.zeros_like(base.own))] if task.mu_free else [base]
    starts = [starts_of(task, at, e, scales, some) for at in bases for e in effects]
    from_ = np.concatenate([np.full(s.m, k) for k, s in enumerate(starts)])
    fits, owner = en.evaluated(task, en.together(*starts), some), from_ % len(effects)
    tell(0.25)
    cost, promised = _promised(task, fits)
    # Of each effect the best by what one step promises, and the best as it stands.
    keep = set()
    for k in dict.fromkeys(from_.tolist()):
        mine = np.flatnonzero(from_ == k)
        keep |= {mine[np.argmin(promised[mine])], mine[np.argmin(cost[mine])]}
    keep = np.array(sorted(keep))
    fits, owner = ensemble_refits.refitted(task, fits.pick(keep), 3, some), owner[keep]
    tell(0.5)
    first = np.argsort(en.settled_cost(task, fits))[:_REOWNED]
    fits, owner = ensemble_refits.reowned(task, fits.pick(first), some), owner[first]
    fits = ensemble_refits.refitted(task, fits, 2, some)
    fits, owner = _best_of_each(task, fits, owner)
    fits = ensemble_refits.refitted(task, fits, 4, some)
    tell(0.65)
    subset_cost = en.criterion(task, fits)
    leaders = list(np.argsort(subset_cost)[: 2 * _LEADERS if quick else _LEADERS])
    fits, owner = fits.pick(leaders), owner[leaders]
    starts = _on_all(task, base, fits, effects, owner, some)
    behind = np.tile(owner, 2)
    # And from where the score tests lead, whatever became of those effects on the grid.
    by_score = sorted((e for e in effects if e in scores), key=lambda e: -scores[e].drop)
    near_ones = dict.fromkeys([*(effects[int(k)] for k in owner), *by_score[:_SCORED]])
    near, known = score_starts(task, base, list(near_ones), scores)
    starts = en.evaluated(task, en.together(starts, near) if near.m else starts)
    behind = np.append(behind, [effects.index(e) for e in known]).astype(int)
    first = _first_of_each(_promised(task, starts)[1], behind)
    fits, owner = ensemble_refits.refitted(task, starts.pick(first), 2), behind[first]
    return fits, [effects[int(k)] for k in owner]


def _within_reach(task: Task, fits: Fits, names, before: float) -> tuple[Fits, list[str]]:
    """Those that explain a fair share of what the best does by now, and the first few."""
    gain = before - en.criterion(task, fits)
    order = np.argsort(-gain)
    keep = [j for k, j in enumerate(order) if k < _SURE or gain[j] > _FAIR * gain[order[0]]]
    return fits.pick(keep), [names[j] for j in keep]


def _on_all(task: Task, base: Fits, fits: Fits, effects, owner, some) -> Fits:
    """Fits to some pushes as starts for all of them: as they are, each other push's own mu_s as
    far beyond them as in `base`; and with nothing but the effect's numbers taken over."""
    bare = replace(fits, gram=None, residual=None, damping=None)
    now, before = ((f.mu[:, task.condition] + f.own) for f in (bare, base))
    total = before + (now - before)[:, some].mean(axis=1, keepdims=True)
    total[:, some] = now[:, some]
    whole = replace(bare, own=total - bare.mu[:, task.condition])
    back = base.pick(np.zeros(fits.m, int))
    c = back.c.copy()
    for j, k in enumerate(owner):
        index = [task.model.coordinates.index(x) for x in numbers_of(effects[int(k)])]
        c[j, index] = fits.c[j, index]
    alone = replace(back, extra=fits.extra, c=c, gram=None, residual=None, damping=None)
    return en.together(whole, alone)


def _drop(score: Score | None) -> float:
    return 0.0 if score is None else score.drop


def p_value(effect: str, drop: float, effects: int) -> float:
    """Of so large a drop without any effect, all effects and looks counted (Bonferroni)."""
    looks = 1 if effect in LOCAL else _TRIALS
    return float(
        min(1.0, scipy.stats.chi2.sf(max(drop, 0.0), len(numbers_of(effect))) * looks * effects)
    )


def _promised(task: Task, fits: Fits) -> tuple[NDArray, NDArray]:
    """(m,) the cost as it stands, and what one step promises."""
    found = en.normal(task, fits)
    gain = np.einsum("mp,mp->m", en.solve(found.H, found.g), found.g)
    return found.cost, found.cost + np.minimum(gain, 0.0)


def _first_of_each(cost: NDArray, owner: Sequence | NDArray) -> list[int]:
    """The number of the least cost of each owner's."""
    best: dict = {}
    for j, k in enumerate(owner):
        if k not in best or cost[j] < cost[best[k]]:
            best[k] = j
    return list(best.values())


def _best_of_each(task: Task, fits: Fits, owner: NDArray) -> tuple[Fits, NDArray]:
    best = _first_of_each(en.criterion(task, fits), owner)
    return fits.pick(best), owner[best]
