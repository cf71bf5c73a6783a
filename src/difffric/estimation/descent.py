"""One descent of a fit: from a point to the conditional mode near it.

`Model` says what a fit varies, `Settled` where it stands. `descend` runs the compiled program of
`mixed_model` from there, `take_end` takes the point at which it ended, and `linearise_at` gives the
linear mixed model about a point, for the variances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.compute import pytrees
from difffric.estimation.coordinates import START, Layout, rig_at, to_value
from difffric.estimation.following.motion_errors import blind_grids
from difffric.estimation.following.respond_in_columns import respond_in_columns
from difffric.estimation.mixed_model import (
    MAX_STEPS,
    PADDING,
    End,
    FitPoint,
    Problem,
    minimise_stepwise,
    spread_coordinates,
)
from difffric.estimation.residuals import Rows
from difffric.estimation.restricted_likelihood import Components, LinearModel, linearise
from difffric.estimation.stacked_data import RECORDINGS, FitData, pad
from difffric.measurements.recordings import Recording
from difffric.rig.rig import Rig
from difffric.simulation.columns import serves
from difffric.timings import count_followed

ARRIVED = 1e-4
"""A fit has arrived where less than this is left to gain in chi-square."""


_WORTH = 1e-6
"""What a step has to gain in chi-square, where NumPy follows a table's pushes."""
_FEW = 64
"""Pushes of known friction that are followed by NumPy: a search for nothing but what they share
takes few steps."""
_BOUNDINGS = 2
"""Times that start offsets are looked at after a search: holding one may drive out another."""


@dataclass(frozen=True)
class Model:
    """What a fit varies: the rig, its free coordinates, the scatter."""

    rig: Rig
    integrator: Any
    """None: the one that suits the rig"""
    layout: Layout
    scatter: float
    """known, or where its estimate starts"""
    estimate_scatter: bool
    free_start: bool = False
    robust: bool = False


@dataclass(frozen=True)
class Settled:
    """Where a fit stands, and at last where it settled."""

    theta: NDArray
    """(P,) shared coordinates"""
    held: NDArray
    """(P,) whether the coordinate is held, at a bound"""
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


