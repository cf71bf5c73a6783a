"""How likely a table's pushes are at given parameters, each push's own mu_s integrated out.

`restricted_likelihood.estimate_variances` integrates it out about the mode, with the model linear
there; where a push says one or two numbers and friction scatters, that misses how the width of the
integral changes with the shared parameters. Here the model is linear between the points of a grid
about each push's mode, the integral is exact for that, and so is its gradient, by Fisher's
identity: the mean, over where each push's mu_s may lie, of the residuals' derivatives. Source:
A. P. Dempster, N. M. Laird and D. B. Rubin, J. R. Statist. Soc. B 39 (1977) 1-38.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.marginal.node_answers import Answerer, NodeAnswers
from difffric.calibration.marginal.push_integrals import Integrals, integrate_pieces
from difffric.estimation.descent import Model, Settled
from difffric.estimation.restricted_likelihood import LinearModel, linearise
from difffric.estimation.stacked_data import SLIDES, FitData

LEAST_SCATTER = 1e-8
"""A scatter of zero is taken as this small, as the grid has to have a width."""
_NEAR = np.sinh(np.linspace(-3.0, 3.0, 33))
"""The points about each push's mode, in its standard deviations: dense there, and far out."""
_WIDE = np.linspace(-6.0, 6.0, 25)
"""Those about the shared mu_s, in scatters: d jumps and bends, and other mu_s may explain it. The
distance of a free slide falls steadily with mu_s, and needs none."""
_FARTHEST = 5.0
"""A mode is first looked for within so many scatters."""
_OFF, _NARROWER, _WIDER = 1.0, 0.4, 2.5
"""Points about a mode do where it is off by less than so many standard deviations, and these are
so much narrower or wider at most."""
_EDGE = 5.0
"""A mean that is off by more than so many standard deviations is cut short by the last point."""
_ROUNDS, _REFINEMENTS = 12, 4
"""How often points are laid anew, and how often pieces are cut, at most."""
_SIMILAR = 0.3
"""Points serve for other variances while the logarithms of these change by less than this."""
_ROUGH = 2e-3
"""What a bend or a jump inside a push's pieces may change in its log likelihood."""
_JUMP, _SHORT, _LIKELY = 0.5, 0.1, 0.02
"""Residuals jump where they differ by more than the first along less than the second of a standard
deviation of the push's mu_s, and it matters where the density beside, in units of that, is more
than the third."""
_CUT, _PARTS = 6, 8
"""Pieces of a push that are cut at a time, and into how many: a jump is found in few rounds, each
of which costs nearly the same however many points it has."""


@dataclass(frozen=True)
class Likelihood:
    """The likelihood at a point, and how it changes about it."""

    theta: NDArray
    scatter: float
    spreads: NDArray
    each: NDArray
    """(n,) -2 log of the density of each push's measurements"""
    value: float
    """the sum of these, with the prior"""
    gradient: NDArray
    """(P + 1 + groups,) of the value, by theta, log scatter and log spreads"""
    mean: NDArray
    """(n,) each push's own log mu_s beyond the shared one, on average"""
    sd: NDArray
    """(n,) its standard deviation at these parameters"""
    linear: LinearModel
    """the linear mixed model about these means"""
    beside_jump: NDArray
    """(n,) whether a push's mu_s may lie beside a jump of the model: the gradient then lacks how
    the jump moves"""


