"""From where a search settled to the optimum of the marginal likelihood, with its error bars.

The shared parameters, the scatter and the spreads move together. The variances are those of
restricted likelihood: the log determinant of what the data say of the shared parameters counts
too, as otherwise few pushes would make the scatter too small (D. R. Cox and N. Reid, J. R. Statist.
Soc. B 49 (1987) 1-39). It is taken from the linear mixed model about the point, and anew from where
that led.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.marginal.marginal_likelihood import Likelihood, MarginalLikelihood
from difffric.calibration.marginal.quasi_newton import Found, search_quadratically
from difffric.estimation.coordinates import NOTHING
from difffric.estimation.descent import Model, Settled, descend, take_end
from difffric.estimation.restricted_likelihood import (
    Components,
    LinearModel,
    describe_variances,
    invert_information,
)
from difffric.estimation.stacked_data import FitData

ARRIVED = 1e-4
"""A search has arrived where less than this is left to gain in -2 log-likelihood: it moves no
parameter by a hundredth of its standard error."""
_CLOSE = 1e-3
"""The same where the value alone is asked for, of a profile."""
_LEFT = 100 * ARRIVED
"""A search that leaves more than this did not arrive."""
_OPEN = 1e-2
"""Curvature that every coordinate has at least for the choice of a step: one that the data leave
open does not run away."""
_STEPS = 25
"""Steps of one search at most: most take five."""
_PASSES = 4
"""How often the linear model of the determinant is taken anew, at most."""
_STAYED = 0.02
"""A pass that moved nothing by more than this many standard errors was the last."""
_APART = 0.2
"""Standard errors from the optimum at which its curvature is measured."""
_LOWEST, _HIGHEST = np.log(1e-6), 0.0
"""The logarithms between which a scatter is looked for."""
_ELSEWHERE = (0.003, 0.01, 0.03)
"""Scatters that compete with none: its likelihood is flat towards zero."""
_HOPELESS = 0.5
"""A scatter beyond this hides a misfit: there is nothing near that is worth polishing."""
_NONE = 1e-4
"""A scatter below this is looked for elsewhere too."""
_TOLD_APART = 1e-3
"""A scatter that is no more likely than none by more than this, in -2 log-likelihood, is none."""
_SMALL = 1e-3
"""For derivatives of the determinant by logarithms of the variances."""
_TRUST = 30.0
"""How far the descent of each push's own mu_s trusts its linear model at first: far, as it starts
beside its mode."""


class _Objective:
    """-2 log restricted likelihood by theta and the logarithms of what is estimated of scatter and
    spreads, the determinant's linear model held as it was at some point."""

    def __init__(self, model: Model, data: FitData, at: Settled):
        self.likelihood = MarginalLikelihood(model, data, at)
        self.estimate = model.estimate_scatter
        self.P, self.scatter = model.layout.n_free, at.scatter
        gone = at.held & (at.theta <= NOTHING)
        self.likelihood.held = gone
        first = [np.clip(np.log(max(at.scatter, 1e-9)), _LOWEST, _HIGHEST)] if self.estimate else []
        self.x = np.concatenate([at.theta, first, np.log(at.spreads)])
        layout, least = model.layout, np.log(data.least)
        low, high = ([_LOWEST], [_HIGHEST]) if self.estimate else ([], [])
        self.lower = np.concatenate([np.where(gone, at.theta, layout.lower), low, least])
        self.upper = np.concatenate([np.where(gone, at.theta, layout.upper), high, least + 20.0])
        # What is at its bound is no shared parameter for the determinant, as it is not estimated.
        self.counted = ~at.held
        self.gone = np.concatenate([gone, np.zeros(len(self.x) - self.P, bool)])
        self.moves = np.concatenate(
            [np.ones(self.P, bool), [self.estimate], np.ones(len(at.spreads), bool)]
        )
        self.linear = self.look(self.x).linear

    def unpack(self, x: NDArray) -> tuple[NDArray, float, NDArray]:
        """(theta, scatter, spreads) of a point."""
        v = x[self.P :]
        if self.estimate:
            return x[: self.P], float(np.exp(v[0])), np.exp(v[1:])
        return x[: self.P], self.scatter, np.exp(v)

    def look(self, x: NDArray) -> Likelihood:
        """The marginal likelihood at a point."""
        return self.likelihood.evaluate(*self.unpack(x))

    def evaluate(self, x: NDArray) -> tuple[float, NDArray]:
        """The value and its gradient."""
        found = self.look(x)
        g = found.gradient[self.moves]
        for j in range(self.P, len(x)):
            step = np.zeros_like(x)
            step[j] = _SMALL
            rise = self.determinant(x + step) - self.determinant(x - step)
            g[j] += rise / (2 * _SMALL)
        return found.value + self.determinant(x), np.where(self.gone, 0.0, g)

    def determinant(self, x: NDArray) -> float:
        """Log of the determinant of what the data say of the shared parameters."""
        _, scatter, spreads = self.unpack(x)
        X = self.linear.evaluate(scatter, spreads)[1][np.ix_(self.counted, self.counted)]
        values = np.linalg.eigvalsh(X)
        seen = values > 1e-13 * max(values.max(initial=0.0), 1e-300)
        return float(np.log(values[seen]).sum())

    def guess_curvature(self, x: NDArray) -> NDArray:
        """The second derivatives, as the linear mixed model has them."""
        _, scatter, spreads = self.unpack(x)
        out = np.zeros((len(x), len(x)))
        out[: self.P, : self.P] = 2 * self.linear.evaluate(scatter, spreads)[1]
        n = max(len(self.linear.known), 1)
        counts = list(self.likelihood.data.counts)
        size = [4.0 * max(c, 1) for c in ([n] if self.estimate else []) + counts]
        out[self.P :, self.P :] = np.diag(size)
        return out + _OPEN * np.eye(len(x))


