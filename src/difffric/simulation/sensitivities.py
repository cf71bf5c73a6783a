"""Exact derivatives of F_p and d in every parameter, and how far the next regime is.

A rig's numbers are read once, in the order of `parameters.names` with the speed behind them, and
put back once. What else goes in is a direction: how fast each of them changes. NumPy follows the
push where it can (`columns`), along all directions at once; else a compiled program does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from difffric.compute import pytrees
from difffric.compute.number_tree import is_traced
from difffric.compute.program_cache import cache_program
from difffric.errors import InputError
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.columns import VELOCITY, differentiate_columns, observe_columns, serves
from difffric.simulation.observables import Observables, observe
from difffric.simulation.segments import Integrator

if TYPE_CHECKING:
    from jaxtyping import Array, ArrayLike, Float, Int

NEAR_EDGE = 1e-3
"""A margin below this makes derivatives one-sided in the answer."""
_POINTS = 48
"""Points of the scan for the next regime, a side and a round: each narrows it by that factor."""
_ROUNDS = 5
"""Rounds of the scan: they refine it to about 1e-7."""
_NEAREST, _FURTHEST = 1e-8, (0.999, 9.0)
"""Relative changes of mu_s, down and up, between which the next regime is looked for."""

Numbers: TypeAlias = "tuple[Array, ...]"
"""A rig's parameters in the order of their names, then the speed [SI]; or how fast each changes."""


class Sensitivity(NamedTuple):
    """Observables of one push and the derivatives of F_p and d by parameter name [SI]."""

    observables: Observables
    peak_force: dict[str, Float[Array, ""]]
    sliding_distance: dict[str, Float[Array, ""]]


def sensitivity(
    rig: Rig, velocity: Float[ArrayLike, ""], integrator: Integrator | None = None
) -> Sensitivity:
    """F_p, d and their exact derivatives by forward mode, of one push at `velocity` [m/s].
    Traceable.

    NaN stands where d does not exist. Raises `InputError` for more than one push.
    """
    values = {**parameters.values(rig), VELOCITY: velocity}
    names, numbers = tuple(values), tuple(values.values())
    if any(is_traced(leaf) for leaf in pytrees.list_leaves((rig, velocity))):
        return _trace_sensitivity(rig, names, numbers, integrator)
    for name, x in values.items():
        if np.ndim(x):
            raise InputError(f"sensitivity: {name}: expected one number, got {np.shape(x)}")
    if serves(rig, integrator):
        return _differentiate_column(rig, velocity, names)
    import jax.numpy as jnp

    # One small program, called for each parameter: it compiles and loads in less time.
    at = tuple(jnp.asarray(x, float) for x in numbers)
    directions = [_point_along(at, k) for k in range(len(names))]
    rig, program = pytrees.as_arrays(rig), _differentiate_compiled
    dF, dd, seen = zip(*(program(rig, at, d, integrator) for d in directions), strict=True)
    return Sensitivity(seen[-1], _name(names, dF), _name(names, dd))


def _differentiate_column(
    rig: Rig, velocity: Float[ArrayLike, ""], names: tuple[str, ...]
) -> Sensitivity:
    """The sensitivity of one push, by NumPy."""
    seen, by = differentiate_columns(rig, velocity, names)
    one = pytrees.map_tree(lambda column: column[0], seen)
    dF, dd = by.peak_force[:, 0], by.sliding_distance[:, 0]
    return Sensitivity(one, _name(names, dF), _name(names, dd))


def _trace_sensitivity(
    rig: Rig, names: tuple[str, ...], numbers: Numbers, integrator: Integrator | None
) -> Sensitivity:
    """The sensitivity of one push, while JAX traces it."""
    import jax
    import jax.numpy as jnp

    at = tuple(jnp.asarray(x, float) for x in numbers)
    directions = [_point_along(at, k) for k in range(len(names))]
    stacked = jax.tree.map(lambda *d: jnp.stack(d), *directions)
    follow = jax.vmap(lambda d: _differentiate(rig, at, d, integrator))
    dF, dd, seen = follow(stacked)
    seen = jax.tree.map(lambda leaf: leaf[0], seen)
    return Sensitivity(seen, _name(names, dF), _name(names, dd))