class MarginalLikelihood:
    """-2 log of the density of a table's, or of free slides', measurements and of the prior.

    `factor` (n, rows) multiplies the weights of the residuals, as a robust fit found them.
    """

    def __init__(self, model: Model, data: FitData, at: Settled):
        self.model, self.data = model, data
        self.answerer = Answerer(model, data)
        own = np.concatenate([at.spreads, [1.0]])[data.group]
        self.factor = np.where(data.weights > 0, at.weights * own, 0.0)
        self.held = at.held
        rows = np.asarray(at.end.rows)[: data.n] * at.weights[..., None]
        # Where the last points lay: the parameters, the centres, what each push's measurements say
        # of its mu_s there, and how the centres move.
        drift = self._find_drift(rows, max(at.scatter, LEAST_SCATTER))
        self._laid = at.theta, at.s_eta, *drift
        # What the last pieces were at: parameters, logarithms of the variances, and the pieces.
        self._known: tuple[NDArray, NDArray, list] = np.full(1, np.nan), np.zeros(1), []

    def evaluate(self, theta: NDArray, scatter: float, spreads: NDArray) -> Likelihood:
        """At shared parameters (P,), a scatter and the spreads (groups,)."""
        data, layout = self.data, self.model.layout
        s, n = max(scatter, LEAST_SCATTER), self.data.n
        weights = self.factor / np.concatenate([spreads, [1.0]])[data.group]
        before, centre, information, drift = self._laid
        centre = np.clip(centre + drift @ (theta - before), -_FARTHEST * s, _FARTHEST * s)
        width = 1.0 / np.sqrt(information + s**-2)
        each, mean, sd, beside_jump = np.zeros(n), np.zeros(n), np.ones(n), np.zeros(n, bool)
        gradient = np.zeros(layout.n_free + 1 + len(spreads))
        rows = np.zeros((n, data.weights.shape[1], layout.fixed.shape[1] + 1))
        at = np.zeros(n)
        known = self._reuse(theta, s, spreads, weights)
        pieces = known or list(self._integrate(theta, s, weights, centre, width))
        for which, (grid, answers, found) in pieces:
            each[which] = -2 * (found.log - np.log(s))
            mean[which], sd[which] = found.mean, found.sd
            beside_jump[which] = _find_jumps(grid, answers, found, weights[which])
            pull = found.pull[..., :-1] * weights[which]
            by = np.einsum("kmr,kmrc->mc", pull, answers.J)
            gradient[: layout.n_free] += 2 * np.einsum("mc,mcp->p", by, layout.selection[which])
            gradient[layout.n_free] += 2 * (len(which) - np.sum(found.pull[..., -1] * grid / s))
            square = 2 * np.sum(pull * answers.r, axis=0)
            for g in range(len(spreads)):
                gradient[layout.n_free + 1 + g] -= np.sum(square[data.group[which] == g])
            k = np.argmin(np.abs(grid - found.mean), axis=0)
            column = np.arange(len(which))
            rows[which] = np.concatenate(
                [answers.J[k, column], answers.r[k, column][..., None]], axis=2
            )
            at[which] = grid[k, column]
        away = (theta - layout.start) / layout.prior_sd
        gradient[: layout.n_free] += 2 * away / layout.prior_sd
        gradient[layout.n_free + 1 :] += 2 * data.counts
        linear = self._linearise(theta, rows, at)
        self._laid = theta, mean, *self._find_drift(rows * weights[..., None], s)
        if not known:
            self._known = theta, np.log([s, *spreads]), pieces
        value = each.sum() + 2 * data.counts @ np.log(spreads) + away @ away
        seen = mean, sd, linear, beside_jump
        return Likelihood(theta, scatter, spreads, each, float(value), gradient, *seen)

    def _reuse(self, theta: NDArray, s: float, spreads: NDArray, weights: NDArray):
        """The last pieces, integrated anew: the model's answers do not depend on the variances."""
        before, variances, pieces = self._known
        if not np.array_equal(before, theta):
            return []
        if np.abs(np.log([s, *spreads]) - variances).max() > _SIMILAR:
            return []
        return [
            (which, (grid, answers, _integrate(grid, answers.r, weights[which], s)))
            for which, (grid, answers, _) in pieces
        ]

    def _integrate(
        self, theta: NDArray, s: float, weights: NDArray, centre: NDArray, width: NDArray
    ):
        """Yield pushes (m,) with their grid, answers and integrals until all are resolved."""
        which = np.arange(self.data.n)
        for last in range(_ROUNDS, 0, -1):
            grid = self._lay_points(s, centre[which], width[which])
            answers = self.answerer.answer(theta, grid, which)
            found = _integrate(grid, answers.r, weights[which], s)
            size = width[which]
            far = np.abs(found.mean - centre[which]) > _OFF * size
            far |= (found.sd < _NARROWER * size) | (found.sd > _WIDER * size)
            if last == 1:
                far[:] = False
            near = np.flatnonzero(~far)
            if len(near):
                yield from self._refine(
                    theta, s, weights, which[near], _pick(grid, answers, found, near)
                )
            which, again = which[far], np.flatnonzero(far)
            if not len(which):
                return
            centre, width = centre.copy(), width.copy()
            to = _find_mode(*_pick(grid, answers, found, again), weights[which], s)
            edge = _EDGE * size[far]
            out = np.abs(found.mean[far] - centre[which]) > edge
            centre[which] = np.where(out, to[0], found.mean[far])
            width[which] = np.where(out, to[1], found.sd[far])

    def _lay_points(self, s: float, centre: NDArray, width: NDArray) -> NDArray:
        """(points, m) ascending: about the modes and about the shared mu_s."""
        near = centre + width * _NEAR[:, None]
        if self.data.kind == SLIDES:
            return near
        wide = np.tile(s * _WIDE[:, None], (1, len(centre)))
        return np.sort(np.concatenate([near, wide]), axis=0)

    def _refine(self, theta: NDArray, s: float, weights: NDArray, which: NDArray, at):
        """Yield the pushes once their pieces are short where the model bends or jumps."""
        for last in range(_REFINEMENTS, -1, -1):
            grid, answers, found = at
            rough = _find_roughness(grid, answers, found, weights[which])
            bad = (rough.sum(axis=0) > _ROUGH) & (last > 0)
            fine = np.flatnonzero(~bad)
            if len(fine):
                yield which[fine], _pick(grid, answers, found, fine)
            index = np.flatnonzero(bad)
            if not len(index):
                return
            which, rough = which[index], rough[:, index]
            grid, answers, _ = _pick(grid, answers, found, index)
            worst = np.argsort(-rough, axis=0)[:_CUT]
            left, right = (np.take_along_axis(x, worst, axis=0) for x in (grid[:-1], grid[1:]))
            inside = [left + (right - left) * k / _PARTS for k in range(1, _PARTS)]
            more = self.answerer.answer(theta, np.concatenate(inside), which)
            grid = np.concatenate([grid, *inside])
            order = np.argsort(grid, axis=0, kind="stable")
            grid = np.take_along_axis(grid, order, axis=0)
            r, J = (
                np.take_along_axis(x, order.reshape(*order.shape, *[1] * (x.ndim - 2)), axis=0)
                for x in (np.concatenate(pair) for pair in zip(answers, more, strict=True))
            )
            at = grid, NodeAnswers(r, J), _integrate(grid, r, weights[which], s)

    def _linearise(self, theta: NDArray, rows: NDArray, at: NDArray) -> LinearModel:
        """The linear mixed model about each push's own log mu_s `at` (n,)."""
        layout, data = self.model.layout, self.data
        weight = np.where(self.held, 0.0, 1.0 / layout.prior_sd)
        away = weight * (theta - layout.start)
        prior = np.zeros((layout.n_free + 1,) * 2)
        prior[:-1, :-1] = np.diag(weight**2)
        prior[:-1, -1] = prior[-1, :-1] = weight * away
        prior[-1, -1] = away @ away
        return linearise(
            rows,
            self.factor,
            data.group,
            data.counts,
            data.least,
            layout.selection * ~self.held,
            prior,
            at,
            False,
        )

    def _find_drift(self, rows: NDArray, s: float) -> tuple[NDArray, NDArray]:
        """What the weighted rows say of each push's mu_s (n,), and how its mode moves with the
        shared parameters (n, P)."""
        X, z = rows[..., :-1] @ self.model.layout.selection, rows[..., 0]
        information = np.sum(z**2, axis=1)
        drift = -np.einsum("nm,nmp->np", z, X) / (information + s**-2)[:, None]
        return information, drift