def polish(model: Model, data: FitData, at: Settled) -> Settled:
    """The optimum of the marginal likelihood near where a search settled, with its error bars.

    `Settled.settled` says whether it was reached, `components` what follows.
    """
    if not model.estimate_scatter and at.scatter == 0:
        return at  # with nothing to integrate over, the mode is the optimum
    if at.scatter > _HOPELESS:
        return at  # a wrong basin, in which the likelihood is full of jumps, and takes long
    objective = _Objective(model, data, at)
    found = _search(objective)
    if objective.estimate:
        if np.exp(found.x[objective.P]) < _NONE:
            found = _try_scatters(objective, found)
        found = _prefer_none(objective, found)
    return _conclude(model, data, at, objective, found)


def _search(objective: _Objective) -> Found:
    """The optimum near where the objective stands, which then stands there."""
    x, B = objective.x, objective.guess_curvature(objective.x)
    for _ in range(_PASSES):
        bounds = objective.lower, objective.upper
        found = search_quadratically(objective.evaluate, x, B, *bounds, ARRIVED, _STEPS)
        moved = found.x - x
        x, B = found.x, found.curvature
        objective.x, objective.linear = x, objective.look(x).linear
        inside = (x > objective.lower) & (x < objective.upper)
        objective.counted = inside[: objective.P]
        if 0.5 * moved @ B @ moved < _STAYED**2 or found.gain > _LEFT:
            break
    return found


def _try_scatters(objective: _Objective, found: Found) -> Found:
    """The optimum with another scatter than none, where that is more likely."""
    best, value = found, objective.evaluate(found.x)[0]
    none = objective.x, objective.linear, objective.counted
    for scatter in _ELSEWHERE:
        x = found.x.copy()
        x[objective.P] = np.log(scatter)
        if objective.evaluate(x)[0] < value - ARRIVED:
            objective.x = x
            other = _search(objective)
            if objective.evaluate(other.x)[0] < value - ARRIVED:
                return other
            objective.x, objective.linear, objective.counted = none
    return best


def _prefer_none(objective: _Objective, found: Found) -> Found:
    """The optimum without a scatter, where that is as likely."""
    none = found.x.copy()
    none[objective.P] = _LOWEST
    value, g = objective.evaluate(none)
    if value > objective.evaluate(found.x)[0] + _TOLD_APART:
        return found
    objective.x = none
    return found._replace(x=none, gradient=g)


def _conclude(
    model: Model, data: FitData, at: Settled, objective: _Objective, found: Found
) -> Settled:
    """The settled point, with the variances' components and the covariance of the parameters."""
    theta, scatter, spreads = objective.unpack(found.x)
    if objective.estimate and scatter <= 2 * np.exp(_LOWEST):
        scatter = 0.0
    P = objective.P
    here = objective.look(found.x)
    value, g = objective.evaluate(found.x)
    bounded = (found.x <= objective.lower) | (found.x >= objective.upper)
    held = bounded[:P] | objective.gone[:P]
    weights = objective.likelihood.factor / np.concatenate([spreads, [1.0]])[data.group]
    at = replace(at, theta=theta, held=held, spreads=spreads, weights=weights)
    everything = np.ones_like(held)
    start = replace(at, s_eta=here.mean)
    end = descend(model, data, start, everything, weights, scatter, _TRUST)
    at = replace(take_end(at, end, everything, scatter), held=held)
    components = describe_variances(here.linear, scatter, spreads, objective.estimate)
    settled = found.gain < _LEFT
    if settled:
        information = 0.5 * measure_curvature(objective, found.x, g)
        components = _adopt(components, here.linear, information, g, P, objective.gone)
    components = components._replace(criterion=value, gain=found.gain)
    # Pressed against a jump, where no derivative says so, a point may be an optimum all the same.
    pressed = bool(here.beside_jump.any()) and at.settled
    return replace(at, components=components, settled=settled or pressed)


