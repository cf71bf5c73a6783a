"""Each push's own mu_s, found push by push while the shared parameters are held.

d jumps with mu_s where a regime ends, and a d may belong to several mu_s: a search from one side
may stay on the wrong one. With the shared parameters held the pushes are independent, so that each
takes steps of its own length, and one that has arrived is followed no more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.descent import Model, Settled, clip_starts, descend, respond_at
from difffric.estimation.following.thread_pool import map_in_threads
from difffric.estimation.mixed_model import End
from difffric.estimation.stacked_data import RECORDINGS, FitData

OTHERWISE = (-3.0, -1.5, -0.7, 0.7, 1.5, 3.0)
"""Where else each push's own mu_s is looked for, in units of the scatter."""
_TRIAL = 15
"""Steps of a descent in which only each push's own mu_s moves: it is then as good as found."""
_BETTER = 1e-3
"""What another mu_s must gain in chi-square, so that it is no rounding."""
_ARRIVED, _AT_ROUNDING = 1e-10, 1e-6
"""A step that promises less than this in chi-square is none; and one that promises little was
refused for rounding."""
_ROUNDING = 1e-13
"""Share of chi-square to which it is computed."""
_REFUSALS = 10
"""Refused steps in a row after which a search has arrived: it stands at a jump of the model."""
_DAMPING, _LEAST_DAMPING = 1e-6, 1e-3
"""Share of its curvature by which a push's first step is shortened, and the least share that
shortens one after a refusal."""
_EASIER, _HARDER = 0.1, 10.0
"""What a good step makes of the damping, and a bad or refused one."""
_GOOD, _BAD = 0.75, 0.25
"""Shares of the promised gain beyond which a step is good, and below which it is bad: it overshot,
as the model is bent where a push fits badly."""


class OwnFriction(NamedTuple):
    """Where some pushes' own numbers lead, an entry a push."""

    cost: NDArray
    """penalised chi-square"""
    s_eta: NDArray
    """log mu_s beyond the shared value"""
    start: NDArray
    """start offset in coordinates"""