def _integrate(grid: NDArray, r: NDArray, weights: NDArray, s: float) -> Integrals:
    return integrate_pieces(grid, np.concatenate([r * weights, (grid / s)[..., None]], axis=2))


def _pick(grid: NDArray, answers: NodeAnswers, found: Integrals, index: NDArray):
    """Some of the pushes."""
    log, pull, share, mean, sd = found
    picked = Integrals(log[index], pull[:, index], share[:, index], mean[index], sd[index])
    return grid[:, index], NodeAnswers(*(x[:, index] for x in answers)), picked


def _find_mode(
    grid: NDArray, answers: NodeAnswers, found: Integrals, weights: NDArray, s: float
) -> tuple[NDArray, NDArray]:
    """Where the mode (m,) and what its width (m,) would be, were the model linear beyond the point
    next to each push's mean."""
    k, column = np.argmin(np.abs(grid - found.mean), axis=0), np.arange(grid.shape[1])
    r, z = answers.r[k, column] * weights, answers.J[k, column, :, 0] * weights
    u, information = grid[k, column], np.sum(z**2, axis=1) + s**-2
    to = u - (np.sum(z * r, axis=1) + u / s**2) / information
    return np.clip(to, -_FARTHEST * s, _FARTHEST * s), 1.0 / np.sqrt(information)


def _find_roughness(
    grid: NDArray, answers: NodeAnswers, found: Integrals, weights: NDArray
) -> NDArray:
    """(pieces, m) what the model's bends and jumps inside the pieces may change."""
    width = (grid[1:] - grid[:-1])[..., None]
    z = answers.J[..., 0] * weights
    bend = np.abs(z[1:] - z[:-1]) * width / 8
    off = np.max(_measure_jumps(grid, answers, weights) + bend, axis=2)
    return found.share * np.minimum(off, 1.0)


def _measure_jumps(grid: NDArray, answers: NodeAnswers, weights: NDArray) -> NDArray:
    """(pieces, m, rows) how far residuals at the ends differ by more than their slopes say."""
    r, z = answers.r * weights, answers.J[..., 0] * weights
    width = (grid[1:] - grid[:-1])[..., None]
    return np.abs(r[1:] - r[:-1] - 0.5 * width * (z[1:] + z[:-1]))


def _find_jumps(grid: NDArray, answers: NodeAnswers, found: Integrals, weights: NDArray) -> NDArray:
    """(m,) whether residuals jump where a push's mu_s may lie."""
    width = grid[1:] - grid[:-1]
    density = found.share * found.sd / np.maximum(width, 1e-300)
    beside = np.zeros_like(density)
    beside[1:], beside[:-1] = density[:-1], np.maximum(beside[:-1], density[1:])
    jumps = np.max(_measure_jumps(grid, answers, weights), axis=2) > _JUMP
    return (jumps & (width < _SHORT * found.sd) & (beside > _LIKELY)).any(axis=0)


def minus_2_log_likelihood(model: Model, data: FitData, at: Settled) -> float:
    """-2 log of the density of the measurements, and of the prior, at the shared parameters,
    scatter and spreads of `at`."""
    return MarginalLikelihood(model, data, at).evaluate(at.theta, at.scatter, at.spreads).value
