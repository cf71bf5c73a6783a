"""From a start to a settled fit: conditional mode and variances in turn, within bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from difffric.compute import pytrees
from difffric.errors import NumericalError
from difffric.estimation.coordinates import NOTHING, START, Layout, to_value
from difffric.estimation.mixed_model import (
    MAX_STEPS,
    PADDING,
    End,
    FitPoint,
    Problem,
    minimise,
    minimise_soon,
)
from difffric.estimation.restricted_likelihood import (
    Components,
    estimate_shared,
    estimate_variances,
    linearise,
)
from difffric.estimation.stacked_data import RECORDINGS, FitData, pad
from difffric.rig.parameters import PARAMETERS
from difffric.rig.rig import Rig

ROUNDS = 25
ARRIVED = 1e-4
"""A fit has arrived where less than this is left to gain in chi-square."""
HUBER = 1.345
"""Residuals beyond this many standard deviations weigh less in a robust fit (95 % efficient
where the noise is normal): P. J. Huber, Ann. Math. Statist. 35 (1964)."""
_UNFELT = 1e-3
"""A parameter whose e-fold change moves no residual by more than this many spreads is gone."""
OTHERWISE = (-3.0, -1.5, -0.7, 0.7, 1.5, 3.0)
"""Where else each push's own mu_s is looked for, in units of the scatter."""
_TRIAL = 15
"""Steps in which one mu_s is as good as found."""


@dataclass(frozen=True)
class Model:
    """What a fit varies: the rig, its free coordinates, the scatter."""

    rig: Rig
    integrator: Any
    layout: Layout
    scatter: float
    """known, or where its estimate starts"""
    estimate_scatter: bool
    free_start: bool = False
    robust: bool = False


@dataclass(frozen=True)
class Settled:
    """Where a fit settled."""

    theta: NDArray
    """(P,) shared coordinates"""
    held: NDArray
    """(P,) True: at a bound"""
    s_eta: NDArray
    """(n,) log mu_s of each push beyond the shared value"""
    start: NDArray
    """(n,) start offsets in coordinates; 0 where they are not free"""
    scatter: float
    spreads: NDArray
    components: Components
    end: End
    weights: NDArray
    """(n, m) as they were at the end"""
    settled: bool

    @property
    def smooth(self) -> bool:
        """Whether nothing is left to gain by the derivatives either; not so where the optimum
        lies at a change of regime, at which derivatives jump."""
        return abs(self.components.gain) < 100 * ARRIVED


def first_point(model: Model, data: FitData, theta: NDArray) -> Settled:
    """A point to start from: shared coordinates alone."""
    n, P = data.n, model.layout.n_free
    nothing: Any = None
    return Settled(
        theta=np.asarray(theta, float),
        held=np.zeros(P, bool),
        s_eta=np.zeros(n),
        start=np.zeros(n),
        scatter=model.scatter,
        spreads=data.guess,
        components=nothing,
        end=nothing,
        weights=data.weights,
        settled=False,
    )


