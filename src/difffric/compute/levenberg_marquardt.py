"""Optimistix's Levenberg-Marquardt method with what a fit of many pushes needs of it.

`ArrowSolver` solves each step's linear least squares, whose matrix has the shape of an arrow: a few
columns that all pushes share, and one or two of each push's own, which are eliminated push by push.
`LevenbergMarquardt` ends a search where a model with jumps would keep it going for nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jax import Array
from lineax import RESULTS

_STEP = 1e-7
"""A step smaller than this in every coordinate is none."""
_REFUSALS = 10
"""Refused steps in a row after which a search has arrived."""


class LevenbergMarquardt(optx.LevenbergMarquardt):
    """Optimistix's, which also stops after `args` steps, and where it would go on for nothing:
    at an optimum to rounding, whose next step is none, and at a jump of the model, where step
    after step is refused."""

    def __init__(self):
        super().__init__(rtol=1e-8, atol=1e-7, linear_solver=ArrowSolver())  # pyright: ignore

    def terminate(
        self,
        fn: Callable,
        y: Any,
        args: Any,
        options: dict[str, Any],
        state: Any,
        tags: frozenset[object],
    ) -> tuple[Array, optx.RESULTS]:
        """(whether the search ends here, how); `args`: after so many steps at most."""
        stop, result = super().terminate(fn, y, args, options, state, tags)
        refused = state.num_steps_since_acceptance >= _REFUSALS
        step = jax.tree.map(
            lambda new, old: jnp.max(jnp.abs(new - old), initial=0.0), state.y_eval, y
        )
        nothing = (jnp.max(jnp.stack(jax.tree.leaves(step))) < _STEP) & (state.num_steps > 0)
        return stop | refused | nothing | (state.num_steps >= args), result


class _ArrowBlocks(NamedTuple):
    """The blocks of the normal equations, and what takes a vector to their right-hand side."""

    shared: Any
    """(P, P)"""
    mixed: Any
    """(n, P, q)"""
    own: Any
    """(n, q, q)"""
    columns: Any
    """the operator applied to a basis: shared columns, then the pushes' own, all at once"""


class ArrowSolver(lx.AbstractLinearSolver):
    """Solves min |A x - b| for x = (theta, eta, start) of `mixed_model.FitPoint`, where eta and
    start of a push act on the residuals of that push alone.

    The columns of all pushes are had by one product each (Curtis, Powell and Reid, J. Inst.
    Math. Appl. 13 (1974)); the cost is linear in the number of pushes. Normal equations:
    what they lose in accuracy the next Levenberg-Marquardt step makes up.
    """

    def init(self, operator: lx.AbstractLinearOperator, options: dict[str, Any]) -> _ArrowBlocks:
        """The blocks of the normal equations."""
        theta, eta, start = operator.in_structure()
        P, n, q = theta.size, eta.size, 1 + (start.size > 0)
        shared = jnp.concatenate([jnp.eye(P), jnp.zeros((q, P))])
        own = jnp.zeros((P + q, q)).at[P:].set(jnp.eye(q))
        basis = type(operator.in_structure())(
            shared,
            jnp.broadcast_to(own[:, :1], (P + q, n)),
            jnp.broadcast_to(own[:, -1:], (P + q, start.size)),
        )
        columns = jax.vmap(operator.mv)(basis)
        (rows, eta_part, prior), damping = columns
        per_push = jnp.concatenate([rows, eta_part[..., None], damping.eta[..., None]], axis=2)
        if q == 2:
            per_push = jnp.concatenate([per_push, damping.start[..., None]], axis=2)
        gram = jnp.einsum("inm,jnm->nij", per_push, per_push)
        rest = jnp.concatenate([prior, damping.theta], axis=1)[:P]
        normal = _ArrowBlocks(
            shared=gram[:, :P, :P].sum(axis=0) + rest @ rest.T,
            mixed=gram[:, :P, P:],
            own=gram[:, P:, P:],
            columns=columns,
        )
        return normal

    def compute(
        self, state: _ArrowBlocks, vector: Any, options: dict[str, Any]
    ) -> tuple[Any, RESULTS, dict[str, Any]]:
        """(solution, that all is well, nothing more) for one right-hand side."""
        (rows, eta_part, prior), damping = state.columns
        (r, eta_r, prior_r), damping_r = vector
        P = state.shared.shape[0]
        by_push = jnp.einsum("inm,nm->ni", rows, r) + eta_part.T * eta_r[:, None]
        by_push = by_push + damping.eta.T * damping_r.eta[:, None]
        if damping.start.shape[1]:
            by_push = by_push + damping.start.T * damping_r.start[:, None]
        g = by_push[:, :P].sum(axis=0) + prior[:P] @ prior_r + damping.theta[:P] @ damping_r.theta
        g_own = by_push[:, P:]
        inverse = _inverse(state.own)
        across = jnp.einsum("npq,nqr->npr", state.mixed, inverse)
        reduced = state.shared - jnp.einsum("npq,nrq->pr", across, state.mixed)
        theta = jnp.linalg.solve(reduced, g - jnp.einsum("npq,nq->p", across, g_own))
        left = g_own - jnp.einsum("npq,p->nq", state.mixed, theta)
        own = jnp.einsum("nqr,nr->nq", inverse, left)
        start = own[:, 1] if damping.start.shape[1] else jnp.zeros(0)
        return type(damping)(theta, own[:, 0], start), RESULTS.successful, {}

    def transpose(self, state: _ArrowBlocks, options: dict[str, Any]) -> Any:
        """Never asked for: raises `NotImplementedError`."""
        raise NotImplementedError("an arrow is solved as it is")

    def conj(self, state: _ArrowBlocks, options: dict[str, Any]) -> Any:
        """The blocks themselves, as they are real."""
        return state, options

    def assume_full_rank(self) -> bool:
        """Whether a solution is had only where there is one."""
        return True


def _inverse(blocks):
    """Inverses of symmetric blocks of one row or two."""
    if blocks.shape[-1] == 1:
        return 1.0 / blocks
    a, b, d = blocks[:, 0, 0], blocks[:, 0, 1], blocks[:, 1, 1]
    adjugate = jnp.stack([jnp.stack([d, -b], 1), jnp.stack([-b, a], 1)], 1)
    return adjugate / (a * d - b * b)[:, None, None]
