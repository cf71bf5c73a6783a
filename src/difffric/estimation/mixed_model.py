"""Mixed effects: parameters that pushes share, a mu_s of each push, and the scatter between them.

log mu_s of push i is its shared value plus s eta_i with eta_i ~ N(0, 1): s is the scatter. The
conditional mode of all (theta, eta) is a penalised least-squares problem (`minimise`); the
variances are those of the linear mixed model about that mode, by restricted maximum likelihood
(`components`). Alternating the two is the algorithm of Lindstrom and Bates, Biometrics 46 (1990).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.compute.program_cache import kept
from difffric.compute.xla_options import soon_compiled

Array = Any  # NumPy's outside a compiled program, JAX's within

MAX_STEPS = 60
PADDING = 16
"""Pushes are padded to multiples of this, and free parameters of half of it: few shapes, few
compilations."""

_UNDETERMINED = 1e12
"""Variance of a coordinate along what is not determined at all."""
_MANY = 5
"""Pushes from which a scatter can be averaged over: fewer leave its variance without a mean."""
_SCATTERS = 60
_LEAST_SCATTER = 1e-6
"""A scatter below this is none."""


class Problem(NamedTuple):
    """Penalised least squares over n pushes, K coordinates, P free parameters."""

    rig: Any
    integrator: Any
    pushes: Any
    """data of the pushes, stacked: `responses`"""
    selection: Array
    """(n, K, P)"""
    fixed: Array
    """(n, K)"""
    scatter: Array
    """(): s"""
    weights: Array
    """(n, rows): 1 / standard deviation of each row, 0 where there is nothing"""
    prior: Array
    """(P,) mean"""
    prior_weight: Array
    """(P,) 1 / standard deviation"""
    starts: Array
    """(n,): 1 where a push has a start offset of its own, else 0"""
    trust: Array
    """(): how far the first step may go: residuals are scaled by it against the damping of 1"""


class Point(NamedTuple):
    """Where a fit stands: shared coordinates, each push's eta, each push's start offset."""

    theta: Array
    eta: Array
    start: Array


class End(NamedTuple):
    """Where a fit ended, and what it is like there."""

    point: Point
    rows: Array
    """(n, rows, K + 1): [J | r], unweighted"""
    model: Array
    """(n, 2)"""
    jumps: Array
    chi2: Array
    """the penalised sum of squares"""
    steps: Array


def coordinates(problem: Problem, point: Point):
    """(n, K): each push's coordinates. mu_s is the first, the start offset the last."""
    c = problem.fixed + problem.selection @ point.theta
    c = c.at[:, 0].add(problem.scatter * point.eta)
    if point.start.size:
        c = c.at[:, -1].add(problem.starts * point.start)
    return c


@kept
def _respond(problem: Problem, point: Point):
    def one(push, c):
        return push.respond(problem.rig, problem.integrator, c)

    return jax.vmap(one)(problem.pushes, coordinates(problem, point))


def _residuals(problem: Problem, point: Point, respond):
    """All residuals, with the exact Jacobian that came with the rows as their derivative."""

    @jax.custom_jvp
    def of(point):
        rows, *_ = found = respond(point)
        return _stacked(problem, point, problem.weights * rows[..., -1]), tuple(found)

    @of.defjvp
    def _(primals, tangents):
        (point,), (moved,) = primals, tangents
        rows, *_ = found = respond(point)
        r = _stacked(problem, point, problem.weights * rows[..., -1])
        dc = coordinates(problem._replace(fixed=jnp.zeros_like(problem.fixed)), moved)
        dr = problem.weights * jnp.einsum("nmk,nk->nm", rows[..., :-1], dc)
        zero = jax.tree.map(jnp.zeros_like, tuple(found))
        shifted = problem._replace(prior=jnp.zeros_like(problem.prior))
        return (r, tuple(found)), (_stacked(shifted, moved, dr), zero)

    return of(point)


def _stacked(problem: Problem, point: Point, rows):
    parts = rows, point.eta, problem.prior_weight * (point.theta - problem.prior)
    return jax.tree.map(lambda part: problem.trust * part, parts)


def _minimise(problem: Problem, start: Point, steps) -> End:
    """The conditional mode near `start`, by optimistix's Levenberg-Marquardt, after `steps`
    steps at most."""
    import optimistix as optx  # here, as a kept program needs none of it

    from difffric.compute.levenberg_marquardt import LevenbergMarquardt

    # Traced once for all the places in which the solver calls it.
    respond = eqx.filter_closure_convert(lambda point: _respond(problem, point), start)
    solution = optx.least_squares(
        lambda point, _: _residuals(problem, point, respond),
        LevenbergMarquardt(),
        start,
        args=steps,
        has_aux=True,
        max_steps=MAX_STEPS,
        throw=False,
    )
    point, (rows, model, jumps) = solution.value, solution.state.aux
    r = _stacked(problem, point, problem.weights * rows[..., -1])
    chi2 = sum(jnp.sum(part**2) for part in r) / problem.trust**2
    return End(point, rows, model, jumps, chi2, solution.stats["num_steps"])