def _point_along(at: Numbers, k: int) -> Numbers:
    """The direction in which the k-th number alone changes."""
    import jax.numpy as jnp

    return tuple(jnp.ones_like(x) if i == k else jnp.zeros_like(x) for i, x in enumerate(at))


def _name(names: Sequence[str], column: Any) -> dict[str, Array]:
    return {name: column[k] for k, name in enumerate(names)}


def _differentiate(
    rig: Rig, at: Numbers, direction: Numbers, integrator: Integrator | None
) -> tuple[Array, Array, Observables]:
    """Derivatives of F_p and d along a direction of the numbers, and the observables, of the push
    of a rig with the numbers `at` in place of its own."""
    import jax
    import jax.numpy as jnp

    put = parameters.setter(rig, parameters.names(rig))

    def measure(at):
        *numbers, velocity = at
        seen = observe(put(*numbers), velocity, integrator)
        return (seen.peak_force, seen.sliding_distance), seen

    _, (dF, dd), seen = jax.jvp(measure, (at,), (direction,), has_aux=True)
    return dF, jnp.where(jnp.isnan(seen.sliding_distance), jnp.nan, dd), seen


_differentiate_compiled = cache_program(_differentiate)


class Margin(NamedTuple):
    """The relative change of mu_s to the nearest regime change, and the side on which
    derivatives hold: `both`, or `left`/`right` (smaller/larger mu_s) within 1e-3 of it."""

    margin: float
    side: str


def regime_margin(
    rig: Rig, velocity: Float[ArrayLike, ""], integrator: Integrator | None = None
) -> Margin:
    """Distance to the nearest mu_s at which the push at `velocity` [m/s] goes another way.

    Counted are the regime, whether the part sticks first, the number of contacts and of
    sticks, and the contact in which the peak falls: wherever a derivative may jump. Found by
    a scan over mu_s (factor 0.001 to 10, 48 points a side) refined to 1e-7; a window of
    another regime narrower than the scan's step (a factor 1.4 of the distance) is missed.
    Infinite where the scan finds no change.
    """
    mu_s = float(parameters.values(rig)["mu_s"])
    kinds = _kinds_by_mu_s(rig, velocity, integrator)
    here = int(kinds(np.array([mu_s]))[0])
    steps = [np.geomspace(_NEAREST, furthest, _POINTS) for furthest in _FURTHEST]
    found = [np.inf, np.inf]
    inside = [0.0, 0.0]
    for _ in range(_ROUNDS):
        deltas = np.concatenate([-steps[0], steps[1]])
        differ = np.split(kinds(mu_s * (1 + deltas)) != here, 2)
        for side in (0, 1):
            if not differ[side].any():
                continue
            first = int(np.argmax(differ[side]))
            inside[side] = steps[side][first - 1] if first else inside[side]
            found[side] = steps[side][first]
            steps[side] = np.linspace(inside[side], found[side], _POINTS + 1)[1:]
    margin = min(found)
    side = "both" if margin >= NEAR_EDGE else ("right" if found[0] < found[1] else "left")
    return Margin(margin, side)


def _kinds_by_mu_s(
    rig: Rig, velocity: Float[ArrayLike, ""], integrator: Integrator | None
) -> Callable[[NDArray], Int[NDArray, " n"]]:
    """The function that gives the kind of push at each of some mu_s."""
    if serves(rig, integrator):

        def kinds(mu_s: NDArray) -> NDArray:
            at = parameters.with_values(rig, {"mu_s": mu_s})
            return np.asarray(observe_columns(at, velocity).kind)

        return kinds
    import jax.numpy as jnp

    # By the program that gives the derivatives: a second one would take seconds to compile.
    names = parameters.names(rig)
    values = {**parameters.values(rig), VELOCITY: velocity}
    at = tuple(jnp.asarray(x, float) for x in values.values())
    rig, place, program = pytrees.as_arrays(rig), names.index("mu_s"), _differentiate_compiled
    nowhere = tuple(jnp.zeros_like(x) for x in at)

    def kind(mu_s: float) -> int:
        there = (*at[:place], jnp.asarray(mu_s), *at[place + 1 :])
        return int(program(rig, there, nowhere, integrator)[2].kind)

    return lambda mu_s: np.array([kind(value) for value in mu_s])
