"""The compiled programs of a fit: one follows recordings, one is a table's whole search."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from difffric.compute.program_cache import cache_program
from difffric.compute.xla_options import compile_soon
from difffric.estimation.mixed_model import MAX_STEPS, End, FitPoint, Problem, spread_coordinates


def _respond(rig: Any, integrator: Any, pushes: Any, c: Float[Array, "pushes coordinates"]) -> Any:
    """What every push answers at its coordinates: `residuals.Rows`, stacked."""
    return jax.vmap(lambda push, at: push.respond(rig, integrator, at))(pushes, c)


respond = cache_program(_respond)


def _compute_residuals(problem: Problem, point: FitPoint, respond: Callable[..., Any]) -> Any:
    """All residuals, with the exact Jacobian that came with the rows as their derivative, and the
    answers (rows, model, jumps) that they are from."""

    @jax.custom_jvp
    def of(point):
        rows, *_ = found = respond(point)
        return _join_residuals(problem, point, problem.weights * rows[..., -1]), tuple(found)

    @of.defjvp
    def _(primals, tangents):
        (point,), (shift,) = primals, tangents
        rows, *_ = found = respond(point)
        r = _join_residuals(problem, point, problem.weights * rows[..., -1])
        dc = spread_coordinates(problem._replace(fixed=jnp.zeros_like(problem.fixed)), shift)
        dr = problem.weights * jnp.einsum("nmk,nk->nm", rows[..., :-1], dc)
        zero = jax.tree.map(jnp.zeros_like, tuple(found))
        centred = problem._replace(prior=jnp.zeros_like(problem.prior))
        return (r, tuple(found)), (_join_residuals(centred, shift, dr), zero)

    return of(point)


def _join_residuals(problem: Problem, point: FitPoint, rows: Array) -> Any:
    """The weighted rows, the pushes' eta and the shared parameters' distance from what was known
    before, all scaled by the trust."""
    parts = rows, point.eta, problem.prior_weight * (point.theta - problem.prior)
    return jax.tree.map(lambda part: problem.trust * part, parts)


@compile_soon
def minimise_table(problem: Problem, start: FitPoint, steps: Array) -> End:
    """The conditional mode near `start`, by optimistix's Levenberg-Marquardt, after `steps`
    steps at most."""
    import optimistix as optx  # here, as a kept program needs none of it

    from difffric.compute.levenberg_marquardt import LevenbergMarquardt

    def respond_at(point: FitPoint) -> Any:
        c = spread_coordinates(problem, point)
        return _respond(problem.rig, problem.integrator, problem.pushes, c)

    # Traced once for all the places in which the solver calls it.
    respond_once = eqx.filter_closure_convert(respond_at, start)
    solution = optx.least_squares(
        lambda point, _: _compute_residuals(problem, point, respond_once),
        LevenbergMarquardt(),
        start,
        args=steps,
        has_aux=True,
        max_steps=MAX_STEPS,
        throw=False,
    )
    point, (rows, model, jumps) = solution.value, solution.state.aux
    r = _join_residuals(problem, point, problem.weights * rows[..., -1])
    chi2 = sum(jnp.sum(part**2) for part in r) / problem.trust**2
    return End(point, rows, model, jumps, chi2, solution.stats["num_steps"])
