"""Variances of a linear mixed model by restricted maximum likelihood (REML), in NumPy.

About the mode that `mixed_model` finds, the model is linear: residuals of push i are
`X theta + z s eta + noise`, with the shared parameters theta, the push's own mu_s (s is the
scatter, eta ~ N(0, 1)), and noise whose spread is known or to be estimated. `linearise` makes this
model, `estimate_variances` maximises its restricted likelihood. Method: Lindstrom and Bates,
Biometrics 46 (1990). An ensemble of many fits does the same for all at once, in
`ensemble.estimate_scatters`, on a grid of scatters, as its accuracy asks for no more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

_UNDETERMINED = 1e12
"""Variance of a coordinate along what is not determined at all."""
_MANY = 5
"""Pushes from which a scatter can be averaged over: fewer leave its variance without a mean."""
_SCATTERS = 60
"""Scatters that an average is taken over, evenly spaced in their logarithm."""
_LEAST_SCATTER, _NO_SCATTER = 1e-6, 1e-7
"""A scatter below the first is none; its logarithm is then that of the second."""
_ELSEWHERE = (1e-5, 0.01, 0.1)
"""Scatters that a search starts from besides the guess: the likelihood may have a maximum at none
and another beside it."""


class Components(NamedTuple):
    """Variances of a linear mixed model, and what they leave of the shared parameters."""

    scatter: float
    spreads: NDArray
    """(groups,) standard deviation of each group of rows whose noise was not known"""
    covariance: NDArray
    """(P, P) of the free parameters' coordinates; 0 for one that is not active"""
    freedom: NDArray
    """(P,) degrees of freedom of its t-distribution (Satterthwaite)"""
    step: NDArray
    """(P,) the generalised least-squares step that is left to go"""
    gain: float
    """the drop of chi-square in that step"""
    chi2: float
    """r' V^-1 r at the shared parameters"""
    criterion: float
    """-2 times the restricted log-likelihood at the point itself: at a jump of the model the
    step that the linearisation promises is not to be had"""
    relative_errors: NDArray
    """relative standard errors of the scatter (NaN: not estimated) and of the spreads"""


class LinearModel(NamedTuple):
    """The linear mixed model about a point, as Gram matrices of [X | start | z | r] a push.

    X (P columns) belongs to the shared parameters, z to the push's own log mu_s, r is the
    residual at that push's shared mu_s. `known` holds the rows whose noise is known, weighted
    by it, `groups` the others, a matrix a group, and `counts` how many samples a group has.
    """

    known: NDArray
    """(n, P + 3, P + 3)"""
    groups: NDArray
    """(groups, n, P + 3, P + 3)"""
    counts: NDArray
    """(groups,)"""
    prior: NDArray
    """(P + 1, P + 1): Gram of what was known before"""
    least: NDArray
    """(groups,) spreads below this are not looked for"""

    def evaluate(self, scatter: float, spreads: NDArray) -> tuple[float, NDArray, NDArray, float]:
        """(-2 times the restricted log-likelihood, X' V^-1 X (P, P), X' V^-1 r (P,), r' V^-1 r) for
        a scatter and the spreads (groups,)."""
        G = self.known + np.einsum("gnij,g->nij", self.groups, 1.0 / spreads**2)
        P = G.shape[1] - 3
        start = G[:, P, P]
        on = start > 0
        column = G[:, :, P]
        G = G - np.einsum("ni,nj->nij", column, column / np.where(on, start, 1.0)[:, None])
        z = np.maximum(G[:, P + 1, P + 1], 0.0)
        column = G[:, :, P + 1]
        shrink = scatter**2 / (1.0 + scatter**2 * z)
        G = G - np.einsum("ni,nj->nij", column, column * shrink[:, None])
        keep = [*range(P), P + 2]
        total = G.sum(axis=0)[np.ix_(keep, keep)] + self.prior
        X, Xr, rr = total[:P, :P], total[:P, P], total[P, P]
        log = np.log1p(scatter**2 * z).sum() + 2 * (self.counts * np.log(spreads)).sum()
        values, vectors = np.linalg.eigh(X)
        seen = values > 1e-13 * max(values.max(initial=0.0), 1e-300)
        projected = vectors.T @ Xr
        fitted = (projected[seen] ** 2 / values[seen]).sum()
        minus_2_log = log + np.log(values[seen]).sum() + rr - fitted
        return minus_2_log, X, Xr, rr


