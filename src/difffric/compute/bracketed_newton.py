"""mu_s from F_p or d in a bracket that holds one crossing: Newton's iteration (optimistix)."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx

from difffric.compute.event_root import HIT
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.observables import observe


class _Search(eqx.Module):
    lower: jax.Array
    upper: jax.Array
    step: jax.Array
    slope: jax.Array
    arrived: jax.Array


class BracketedNewton(optx.AbstractRootFinder):
    """Newton's iteration for a scalar function that changes sign once in a bracket.

    A step that leaves the bracket, or starts where the function is flat, is replaced by
    bisection, so it cannot diverge. Options: `lower` and `upper`, as for
    `optimistix.Bisection`, and `rising`, whether the function is negative below the root.
    """

    atol: float = 1e-15
    rtol: float = 0.0
    norm: Any = jnp.abs

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        lower, upper = (jnp.asarray(options[key], float) for key in ("lower", "upper"))
        nothing = jnp.asarray(jnp.nan)
        return _Search(lower, upper, jnp.asarray(jnp.inf), nothing, jnp.asarray(False))

    def step(self, fn, y, args, options, state, tags):
        (value, aux), (slope, _) = jax.jvp(lambda at: fn(at, args), (y,), (jnp.ones_like(y),))
        below = (value < 0) == options["rising"]
        lower = jnp.where(below, y, state.lower)
        upper = jnp.where(below, state.upper, y)
        flat = (slope == 0) | ~jnp.isfinite(slope)
        new = y - value / jnp.where(flat, 1.0, slope)
        step = jnp.abs(new - y)
        inside = ~flat & (new >= lower) & (new <= upper)
        # Newton's error is quadratic in its step: after one this small, nothing is left to do.
        arrived = ~flat & ((inside & (step < 1e-9)) | (step <= 4e-16 * jnp.abs(y)))
        hit = jnp.abs(value) <= HIT
        new = jnp.where(hit, y, jnp.where(inside | arrived, new, 0.5 * (lower + upper)))
        arrived = arrived | hit
        last = jnp.where(arrived, 0.0, jnp.abs(new - y))
        return new, _Search(lower, upper, last, slope, arrived), aux

    def terminate(self, fn, y, args, options, state, tags):
        done = state.step <= self.atol + self.rtol * jnp.abs(y)
        return done, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        return y, aux, {}


class Root(NamedTuple):
    """Where the bracketed Newton iteration ended."""

    mu_s: jax.Array
    slope: jax.Array
    """derivative of the quantity by mu_s [N or m], to 1e-9"""
    solved: jax.Array
    """whether the quantity takes the target's value there"""


def solve(rig: Rig, velocity, target, by_force, bracket, rising, integrator=None) -> Root:
    """The mu_s in the bracket at which F_p (where `by_force`) or d takes the value `target`
    [N or m].

    Traceable; by_force and rising (whether the quantity grows with mu_s there) too, so that one
    program serves both quantities. Where the quantity does not exist it counts as less than
    any target.
    """
    lower, upper = jnp.log(bracket[0]), jnp.log(bracket[1])

    def excess(log_mu_s, _):
        mu_s = jnp.exp(log_mu_s)
        seen = observe(parameters.with_values(rig, {"mu_s": mu_s}), velocity, integrator)
        ratio = jnp.where(by_force, seen.peak_force, seen.sliding_distance) / target
        # d is close to a power of mu_s, F_p to a straight line: each its own scale for Newton.
        value = jnp.where(by_force, ratio - 1.0, jnp.log(jnp.where(by_force, 1.0, ratio)))
        return jnp.where(jnp.isnan(ratio), -1.0, value)

    solution = optx.root_find(
        excess,
        BracketedNewton(),
        0.5 * (lower + upper),
        options={"lower": lower, "upper": upper, "rising": rising},
        max_steps=200,
        throw=False,
    )
    mu_s, end = jnp.exp(solution.value), solution.state
    return Root(mu_s, end.slope * target / mu_s, end.arrived)
