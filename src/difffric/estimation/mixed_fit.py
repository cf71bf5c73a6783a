"""From a start to a settled fit: the mode and the variances in turn, within bounds.

`settle` alternates `descend` (the conditional mode, `mixed_model`) and `estimate_variances`
(`restricted_likelihood`) until both stand. A parameter that passes a bound is held there, and let
go again where the misfit would pull it back inside. An ensemble of many fits does the same in
`ensemble_refits`, whose steps end at the bounds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.errors import NumericalError
from difffric.estimation.coordinates import NOTHING
from difffric.estimation.descent import (
    ARRIVED,
    Model,
    Settled,
    descend,
    linearise_at,
    take_end,
)
from difffric.estimation.mixed_model import End
from difffric.estimation.restricted_likelihood import (
    Components,
    estimate_shared,
    estimate_variances,
)
from difffric.estimation.stacked_data import FitData
from difffric.rig.parameters import PARAMETERS

ROUNDS = 25
"""Rounds of mode and variances at most: most fits settle in a few."""
HUBER = 1.345
"""Residuals beyond this many standard deviations weigh less in a robust fit (95 % efficient
where the noise is normal): P. J. Huber, Ann. Math. Statist. 35 (1964)."""
_UNFELT = 1e-3
"""A parameter whose e-fold change moves no residual by more than this many spreads is gone."""


def settle(
    model: Model, data: FitData, at: Settled, *, trust: float = 30.0, rounds: int = ROUNDS
) -> Settled:
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


def _add_bounds(model: Model, data: FitData, at: Settled, factor: NDArray | float) -> Components:
    """The variances' components, with the covariance and the step of a parameter at its bound too.

    Without its column the others would be as certain as if its true value were the bound; with it
    their errors are those without the bound, which are no smaller.
    """
    found = at.components
    if not (at.held & (at.theta > NOTHING)).any():
        return found
    covariance, step = _solve_unheld(model, data, at, factor)
    freedom = np.where(np.isfinite(found.freedom), found.freedom, np.min(found.freedom))
    return found._replace(covariance=covariance, step=step, freedom=freedom)


def full_covariance(model: Model, data: FitData, at: Settled) -> NDArray:
    """The covariance (P, P) of the coordinates as if none were at a bound, except a damping that
    has vanished."""
    return _solve_unheld(model, data, at, 1.0)[0]


def _solve_unheld(
    model: Model, data: FitData, at: Settled, factor: NDArray | float
) -> tuple[NDArray, NDArray]:
    """The covariance (P, P) and the generalised least-squares step (P,) as if none were at a bound,
    except a damping that has vanished."""
    linear = linearise_at(model, data, replace(at, held=at.held & (at.theta <= NOTHING)), factor)
    return estimate_shared(linear, at.scatter, at.spreads, model.estimate_scatter)


def _scale_weights(data: FitData, spreads: NDArray) -> NDArray:
    """1 / standard deviation (n, rows), with the spreads (groups,) of rows whose noise is not
    known."""
    own = np.concatenate([spreads, [1.0]])[data.group]  # -1 is the last: known
    return data.weights / own


def _is_close(a: float, b: float) -> bool:
    """Whether two scatters are the same to 0.2 %, or both are none."""
    return abs(a - b) <= 2e-3 * max(a, b) or max(a, b) < 1e-5


def _weigh_by_huber(clean_weights: NDArray, end: End, data: FitData) -> NDArray:
    """The square roots of Huber's weights (n, rows), for rows that are measurements."""
    r = np.abs(clean_weights * np.asarray(end.rows)[: data.n, :, -1])
    return np.sqrt(np.minimum(1.0, HUBER / np.maximum(r, HUBER)))


def _find_at_bounds(model: Model, data: FitData, at: Settled) -> NDArray:
    """Which parameters (P,) passed a bound, or have vanished: no residual feels them any more."""
    layout = model.layout
    beyond = (at.theta < layout.lower) | (at.theta > layout.upper)
    rows = np.asarray(at.end.rows)[: data.n]
    J = np.abs((rows[..., :-1] @ layout.selection) * at.weights[..., None])
    felt = np.sqrt((J**2).sum(axis=1)).max(axis=0, initial=0.0)
    gone = (felt < _UNFELT) & np.array([PARAMETERS[name].may_vanish for name in layout.names], bool)
    return (beyond | gone) & ~at.held


def _clip(model: Model, theta: NDArray, stuck: NDArray) -> NDArray:
    """The coordinates, those `stuck` (P,) at the bound that they passed, or, where
    there is none, at that of one that vanished."""
    layout = model.layout
    clipped = np.clip(theta, layout.lower, layout.upper)
    nothing = np.where(np.isfinite(layout.lower), layout.lower, NOTHING)
    inside = (theta >= layout.lower) & (theta <= layout.upper)
    return np.where(stuck, np.where(inside, nothing, clipped), theta)


def _find_leaving(model: Model, data: FitData, at: Settled) -> NDArray:
    """Which held parameters (P,) the misfit would pull back inside."""
    layout = model.layout
    rows = np.asarray(at.end.rows)[: data.n] * at.weights[..., None]
    pull = -np.einsum("nmp,nm->p", rows[..., :-1] @ layout.selection, rows[..., -1])
    low = at.theta <= np.where(np.isfinite(layout.lower), layout.lower, NOTHING)
    inward = np.where(low, pull > ARRIVED, pull < -ARRIVED)
    return at.held & inward & (layout.lower < layout.upper)
