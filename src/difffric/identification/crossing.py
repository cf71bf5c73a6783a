"""The mu_s at which a push's F_p or d takes a measured value, in a bracket that holds one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.compute import arrays as xp
from difffric.compute.bracketed_step import LONGEST, find_roots_in_brackets
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.columns import observe_columns
from difffric.simulation.observables import Observables, observe
from difffric.simulation.segments import Integrator

if TYPE_CHECKING:
    from jaxtyping import Array, ArrayLike, Bool, Float


class Crossing(NamedTuple):
    """Where the bracketed Newton iteration ended."""

    mu_s: Any
    slope: Any
    """derivative of the quantity by mu_s [N or m], to 1e-9"""
    solved: Any
    """whether the quantity takes the target's value there"""


def find_crossing(
    rig: Rig,
    velocity: ArrayLike,
    target: ArrayLike,
    by_force: Bool[ArrayLike, ""],
    bracket: tuple[ArrayLike, ArrayLike] | Float[Array, "2"],
    rising: Bool[ArrayLike, ""],
    integrator: Integrator | None = None,
) -> Crossing:
    """The mu_s in the bracket at which F_p (where `by_force`) or d takes the value `target`
    [N or m].

    Traceable; by_force and rising (whether the quantity grows with mu_s there) too, so that one
    program serves both quantities. Where the quantity does not exist it counts as less than
    any target.
    """
    import jax.numpy as jnp
    import optimistix as optx

    from difffric.compute.bracketed_newton import BracketedNewton

    lower, upper = jnp.log(bracket[0]), jnp.log(bracket[1])

    def excess(log_mu_s, _):
        at = parameters.with_values(rig, {"mu_s": jnp.exp(log_mu_s)})
        return _measure_excess(observe(at, velocity, integrator), target, by_force)

    solution = optx.root_find(
        excess,
        BracketedNewton(),
        0.5 * (lower + upper),
        options={"lower": lower, "upper": upper, "rising": rising},
        max_steps=LONGEST,
        throw=False,
    )
    mu_s, end = jnp.exp(solution.value), solution.state
    return Crossing(mu_s, end.slope * target / mu_s, end.arrived)


def find_crossings_in_columns(
    rigs: Rig,
    velocity: NDArray,
    target: NDArray,
    by_force: NDArray,
    bracket: tuple[NDArray, NDArray],
    rising: NDArray,
) -> Crossing:
    """`find_crossing` of n pushes by NumPy, for rigs that `simulation.columns` serves.

    Every number of the rigs is one value or n, all else n.
    """

    def excess(log_mu_s, rigs, velocity, target, by_force):
        at = parameters.with_values(rigs, {"mu_s": xp.exp(log_mu_s)})
        return _measure_excess(observe_columns(at, velocity), target, by_force)

    interval = np.log(bracket[0]), np.log(bracket[1])
    log_mu_s, end = find_roots_in_brackets(
        excess, (rigs, velocity, target, by_force), *interval, rising
    )
    mu_s = np.exp(log_mu_s)
    return Crossing(mu_s, end.slope * target / mu_s, end.arrived)


def _measure_excess(seen: Observables, target: Any, by_force: Any) -> Any:
    """How far what is measured of a push lies above the target, on a scale of its own; where it
    does not exist it counts as less than any."""
    ratio = xp.where(by_force, seen.peak_force, seen.sliding_distance) / target
    # d is close to a power of mu_s, F_p to a straight line: each its own scale for Newton.
    value = xp.where(by_force, ratio - 1.0, xp.log(xp.where(by_force, 1.0, ratio)))
    return xp.where(xp.isnan(ratio), -1.0, value)