minimise = kept(_minimise)
minimise_soon = soon_compiled(_minimise)


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

    def criterion(self, scatter: float, spreads: NDArray):
        """-2 times the restricted log-likelihood, X' V^-1 [X | r], and r' V^-1 r."""
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


def linear_model(
    rows, weights, group, counts, least, selection, prior, s_eta, start_on
) -> LinearModel:
    """The linear mixed model about a point.

    `rows` (n, m, K + 1) and `weights` (n, m) as in `Problem`, in units where a group's spread is
    1; `group` (n, m) is the group of a row's noise, -1 where it is known; `s_eta` (n,) the push's
    own log mu_s beyond the shared one; `start_on` whether pushes have start offsets.
    """
    J, r = rows[..., :-1], rows[..., -1]
    X, z = J @ selection, J[..., :1]
    start = J[..., -1:] * float(start_on)
    shared = r[..., None] - z * s_eta[:, None, None]
    M = np.concatenate([X, start, z, shared], axis=2) * weights[..., None]

    def gram(which):
        part = M * which[..., None]
        return np.einsum("nmi,nmj->nij", part, part)

    groups = [gram(group == g) for g in range(len(counts))]
    size = M.shape[2]
    stacked = np.stack(groups) if groups else np.zeros((0, len(M), size, size))
    counts, least = np.asarray(counts, float), np.asarray(least, float)
    return LinearModel(gram(group < 0), stacked, counts, prior, least)


def components(
    model: LinearModel, scatter: float, spreads: NDArray, estimate: bool, search: bool = True
) -> Components:
    """The variances that maximise the restricted likelihood, from a first guess and, to
    `search`, from other scatters too.

    The scatter is estimated only where `estimate` says so. The covariance allows for what is not
    known of it (`averaged`). Degrees of freedom are for the spreads: Satterthwaite, Biometrics
    Bulletin 2 (1946), with the variances' own covariance from the likelihood; and for the scatter
    where pushes are too few to average over it.
    """
    guess = np.log([*([max(scatter, 1e-4)] * estimate), *np.maximum(spreads, model.least)])
    P = model.prior.shape[0] - 1

    def unpack(x):
        s = float(np.exp(x[0])) if estimate else scatter
        return (0.0 if s < _LEAST_SCATTER else s), np.exp(x[1:] if estimate else x)

    def objective(x):
        return model.criterion(*unpack(x))[0]

    best = guess
    if len(guess):
        limits = [(np.log(1e-7), np.log(1.0))] * estimate
        limits += [(np.log(least), np.log(least) + 20.0) for least in model.least]
        starts = [guess]
        if estimate and search:
            starts += [np.array([x, *guess[1:]]) for x in np.log([1e-5, 0.01, 0.1])]
        found = [
            scipy.optimize.minimize(objective, x, method="L-BFGS-B", bounds=limits) for x in starts
        ]
        best = min(found, key=lambda f: f.fun).x
    s, spread = unpack(best)
    criterion, X, Xr, rr = model.criterion(s, spread)
    covariance = inverse(X)
    many = estimate and len(model.known) >= _MANY
    freedom, relative = _freedom(model, unpack, best, covariance, P, scatter_too=not many)
    return Components(
        scatter=s,
        spreads=spread,
        covariance=averaged(model, spread)[0] if many else covariance,
        freedom=freedom,
        step=-covariance @ Xr,
        gain=float(Xr @ covariance @ Xr),
        chi2=float(rr),
        criterion=float(criterion + Xr @ covariance @ Xr),
        relative_errors=relative if estimate else np.array([np.nan, *relative]),
    )


def covariance_and_step(
    model: LinearModel, scatter: float, spreads: NDArray, estimate: bool
) -> tuple[NDArray, NDArray]:
    """(P, P) and (P,): averaged over the scatter where it was estimated from enough pushes."""
    if estimate and len(model.known) >= _MANY:
        return averaged(model, spreads)
    _, X, Xr, _ = model.criterion(scatter, spreads)
    covariance = inverse(X)
    return covariance, -covariance @ Xr


def averaged(model: LinearModel, spreads: NDArray) -> tuple[NDArray, NDArray]:
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
        found, X, Xr, _ = model.criterion(s, spreads)
        covariances.append(inverse(X))
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


def inverse(information):
    """Inverse information, with a huge variance along what is not determined at all, and 0 for
    what is not there."""
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


def _freedom(model: LinearModel, unpack, x, covariance, P, scatter_too: bool):
    """Satterthwaite's degrees of freedom of each parameter's variance (P,), for what is not known
    of the spreads and of the scatter, if that counts; and the standard errors of the logarithms
    x."""
    out, errors = np.full(P, np.inf), np.full(len(x), np.nan)
    n_scatter = len(x) - len(model.least)
    moving = [j for j in range(len(x)) if j >= n_scatter or unpack(x)[0] > 1e-4]
    if not moving:
        return out, errors
    h = 1e-3
    E = np.eye(len(x))[moving] * h

    def f(at):
        return model.criterion(*unpack(at))[0]

    hessian = np.array(
        [[f(x + a + b) - f(x + a - b) - f(x - a + b) + f(x - a - b) for b in E] for a in E]
    ) / (4 * h * h)

    def variances(at):
        return np.diag(inverse(model.criterion(*unpack(at))[1]))

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