def find_push_friction(
    model: Model, data: FitData, at: Settled, index: NDArray, s_eta: NDArray, steps: int
) -> OwnFriction:
    """The own log mu_s of some recorded pushes near `s_eta` (L,), and their start offsets where
    those are free, after `steps` steps at most. `index` (L,) says which pushes, one perhaps several
    times."""
    scatter = at.scatter
    last = model.layout.fixed.shape[1] - 1
    own = [0, last] if model.free_start else [0]  # mu_s, and the start offset
    scale = np.array([scatter, 1.0])[: len(own)]
    weights, offset = at.weights[index], at.start[index]

    def evaluate(lanes: NDArray, x: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        moved = offset[lanes].copy()
        if model.free_start:
            moved, _ = clip_starts(model, _pick_bounds(data, index[lanes]), x[:, 1])
        found = respond_at(model, data, at, index[lanes], scatter * x[:, 0], moved, own)
        rows = np.asarray(found.rows) * weights[lanes][..., None]
        J, r = rows[..., own] * scale, rows[..., -1]
        cost = np.sum(r**2, axis=1) + x[:, 0] ** 2
        g = np.einsum("lmq,lm->lq", J, r)
        H = np.einsum("lmq,lmp->lqp", J, J)
        g[:, 0] += x[:, 0]
        H[:, 0, 0] += 1.0
        if model.free_start:  # beyond its bound an offset changes nothing
            out = moved != x[:, 1]
            g[out, 1], H[out, 1], H[out, :, 1] = 0.0, 0.0, 0.0
            H[out, 1, 1] = 1.0
        return np.where(np.isfinite(cost), cost, np.inf), g, H

    x = np.column_stack([s_eta / scatter, offset])[:, : len(own)]
    x, cost = _search_each(evaluate, x, steps)
    start = offset
    if model.free_start:
        start, _ = clip_starts(model, _pick_bounds(data, index), x[:, 1])
    return OwnFriction(cost, scatter * x[:, 0], start)


def _pick_bounds(data: FitData, index: NDArray) -> FitData:
    """The data with the bounds of the start offsets of some pushes `index` (L,)."""
    if data.start_bounds is None:
        return data
    low, high = data.start_bounds
    return replace(data, start_bounds=(low[index], high[index]))


def _search_each(
    evaluate: Callable[[NDArray, NDArray], tuple[NDArray, NDArray, NDArray]], x: NDArray, most: int
) -> tuple[NDArray, NDArray]:
    """(x (L, q), cost (L,)) where each lane's cost is least near its `x`, by Levenberg and
    Marquardt's steps, each lane's of its own length, `most` at most.

    `evaluate(lanes, x of these)` gives their costs, gradients (l, q) and matrices (l, q, q).
    """
    at, live = x.copy(), np.arange(len(x))
    cost, g, H = evaluate(live, at)
    damping, refused = np.full(len(x), _DAMPING), np.zeros(len(x), int)
    for _ in range(most - 1):
        unit = np.eye(x.shape[1]) * H[live].diagonal(axis1=1, axis2=2)[:, None, :]
        damped = H[live] + damping[live, None, None] * unit
        good = np.isfinite(damped).all(axis=(1, 2)) & (np.linalg.det(damped) > 0)
        live, damped = live[good], damped[good]
        step = -np.linalg.solve(damped, g[live][..., None])[..., 0]
        promised = -2 * np.sum(g[live] * step, axis=1)
        promised -= np.einsum("lq,lqp,lp->l", step, H[live], step)
        least = np.where(refused[live] > 0, _AT_ROUNDING, _ARRIVED) + _ROUNDING * cost[live]
        moves = (promised > least) & (refused[live] < _REFUSALS)
        live, step, promised = live[moves], step[moves], promised[moves]
        if not len(live):
            break
        new_cost, new_g, new_H = evaluate(live, at[live] + step)
        better, share = new_cost < cost[live], (cost[live] - new_cost) / promised
        won, lost = live[better], live[~better]
        at[won] += step[better]
        cost[won], g[won], H[won] = new_cost[better], new_g[better], new_H[better]
        damping[live[share > _GOOD]] *= _EASIER
        bad = live[~(share > _BAD)]
        damping[bad] = np.maximum(damping[bad], _LEAST_DAMPING) * _HARDER
        refused[won], refused[lost] = 0, refused[lost] + 1
    return at, cost


def spread_push_friction(at: Settled) -> list[NDArray]:
    """Each push's own log mu_s (n,), some multiples of the scatter to either side: a list of
    trials."""
    return [at.s_eta + shift * at.scatter for shift in OTHERWISE]


def rescan_push_friction(
    model: Model,
    data: FitData,
    at: Settled,
    trials: Sequence[NDArray] | None = None,
    which: NDArray | None = None,
) -> Settled:
    """The point with each push's own mu_s where it fits best, among descents from several starts:
    `trials`, each (n,), or else multiples of the scatter to either side.

    `which` (n,) says which pushes of recordings are looked at; None: all of them.
    """
    if at.scatter <= 0:
        return at
    trials = spread_push_friction(at) if trials is None else list(trials)
    best, s_eta = _weigh_end(data, at, at.end)
    if data.kind == RECORDINGS:
        index = np.arange(data.n) if which is None else np.flatnonzero(which)
        found = find_best_friction(model, data, at, index, np.stack(trials)[:, index])
        new, ended_at = np.full(data.n, np.inf), np.zeros(data.n)
        new[index], ended_at[index] = found.cost, found.s_eta
    else:
        new, ended_at = _descend_from_each(model, data, at, trials)
    better = new < best - _BETTER
    return replace(at, s_eta=np.where(better, ended_at, s_eta)) if better.any() else at


def find_best_friction(
    model: Model, data: FitData, at: Settled, index: NDArray, trials: NDArray
) -> OwnFriction:
    """The best own log mu_s of the recorded pushes `index` (L,) among those to which `trials`
    (k, L) lead."""
    many = np.tile(index, len(trials))
    found = find_push_friction(model, data, at, many, trials.ravel(), _TRIAL)
    best = np.argmin(found.cost.reshape(trials.shape), axis=0), np.arange(len(index))
    return OwnFriction(*(x.reshape(trials.shape)[best] for x in found))


def _descend_from_each(
    model: Model, data: FitData, at: Settled, trials: list[NDArray]
) -> tuple[NDArray, NDArray]:
    """(penalised chi-square (n,), log mu_s (n,)) of each push of a table at the best end of some
    trials; all pushes go through one program at once."""
    everything = np.ones_like(at.held)

    def descend_from(trial: NDArray) -> tuple[NDArray, NDArray]:
        start = replace(at, s_eta=trial)
        end = descend(model, data, start, everything, at.weights, at.scatter, 30.0, _TRIAL)
        cost, ended_at = _weigh_end(data, at, end)
        return np.where(np.isfinite(cost), cost, np.inf), ended_at

    costs, ends = map(np.stack, zip(*map_in_threads(descend_from, trials), strict=True))
    best = np.argmin(costs, axis=0), np.arange(data.n)
    return costs[best], ends[best]


def _weigh_end(data: FitData, at: Settled, end: End) -> tuple[NDArray, NDArray]:
    """(penalised chi-square (n,), log mu_s (n,)) of each push where a descent ended."""
    rows = at.weights * np.asarray(end.rows)[: data.n, :, -1]
    eta = np.asarray(end.point.eta)[: data.n]
    return np.sum(rows**2, axis=1) + eta**2, at.scatter * eta