def blind_to_motion(
    model: Model, data: FitData, recordings: Sequence[Recording], at: Settled | None
) -> FitData:
    """The data of recordings blind to what the errors of the recorded motions do to the pushes as
    they are `at` a point; as yet to nothing, where there is none."""
    rigs, offsets = None, np.zeros(data.n)
    if at is not None:
        c = model.layout.fixed + model.layout.selection @ at.theta
        c[:, 0] += at.s_eta
        c[:, -1] += at.start
        rigs = [rig_at(model.rig, each) for each in c]
        offsets = np.asarray(to_value(START, c[:, -1]))
    weights = data.weights[:, [0, data.weights.shape[1] // 2]]
    pushes = blind_grids(data.pushes, data.n, weights, recordings, rigs, offsets)
    return replace(data, pushes=pushes)


def first_point(model: Model, data: FitData, theta: NDArray) -> Settled:
    """The point from which a fit starts: the shared coordinates `theta` (P,) alone, with no push's
    own mu_s beyond them."""
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


def pose_problem(
    model: Model,
    data: FitData,
    held: NDArray,
    theta: NDArray,
    scatter: float,
    weights: NDArray,
    trust: float,
    padded: bool = True,
) -> Problem:
    """The penalised least-squares problem with the parameters `held` (P,) at `theta` (P,).

    `weights` (n, rows) are 1 / standard deviation; `trust` is that of `mixed_model.Problem`. Pushes
    and parameters are padded for a compiled program, if `padded`.
    """
    layout = model.layout.without(held, theta)
    n, P = data.n, layout.n_free
    size = -(-max(P, 1) // (PADDING // 2)) * (PADDING // 2) if padded else P
    selection = np.zeros((*layout.selection.shape[:2], size))
    selection[:, :, :P] = layout.selection
    whole = -(-n // PADDING) * PADDING if padded else n
    row_weights = np.zeros((whole, weights.shape[1]))
    row_weights[:n] = weights
    prior, prior_weight = np.zeros(size), np.zeros(size)
    prior[:P] = model.layout.start
    prior_weight[:P] = np.where(held, 0.0, 1.0 / model.layout.prior_sd)
    starts = np.zeros(whole)
    starts[:n] = float(model.free_start)
    return Problem(
        rig=pytrees.as_arrays(model.rig) if padded else model.rig,
        integrator=model.integrator,
        pushes=data.pushes,
        selection=np.asarray(pad(selection, n)) if padded else selection,
        fixed=np.asarray(pad(layout.fixed, n)) if padded else layout.fixed,
        scatter=np.asarray(scatter),
        weights=row_weights,
        prior=prior,
        prior_weight=prior_weight,
        starts=starts,
        trust=np.asarray(trust),
    )


def descend(
    model: Model,
    data: FitData,
    at: Settled,
    held: NDArray,
    weights: NDArray,
    scatter: float,
    trust: float,
    steps: int = MAX_STEPS,
) -> End:
    """The conditional mode near a point, for these weights (n, rows) and this scatter, with the
    parameters `held` (P,) where they are, after `steps` steps at most.

    A start offset that leaves its bounds is held at the bound, and the search goes on from there.
    """
    given = held, weights, scatter, trust
    problem, point = _pose_descent(model, data, at, *given)
    end = _search_near(model, data, problem, point, steps)
    bounded = np.zeros(data.n, bool)
    for _ in range(_BOUNDINGS):
        start, beyond = clip_starts(model, data, np.asarray(end.point.start)[: data.n])
        if not (beyond & ~bounded).any():
            break
        bounded |= beyond
        at = replace(take_end(at, end, held, scatter), start=start)
        problem, point = _pose_descent(model, data, at, *given)
        problem = _hold_starts(problem, bounded, start)
        end = _search_near(model, data, problem, point, steps)
    return end


def clip_starts(model: Model, data: FitData, start: NDArray) -> tuple[NDArray, NDArray]:
    """(start offsets (n,) in coordinates within their bounds, which of them were not, or stand at
    one)."""
    if not model.free_start or data.start_bounds is None:
        return start, np.zeros(len(start), bool)
    low, high = data.start_bounds
    return np.clip(start, low, high), (start <= low) | (start >= high)


def _hold_starts(problem: Problem, which: NDArray, start: NDArray) -> Problem:
    """The problem with the start offsets of the pushes `which` (n,) held at `start` (n,)."""
    n, fixed, starts = len(which), np.array(problem.fixed), np.array(problem.starts)
    fixed[:n, -1] += np.where(which, start, 0.0)
    starts[:n] = np.where(which, 0.0, starts[:n])
    return problem._replace(fixed=fixed, starts=starts)


def _search_near(model: Model, data: FitData, problem: Problem, start: FitPoint, steps: int) -> End:
    """The mode near a point, by NumPy or by compiled programs; its pushes are counted."""
    if goes_in_columns(model, data):
        pushes, moving = pytrees.pick(data.pushes, slice(data.n)), _list_moving(model)
        directions = len(moving)
        worth = data.worth if data.kind == RECORDINGS else _WORTH
        end = minimise_stepwise(
            problem, start, steps, lambda c: respond_in_columns(model.rig, pushes, c, moving), worth
        )
    else:
        directions = problem.fixed.shape[1]
        end = _run_programs(problem, start, steps, data.kind)
    calls = int(end.steps) + 1
    followed = calls * data.n, calls * len(end.rows)
    count_followed(calls, followed, (followed[0] * directions, followed[1] * directions))
    return end


def _run_programs(problem: Problem, start: FitPoint, steps: int, kind: str) -> End:
    """The mode near a point, by compiled programs."""
    # Imported here, as JAX is with them: pushes in columns do without.
    from difffric.estimation.following.compiled_search import minimise_table, respond

    if kind != RECORDINGS:
        return minimise_table(problem, start, np.asarray(steps))
    given = problem.rig, problem.integrator, problem.pushes
    return minimise_stepwise(problem, start, steps, lambda c: respond(*given, c))


def goes_in_columns(model: Model, data: FitData) -> bool:
    """Whether pushes are followed by NumPy, with nothing compiled: whole recordings by the closed
    form; tables that are searched in few steps, those whose friction bends with the speed, and
    small ones of known friction."""
    affine = model.rig.affine  # what bends is stepped through sooner than its program is compiled
    if data.kind == RECORDINGS:
        wanted = affine
    else:
        known = not model.estimate_scatter and model.scatter == 0 and data.n <= _FEW
        wanted = data.in_few_steps or not affine or known
    return wanted and serves(model.rig, model.integrator)


def _list_moving(model: Model) -> list[int]:
    """The indices of the coordinates that a fit moves, each push's own among them."""
    free = (model.layout.selection != 0).any(axis=(0, 2))
    free[0] = True
    free[-1] |= model.free_start
    return np.flatnonzero(free).tolist()


def respond_at(
    model: Model,
    data: FitData,
    at: Settled,
    index: NDArray,
    s_eta: NDArray,
    start: NDArray,
    moving: Sequence[int],
) -> Rows:
    """What recorded pushes answer, `index` (L,) of them, one perhaps several times: their rows.

    The shared coordinates are those of `at`; `s_eta` (L,) is each one's log mu_s beyond the shared
    one, `start` (L,) its start offset in coordinates. Derivatives are those by the coordinates
    `moving` at least.
    """
    layout = model.layout
    c = layout.fixed[index] + layout.selection[index] @ at.theta
    c[:, 0] += s_eta
    c[:, -1] += start
    lanes, directions = len(index), len(index) * len(moving)
    count_followed(1, (lanes, lanes), (directions, directions))
    if goes_in_columns(model, data):
        return respond_in_columns(model.rig, pytrees.pick(data.pushes, index), c, moving)
    from difffric.estimation.following.compiled_search import respond  # it imports JAX

    # A compiled program takes as many pushes at a time as the data have, padded.
    rig, whole = pytrees.as_arrays(model.rig), len(pad(np.zeros(data.n), data.n))
    parts = []
    for lo in range(0, len(index), whole):
        some = np.minimum(np.arange(lo, lo + whole), len(index) - 1)
        found = respond(rig, model.integrator, pytrees.pick(data.pushes, index[some]), c[some])
        parts.append([np.asarray(x)[: len(index) - lo] for x in found])
    return Rows(*map(np.concatenate, zip(*parts, strict=True)))


def prepare_descent(model: Model, data: FitData, at: Settled) -> None:
    """Make the program of `descend` for recordings of this shape ready for every later call, if it
    needs one; may be left to another thread."""
    if goes_in_columns(model, data):
        return
    from difffric.estimation.following.compiled_search import respond  # it imports JAX

    problem, start = _pose_descent(model, data, at, at.held, data.weights, model.scatter, 1.0)
    given = problem.rig, problem.integrator, problem.pushes
    respond.prepare(*given, spread_coordinates(problem, start))


def _pose_descent(
    model: Model,
    data: FitData,
    at: Settled,
    held: NDArray,
    weights: NDArray,
    scatter: float,
    trust: float,
) -> tuple[Problem, FitPoint]:
    """What a search of `mixed_model` takes: the problem, and where it starts."""
    padded = not goes_in_columns(model, data)
    problem = pose_problem(model, data, held, at.theta, scatter, weights, trust, padded)
    theta = np.zeros(problem.prior.shape[0])
    theta[: len(at.theta)] = np.where(held, 0.0, at.theta)
    eta = np.zeros(problem.weights.shape[0])
    eta[: data.n] = at.s_eta / scatter if scatter > 0 else 0.0
    start = np.zeros(problem.starts.shape[0])
    start[: data.n] = at.start
    return problem, FitPoint(theta, eta, start)


def take_end(at: Settled, end: End, held: NDArray, scatter: float) -> Settled:
    """The point at which a descent ended, with the parameters `held` (P,) where they were."""
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


def linearise_at(
    model: Model, data: FitData, at: Settled, factor: NDArray | float = 1.0
) -> LinearModel:
    """The linear mixed model about a point; a held parameter's column is empty. `factor` (n, rows)
    multiplies the weights."""
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


def start_offsets(at: Settled) -> NDArray:
    """Each push's start offset [s] (n,); 0 where it was not free."""
    return to_value(START, at.start)