def pose_problem(model: Model, data: FitData, held, theta, scatter, weights, trust) -> Problem:
    """The penalised least-squares problem with some parameters held."""
    layout = model.layout.without(held, theta)
    n, P = data.n, layout.n_free
    size = -(-max(P, 1) // (PADDING // 2)) * (PADDING // 2)
    selection = np.zeros((*layout.selection.shape[:2], size))
    selection[:, :, :P] = layout.selection
    whole = -(-n // PADDING) * PADDING
    row_weights = np.zeros((whole, weights.shape[1]))
    row_weights[:n] = weights
    prior, prior_weight = np.zeros(size), np.zeros(size)
    prior[:P] = model.layout.start
    prior_weight[:P] = np.where(held, 0.0, 1.0 / model.layout.prior_sd)
    starts = np.zeros(whole)
    starts[:n] = float(model.free_start)
    return Problem(
        rig=pytrees.as_arrays(model.rig),
        integrator=model.integrator,
        pushes=data.pushes,
        selection=pad(selection, n),
        fixed=pad(layout.fixed, n),
        scatter=jnp.asarray(scatter),
        weights=jnp.asarray(row_weights),
        prior=jnp.asarray(prior),
        prior_weight=jnp.asarray(prior_weight),
        starts=jnp.asarray(starts),
        trust=jnp.asarray(trust),
    )


def descend(
    model: Model, data: FitData, at: Settled, held, weights, scatter, trust, steps=MAX_STEPS
) -> End:
    """The conditional mode near a point, for these weights and this scatter."""
    # Whole recordings run for longer than they compile.
    run = minimise if data.kind == RECORDINGS else minimise_soon
    return run(*_pose_descent(model, data, at, held, weights, scatter, trust, steps))


def descent_to_compile(model: Model, data: FitData, at: Settled):
    """The program of `descend` for data of this shape, traced; `.compile()` makes it ready for
    every later call, and may be left to another thread."""
    scatter = max(model.scatter, 1e-3)
    return minimise.lower(*_pose_descent(model, data, at, at.held, data.weights, scatter, 1.0, 0))


def _pose_descent(
    model: Model,
    data: FitData,
    at: Settled,
    held: NDArray,
    weights: NDArray,
    scatter: float,
    trust: float,
    steps: int,
) -> tuple[Problem, FitPoint, Any]:
    """What `minimise` takes."""
    problem = pose_problem(model, data, held, at.theta, scatter, weights, trust)
    theta = np.zeros(problem.prior.shape[0])
    theta[: len(at.theta)] = np.where(held, 0.0, at.theta)
    eta = np.zeros(problem.weights.shape[0])
    eta[: data.n] = at.s_eta / scatter if scatter > 0 else 0.0
    start = np.zeros(problem.starts.shape[0])
    start[: data.n] = at.start
    point = FitPoint(jnp.asarray(theta), jnp.asarray(eta), jnp.asarray(start))
    return problem, point, jnp.asarray(steps)


def take_end(at: Settled, end: End, held, scatter) -> Settled:
    """The point that a descent ended at."""
    n, P = len(at.s_eta), len(at.theta)
    theta = np.where(held, at.theta, np.asarray(end.point.theta)[:P])
    return replace(
        at,
        theta=theta,
        held=held,
        s_eta=scatter * np.asarray(end.point.eta)[:n],
        start=np.asarray(end.point.start)[: len(at.start)],
        scatter=scatter,
        end=end,
    )


def linearise_at(model: Model, data: FitData, at: Settled, factor: NDArray | float = 1.0):
    """The linear mixed model about a point; a held parameter's column is empty."""
    layout, n = model.layout, data.n
    weight = np.where(at.held, 0.0, 1.0 / layout.prior_sd)
    away = weight * (at.theta - layout.start)
    prior = np.zeros((layout.n_free + 1,) * 2)
    prior[:-1, :-1] = np.diag(weight**2)
    prior[:-1, -1] = prior[-1, :-1] = weight * away
    prior[-1, -1] = away @ away
    return linearise(
        np.asarray(at.end.rows)[:n],
        data.weights * factor,
        data.group,
        data.counts,
        data.least,
        layout.selection * ~at.held,
        prior,
        at.s_eta,
        model.free_start,
    )


def settle(model: Model, data: FitData, at: Settled, *, trust=30.0, rounds=ROUNDS) -> Settled:
    """Alternate the conditional mode and the variances until both stand.

    Raises `NumericalError` where the misfit is not finite.
    """
    held = at.held
    robust = np.ones_like(data.weights)
    released, first, settled, last = 0, True, False, np.inf
    for _ in range(rounds):
        scatter = at.scatter
        weights = _scale_weights(data, at.spreads) * robust
        end = descend(model, data, at, held, weights, scatter, trust)
        if not np.isfinite(float(end.chi2)):
            raise NumericalError("fit: the misfit is not finite where the search ended")
        at = replace(take_end(at, end, held, scatter), weights=weights)
        stuck = _find_at_bounds(model, data, at)
        if stuck.any():
            at = replace(at, theta=_clip(model, at.theta, stuck), held=held | stuck)
            held = at.held
            continue
        found = estimate_variances(
            linearise_at(model, data, at, robust),
            scatter,
            at.spreads,
            model.estimate_scatter,
            first,
        )
        before, first = (scatter, at.spreads), False
        at = replace(at, components=found, scatter=found.scatter, spreads=found.spreads)
        steady = _is_close(before[0], found.scatter) and np.allclose(
            before[1], found.spreads, rtol=2e-3
        )
        if model.robust:
            new = _weigh_by_huber(weights / robust, end, data)
            steady &= bool(np.allclose(new, robust, atol=1e-2))
            robust = new
        free = _find_leaving(model, data, at) if steady and released < 3 else np.zeros_like(held)
        if free.any():
            held, released = held & ~free, released + 1
            continue
        if steady and (abs(found.gain) < ARRIVED or last - float(end.chi2) < ARRIVED):
            settled = True
            break
        last = float(end.chi2)
    layout = model.layout
    # One that was let go, and found no way inside, is at its bound all the same.
    at = replace(at, held=at.held | (at.theta == layout.lower) | (at.theta == layout.upper))
    if at.components is None:  # every round ended at another bound
        at = replace(
            at,
            components=estimate_variances(
                linearise_at(model, data, at), at.scatter, at.spreads, model.estimate_scatter
            ),
        )
    return replace(at, settled=settled, components=_add_bounds(model, data, at, robust))


def _add_bounds(model: Model, data: FitData, at: Settled, factor) -> Components:
    """The components with the covariance and the step of a parameter at its bound, too.

    Without its column the others would be as certain as if its true value were the bound; with
    it their errors are those without the bound, which are no smaller.
    """
    found = at.components
    if not (at.held & (at.theta > NOTHING)).any():
        return found
    covariance, step = _free_held(model, data, at, factor)
    freedom = np.where(np.isfinite(found.freedom), found.freedom, np.min(found.freedom))
    return found._replace(covariance=covariance, step=step, freedom=freedom)


def full_covariance(model: Model, data: FitData, at: Settled) -> NDArray:
    """(P, P) of the coordinates as if none were at a bound, except a damping that is gone."""
    return _free_held(model, data, at, 1.0)[0]


def _free_held(model: Model, data: FitData, at: Settled, factor) -> tuple[NDArray, NDArray]:
    """Covariance (P, P) and generalised least-squares step (P,)."""
    linear = linearise_at(model, data, replace(at, held=at.held & (at.theta <= NOTHING)), factor)
    return estimate_shared(linear, at.scatter, at.spreads, model.estimate_scatter)


def spread_push_friction(at: Settled) -> list[NDArray]:
    """Each push's own mu_s some multiples of the scatter to either side."""
    return [at.s_eta + shift * at.scatter for shift in OTHERWISE]


def rescan_push_friction(
    model: Model, data: FitData, at: Settled, trials: Sequence[NDArray] | None = None
) -> Settled:
    """The point with each push's own mu_s where it fits best, among several starts: `trials`,
    each (n,), or multiples of the scatter to either side.

    d jumps with mu_s where a regime ends, and has several mu_s besides: a search from one side
    may stay on the wrong one. With the shared parameters held the pushes are independent.
    """
    if at.scatter <= 0:
        return at
    everything = np.ones_like(at.held)
    if trials is None:
        trials = spread_push_friction(at)

    def cost(end):
        rows = at.weights * np.asarray(end.rows)[: data.n, :, -1]
        eta = np.asarray(end.point.eta)[: data.n]
        return np.sum(rows**2, axis=1) + eta**2, at.scatter * eta

    best, s_eta = cost(at.end)
    improved = False
    for trial in trials:
        start = replace(at, s_eta=trial)
        end = descend(model, data, start, everything, at.weights, at.scatter, 30.0, _TRIAL)
        new, moved_to = cost(end)
        better = new < best - 1e-3
        improved |= bool(better.any())
        best, s_eta = np.where(better, new, best), np.where(better, moved_to, s_eta)
    return replace(at, s_eta=s_eta) if improved else at


def _scale_weights(data: FitData, spreads: NDArray) -> NDArray:
    own = np.concatenate([spreads, [1.0]])[data.group]  # -1 is the last: known
    return data.weights / own


def _is_close(a: float, b: float) -> bool:
    return abs(a - b) <= 2e-3 * max(a, b) or max(a, b) < 1e-5


def _weigh_by_huber(clean_weights, end: End, data: FitData) -> NDArray:
    """Square roots of Huber's weights, for rows that are measurements."""
    r = np.abs(clean_weights * np.asarray(end.rows)[: data.n, :, -1])
    return np.sqrt(np.minimum(1.0, HUBER / np.maximum(r, HUBER)))


def _find_at_bounds(model: Model, data: FitData, at: Settled) -> NDArray:
    layout = model.layout
    beyond = (at.theta < layout.lower) | (at.theta > layout.upper)
    rows = np.asarray(at.end.rows)[: data.n]
    J = np.abs((rows[..., :-1] @ layout.selection) * at.weights[..., None])
    felt = np.sqrt((J**2).sum(axis=1)).max(axis=0, initial=0.0)
    gone = (felt < _UNFELT) & np.array([PARAMETERS[name].may_vanish for name in layout.names], bool)
    return (beyond | gone) & ~at.held


def _clip(model: Model, theta: NDArray, stuck: NDArray) -> NDArray:
    """At the bound that was passed, or at nothing where there is none."""
    layout = model.layout
    clipped = np.clip(theta, layout.lower, layout.upper)
    nothing = np.where(np.isfinite(layout.lower), layout.lower, NOTHING)
    inside = (theta >= layout.lower) & (theta <= layout.upper)
    return np.where(stuck, np.where(inside, nothing, clipped), theta)


def _find_leaving(model: Model, data: FitData, at: Settled) -> NDArray:
    """Which held parameters the misfit would pull back inside."""
    layout = model.layout
    rows = np.asarray(at.end.rows)[: data.n] * at.weights[..., None]
    pull = -np.einsum("nmp,nm->p", rows[..., :-1] @ layout.selection, rows[..., -1])
    low = at.theta <= np.where(np.isfinite(layout.lower), layout.lower, NOTHING)
    inward = np.where(low, pull > ARRIVED, pull < -ARRIVED)
    return at.held & inward & (layout.lower < layout.upper)


def start_offsets(at: Settled) -> NDArray:
    """Each push's start offset [s]; 0 where it was not free."""
    return to_value(START, at.start)