def linearise(
    rows: NDArray,
    weights: NDArray,
    group: NDArray,
    counts: Sequence[float] | NDArray,
    least: Sequence[float] | NDArray,
    selection: NDArray,
    prior: NDArray,
    s_eta: NDArray,
    start_on: bool,
) -> LinearModel:
    """The linear mixed model about a point.

    `rows` (n, m, K + 1) are the residuals with their derivatives, [J | r], `weights` (n, m) as in
    `mixed_model.Problem`, in units where a group's spread is 1; `group` (n, m) is the group of a
    row's noise, -1 where it is known; `counts` (groups,) and `least` (groups,) as in
    `LinearModel`; `selection` (n, K, P) says which coordinates are free; `prior` (P + 1, P + 1) is
    the Gram matrix of what was known before; `s_eta` (n,) is the push's own log mu_s beyond the
    shared one; `start_on` says whether pushes have start offsets.
    """
    J, r = rows[..., :-1], rows[..., -1]
    X, z = J @ selection, J[..., :1]
    start = J[..., -1:] * float(start_on)
    shared = r[..., None] - z * s_eta[:, None, None]
    M = np.concatenate([X, start, z, shared], axis=2) * weights[..., None]

    def make_gram(which: NDArray) -> NDArray:
        part = M * which[..., None]
        return np.einsum("nmi,nmj->nij", part, part)

    groups = [make_gram(group == g) for g in range(len(counts))]
    size = M.shape[2]
    stacked = np.stack(groups) if groups else np.zeros((0, len(M), size, size))
    counts, least = np.asarray(counts, float), np.asarray(least, float)
    return LinearModel(make_gram(group < 0), stacked, counts, prior, least)


def estimate_variances(
    model: LinearModel, scatter: float, spreads: NDArray, estimate: bool, search: bool = True
) -> Components:
    """The variances that maximise the restricted likelihood, from a first guess and, to
    `search`, from other scatters too.

    The scatter is estimated only where `estimate` says so; what follows from the variances is as
    `describe_variances` has it.
    """
    first = [max(scatter, 1e-4)] if estimate else []
    guess = np.log([*first, *np.maximum(spreads, model.least)])
    unpack = _unpack_by(scatter, estimate)
    best = guess
    if len(guess):
        limits = [(np.log(_NO_SCATTER), np.log(1.0))] if estimate else []
        limits += [(np.log(least), np.log(least) + 20.0) for least in model.least]
        starts = [guess]
        if estimate and search:
            starts += [np.array([x, *guess[1:]]) for x in np.log(_ELSEWHERE)]
        best = _maximise(lambda x: model.evaluate(*unpack(x))[0], starts, limits)
    return describe_variances(model, *unpack(best), estimate)


def describe_variances(
    model: LinearModel, scatter: float, spreads: NDArray, estimate: bool
) -> Components:
    """What a scatter and spreads (groups,) leave of the shared parameters; `estimate` says whether
    the scatter was estimated.

    The covariance allows for what is not known of it (`average_over_scatters`). Degrees of freedom
    are for the spreads: Satterthwaite, Biometrics Bulletin 2 (1946), with the variances' own
    covariance from the likelihood; and for the scatter where pushes are too few to average over it.
    """
    first = [max(scatter, _NO_SCATTER)] if estimate else []
    P = model.prior.shape[0] - 1
    criterion, X, Xr, rr = model.evaluate(scatter, spreads)
    covariance = invert_information(X)
    many = estimate and len(model.known) >= _MANY
    freedom, relative = _approximate_freedom(
        model,
        _unpack_by(scatter, estimate),
        np.log([*first, *spreads]),
        covariance,
        P,
        scatter_too=not many,
    )
    return Components(
        scatter=scatter,
        spreads=spreads,
        covariance=average_over_scatters(model, spreads)[0] if many else covariance,
        freedom=freedom,
        step=-covariance @ Xr,
        gain=float(Xr @ covariance @ Xr),
        chi2=float(rr),
        criterion=float(criterion + Xr @ covariance @ Xr),
        relative_errors=relative if estimate else np.array([np.nan, *relative]),
    )


def _unpack_by(scatter: float, estimate: bool) -> Callable[[NDArray], tuple[float, NDArray]]:
    """What takes the scatter and the spreads out of the logarithms of those that are estimated."""

    def unpack(x: NDArray) -> tuple[float, NDArray]:
        s = float(np.exp(x[0])) if estimate else scatter
        return (0.0 if s < _LEAST_SCATTER else s), np.exp(x[1:] if estimate else x)

    return unpack


def _maximise(
    minus_2_log: Callable[[NDArray], float],
    starts: Sequence[NDArray],
    limits: Sequence[tuple[float, float]],
) -> NDArray:
    """The logarithms of scatter and spreads at which the likelihood is largest, of those found
    from several starts within limits."""
    found = [
        scipy.optimize.minimize(minus_2_log, x, method="L-BFGS-B", bounds=limits) for x in starts
    ]
    return min(found, key=lambda end: end.fun).x