def measure_curvature(objective: _Objective, x: NDArray, g: NDArray) -> NDArray:
    """The second derivatives (k, k) at the optimum, by differences of the exact gradient; 0 for
    what went to zero."""
    B = objective.guess_curvature(x)
    step = _APART * np.sqrt(2 * np.diag(np.linalg.inv(B)))
    step = np.minimum(step, 0.3)
    out = np.zeros_like(B)
    fixed = (x <= objective.lower) | (x >= objective.upper)
    fixed[: objective.P] = False  # the errors of parameters are those without their bounds
    for j in np.flatnonzero(~objective.gone & ~fixed):
        sides = []
        for sign in (-1, 1):
            to = x.copy()
            to[j] = np.clip(x[j] + sign * step[j], objective.lower[j], objective.upper[j])
            if to[j] != x[j]:
                sides.append((to[j], objective.evaluate(to)[1]))
        if len(sides) == 1:
            sides.append((x[j], g))
        if len(sides) == 2:
            (a, at_a), (b, at_b) = sides
            out[j] = (at_b - at_a) / (b - a)
    out[:, fixed] = 0.0
    return 0.5 * (out + out.T)


def fit_others(
    likelihood: MarginalLikelihood,
    model: Model,
    at: Settled,
    theta: NDArray,
    gone: NDArray,
    j: int,
) -> tuple[float, NDArray]:
    """-2 log-likelihood and the shared parameters (P,) at which it is least near `theta`, with
    parameter j and those that are `gone` (P,) held, and the variances as they are in `at`."""
    held = gone.copy()
    held[j] = True
    layout = model.layout
    lower, upper = (np.where(held, theta, x) for x in (layout.lower, layout.upper))

    def evaluate(x: NDArray) -> tuple[float, NDArray]:
        found = likelihood.evaluate(x, at.scatter, at.spreads)
        return found.value, np.where(held, 0.0, found.gradient[: len(x)])

    start = np.clip(theta, lower, upper)
    linear = likelihood.evaluate(start, at.scatter, at.spreads).linear
    X = linear.evaluate(at.scatter, at.spreads)[1]
    curvature = 2 * X + _OPEN * np.eye(len(theta))
    found = search_quadratically(evaluate, start, curvature, lower, upper, _CLOSE, _STEPS)
    return evaluate(found.x)[0], found.x


def _adopt(
    components: Components,
    linear: LinearModel,
    information: NDArray,
    g: NDArray,
    P: int,
    gone: NDArray,
) -> Components:
    """The components with the covariance that the measured information says.

    It is widened by as much as the average over scatters widens that of the linear model. Where
    the likelihood does not bend down on all sides, as beside a jump, the linear model's stays.
    """
    there = np.flatnonzero(~gone & (np.diag(information) > 0))
    inside = [int(j) for j in there if j < P]
    part = information[np.ix_(there, there)]
    X = linear.evaluate(components.scatter, components.spreads)[1]
    plain = invert_information(X)
    try:
        full = np.linalg.inv(part)
        np.linalg.cholesky(part)
        new = np.zeros((P, P))
        k = len(inside)
        new[np.ix_(inside, inside)] = full[:k, :k]
        wide = _carry(components.covariance, plain, new, inside)
    except np.linalg.LinAlgError:
        wide, new = components.covariance, plain
    return components._replace(covariance=wide, step=-0.5 * new @ g[:P])


def _carry(wide: NDArray, plain: NDArray, new: NDArray, inside: list[int]) -> NDArray:
    """`wide` as seen in coordinates in which `plain` becomes `new`."""
    index = np.ix_(inside, inside)
    map_ = np.linalg.cholesky(new[index]) @ np.linalg.inv(np.linalg.cholesky(plain[index]))
    out = np.zeros_like(wide)
    out[index] = map_ @ wide[index] @ map_.T
    return out
