"""The mode of a mixed model: parameters that pushes share, and a mu_s of each push.

log mu_s of push i is its shared value plus s eta_i with eta_i ~ N(0, 1): s is the scatter. The
conditional mode of all (theta, eta) is a penalised least-squares problem; the variances are those
of the linear mixed model about that mode (`restricted_likelihood`). A fit alternates the two
(`mixed_fit`): Lindstrom and Bates, Biometrics 46 (1990).

A table's pushes cost less to follow than a call: its whole search is one program
(`following.compiled_search`). To follow whole recordings costs milliseconds, so that NumPy takes
the steps (`minimise_stepwise`); it follows them too where every law is affine
(`following.respond_in_columns`), and only what has to be integrated is compiled.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.compute.arrow_jacobian import ArrowJacobian, Evaluation, search_minimum

if TYPE_CHECKING:
    from jaxtyping import Float

Array = Any  # NumPy's outside a compiled program, JAX's within

MAX_STEPS = 60
"""Levenberg-Marquardt steps of one descent at most."""
PADDING = 16
"""Pushes are padded to multiples of this, and free parameters of half of it: few shapes, few
compilations."""


class Problem(NamedTuple):
    """Penalised least squares over n pushes, K coordinates, P free parameters."""

    rig: Any
    integrator: Any
    pushes: Any
    """data of the pushes, stacked: a class of `residuals`"""
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


class FitPoint(NamedTuple):
    """Where a fit stands: shared coordinates, each push's eta, each push's start offset."""

    theta: Array
    eta: Array
    start: Array


class End(NamedTuple):
    """Where a fit ended, and what it is like there."""

    point: FitPoint
    rows: Array
    """(n, rows, K + 1): [J | r], unweighted"""
    model: Array
    """(n, 2)"""
    jumps: Array
    chi2: Array
    """the penalised sum of squares"""
    steps: Array


def spread_coordinates(problem: Problem, point: FitPoint) -> Float[Array, "pushes coordinates"]:
    """Each push's coordinates at a point. mu_s is the first, the start offset the last."""
    c = problem.fixed + problem.selection @ point.theta
    own, start = problem.scatter * point.eta, problem.starts * point.start
    if isinstance(c, np.ndarray):
        c[:, 0] += own
        c[:, -1] += start
        return c
    # Added in place too: a table's search ends on this or that side of a jump by a rounding.
    return c.at[:, 0].add(own).at[:, -1].add(start)


def minimise_stepwise(
    problem: Problem,
    start: FitPoint,
    steps: int,
    follow: Callable[[NDArray], Any],
    worth: float = 0.0,
) -> End:
    """The conditional mode near `start`, after `steps` steps at most, by the same method with its
    steps taken outside a compiled program: `follow` gives the pushes' `Rows` at their coordinates
    (n, K). A step that gains less than is `worth` it in chi-square is the last."""
    n, P = problem.fixed.shape[0], problem.prior.shape[0]

    def unpack(x: NDArray) -> FitPoint:
        return FitPoint(x[:P], *x[P:].reshape(2, n))

    def evaluate(x: NDArray) -> Evaluation:
        point = unpack(x)
        rows, model, jumps = map(np.asarray, follow(spread_coordinates(problem, point)))
        return Evaluation(*_weigh(problem, point, rows), (rows, model, jumps))

    x, found, steps = search_minimum(
        evaluate, np.concatenate(start), min(steps, MAX_STEPS), worth * float(problem.trust) ** 2
    )
    rows, model, jumps = found.aux
    chi2 = np.sum(found.r**2) / problem.trust**2
    return End(unpack(x), rows, model, jumps, chi2, steps)


def _weigh(problem: Problem, point: FitPoint, rows: NDArray) -> tuple[NDArray, ArrowJacobian]:
    """All residuals and their Jacobian: the weighted rows, the pushes' eta and the shared
    parameters' distance from what was known before, all scaled by the trust."""
    weighted = (problem.trust * problem.weights)[:, :, None] * rows
    prior = problem.trust * problem.prior_weight
    r = np.concatenate(
        [
            weighted[:, :, -1].ravel(),
            problem.trust * point.eta,
            prior * (point.theta - problem.prior),
        ]
    )
    own = np.stack(
        [problem.scatter * weighted[:, :, 0], problem.starts[:, None] * weighted[:, :, -2]], axis=2
    )
    shared = weighted[:, :, :-1] @ problem.selection
    return r, ArrowJacobian(shared, own, problem.trust, prior)