def estimate_shared(
    model: LinearModel, scatter: float, spreads: NDArray, estimate: bool
) -> tuple[NDArray, NDArray]:
    """Covariance (P, P) of the shared parameters and the least-squares step (P,) to their best,
    averaged over the scatter where it was estimated from enough pushes."""
    if estimate and len(model.known) >= _MANY:
        return average_over_scatters(model, spreads)
    _, X, Xr, _ = model.evaluate(scatter, spreads)
    covariance = invert_information(X)
    return covariance, -covariance @ Xr


def average_over_scatters(model: LinearModel, spreads: NDArray) -> tuple[NDArray, NDArray]:
    """Covariance (P, P) and mean step (P,) over the scatters that the data leave open.

    Few pushes leave the scatter open by a fifth or more, and one that is small may be estimated
    as none. The restricted likelihood weighs the scatters; the prior is even in log s, and in s
    below what the noise lets see: for many pushes as for few the interval is Student's.
    """
    seen = np.einsum("gnij,g->nij", model.groups, 1.0 / spreads**2) + model.known
    z = seen[:, -2, -2]
    visible = 1.0 / np.sqrt(np.median(z[z > 0])) if (z > 0).any() else 1.0
    grid = np.concatenate([[0.0], np.geomspace(1e-2 * min(visible, 1e-2), 1.0, _SCATTERS)])
    minus_2_log, covariances, steps = [], [], []
    for s in grid:
        found, X, Xr, _ = model.evaluate(s, spreads)
        covariances.append(invert_information(X))
        steps.append(-covariances[-1] @ Xr)
        minus_2_log.append(found)
    weight = (
        np.gradient(grid)
        / (grid + visible)
        * np.exp(0.5 * (min(minus_2_log) - np.array(minus_2_log)))
    )
    weight /= weight.sum()
    step = weight @ np.array(steps)
    away = np.array(steps) - step
    between = np.einsum("s,si,sj->ij", weight, away, away)
    return np.einsum("s,sij->ij", weight, np.array(covariances)) + between, step


def invert_information(information: NDArray) -> NDArray:
    """The covariance (P, P) that belongs to an information matrix (P, P): a huge variance along
    what is not determined at all, and 0 for a parameter whose row is empty."""
    there = np.diag(information) > 0
    part = information[np.ix_(there, there)]
    out = np.zeros_like(information)
    if there.any():
        size = np.sqrt(np.diag(part))
        values, vectors = np.linalg.eigh(part / np.outer(size, size))
        known = values > 1e-12 * values.max()
        inverse = np.where(known, 1.0 / np.where(known, values, 1.0), _UNDETERMINED)
        out[np.ix_(there, there)] = (vectors * inverse) @ vectors.T / np.outer(size, size)
    return out


def _approximate_freedom(
    model: LinearModel,
    unpack: Callable[[NDArray], tuple[float, NDArray]],
    x: NDArray,
    covariance: NDArray,
    P: int,
    scatter_too: bool,
) -> tuple[NDArray, NDArray]:
    """Satterthwaite's degrees of freedom of each parameter's variance (P,), and the standard errors
    of x, the logarithms of the scatter (if it was estimated) and of the spreads.

    They allow for what is not known of the spreads and, if `scatter_too`, of the scatter.
    """
    out, errors = np.full(P, np.inf), np.full(len(x), np.nan)
    n_scatter = len(x) - len(model.least)
    moving = [j for j in range(len(x)) if j >= n_scatter or unpack(x)[0] > 1e-4]
    if not moving:
        return out, errors
    h = 1e-3
    E = np.eye(len(x))[moving] * h

    def f(at):
        return model.evaluate(*unpack(at))[0]

    hessian = np.array(
        [[f(x + a + b) - f(x + a - b) - f(x - a + b) + f(x - a - b) for b in E] for a in E]
    ) / (4 * h * h)

    def variances(at):
        return np.diag(invert_information(model.evaluate(*unpack(at))[1]))

    slope = np.array([(variances(x + a) - variances(x - a)) / (2 * h) for a in E])
    if not scatter_too:
        slope[[j < n_scatter for j in moving]] = 0.0
    values, vectors = np.linalg.eigh(0.5 * hessian)
    of_variances = (vectors / np.maximum(values, 1e-2)) @ vectors.T
    errors[moving] = np.sqrt(np.diag(of_variances))
    uncertainty = np.einsum("ap,ab,bp->p", slope, of_variances, slope)
    there = (np.diag(covariance) > 0) & (uncertainty > 0)
    out[there] = 2 * np.diag(covariance)[there] ** 2 / uncertainty[there]
    return out, errors
