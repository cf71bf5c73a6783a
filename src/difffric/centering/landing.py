"""Where a push leaves the part, and the stroke that leaves it at a given place."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike, NDArray

from difffric.compute.event_root import find_falling_root
from difffric.compute.xla_options import compile_soon
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.observables import Observables, observe
from difffric.simulation.segments import Integrator

_NEAR = 1e-9
"""[m] from the target, within which a stroke is taken for found"""
PARTS = 64
"""Pushes that a program takes: always so many, so that few programs are compiled."""


class Landing(NamedTuple):
    """Where pushes leave the part, (n,) each."""

    displacement: NDArray
    """from start to rest [m]; NaN where the push has no end that can be followed"""
    duration: NDArray
    """until tip and part stand [s]"""
    peak_force: NDArray
    """[N]"""
    sliding_distance: NDArray
    """[m]; NaN where the part rests in contact"""


class Stroke(NamedTuple):
    """Strokes that leave the part at a target, (n,) each."""

    stroke: NDArray
    """[m]; NaN where none up to the longest does"""
    duration: NDArray
    """of the push [s]"""
    by_stroke: NDArray
    """d displacement / d stroke"""
    by: dict[str, NDArray]
    """d displacement / d parameter [m per SI unit], the stroke held"""


def find_landings(
    rig: Rig,
    velocity: ArrayLike,
    stroke: ArrayLike,
    mu_s: ArrayLike,
    integrator: Integrator | None = None,
) -> Landing:
    """Follow n pushes of one rig and return where they leave the part.

    Speeds [m/s], strokes [m] and mu_s are one value or n each.
    """
    columns = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(x, float)) for x in (velocity, stroke, mu_s))
    )
    numbers = _to_numbers(rig)
    landings = _run_in_parts(lambda v, s, mu: _land_block(numbers, v, s, mu, integrator), columns)
    return Landing(*landings)


def find_strokes(
    rig: Rig,
    velocity: ArrayLike,
    target: ArrayLike,
    mu_s: ArrayLike,
    longest: ArrayLike,
    *,
    by: tuple[str, ...] = ("mu_s",),
    integrator: Integrator | None = None,
) -> Stroke:
    """Find the strokes [m], up to `longest`, that leave the part at `target` [m] from its start.

    The displacement grows with the stroke, if not everywhere strictly; the root is found by
    Newton's method on exact derivatives, in a bracket. Speeds [m/s], targets, mu_s and the
    longest strokes are one value or n each; `by` names what derivatives are wanted for.
    """
    columns = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(x, float)) for x in (velocity, target, mu_s, longest))
    )
    numbers = _to_numbers(rig)
    stroke, duration, slope, *rest = _run_in_parts(
        lambda v, x, mu, most: _aim_block(numbers, v, x, mu, most, by, integrator), columns
    )
    return Stroke(stroke, duration, slope, dict(zip(by, rest, strict=True)))


def _to_numbers(rig: Rig) -> Rig:
    """Return the rig with a stroke, each of its numbers as a NumPy array ()."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, float), parameters.with_stroke(rig, 1.0))


def _run_in_parts(program: Callable, columns: Sequence[NDArray]) -> list[NDArray]:
    """Apply a program that takes columns of `PARTS` rows to columns of any length (n,)."""
    n = len(columns[0])
    found = []
    for first in range(0, n, PARTS):
        at = np.minimum(np.arange(first, first + PARTS), n - 1)
        found.append(np.stack(program(*(column[at] for column in columns))))
    return list(np.concatenate(found, axis=1)[:, :n])


def _observe_push(
    rig: Rig,
    velocity: Float[Array, ""],
    stroke: Float[Array, ""],
    changed: Mapping[str, Float[Array, ""]],
    integrator: Integrator | None,
) -> Observables:
    """Follow one push with another stroke [m] and some parameters changed."""
    rig = parameters.with_stroke(parameters.with_values(rig, changed), stroke)
    return observe(rig, velocity, integrator)


@compile_soon
def _land_block(
    rig: Rig,
    velocity: Float[Array, " parts"],
    stroke: Float[Array, " parts"],
    mu_s: Float[Array, " parts"],
    integrator: Integrator | None,
) -> tuple[Float[Array, " parts"], ...]:
    """The fields of `Landing`, for a part of the pushes."""

    def land_one(velocity, stroke, mu_s):
        seen = _observe_push(rig, velocity, stroke, {"mu_s": mu_s}, integrator)
        return seen.displacement, seen.duration, seen.peak_force, seen.sliding_distance

    return jax.vmap(land_one)(velocity, stroke, mu_s)


@compile_soon
def _aim_block(
    rig: Rig,
    velocity: Float[Array, " parts"],
    target: Float[Array, " parts"],
    mu_s: Float[Array, " parts"],
    longest: Float[Array, " parts"],
    by: tuple[str, ...],
    integrator: Integrator | None,
) -> tuple[Float[Array, " parts"], ...]:
    """Stroke, duration and the slopes of `Stroke`, for a part of the targets."""
    values = parameters.values(rig)

    def aim_one(velocity, target, mu_s, longest):
        def land(stroke, changed):
            seen = _observe_push(rig, velocity, stroke, {"mu_s": mu_s} | changed, integrator)
            return seen.displacement, seen.duration

        def short_of(stroke, _):
            (x, _), (slope, _) = jax.jvp(lambda s: land(s, {}), (stroke,), (jnp.ones_like(stroke),))
            return target - x, -slope

        stroke = find_falling_root(short_of, None, jnp.zeros_like(longest), longest, target)
        here = jnp.stack([stroke, *(mu_s if n == "mu_s" else values[n] for n in by)])

        def land_at(point):
            return land(point[0], dict(zip(by, point[1:], strict=True)))

        def move_along(direction):
            return jax.jvp(land_at, (here,), (direction,))

        (x, time), (slopes, _) = jax.vmap(move_along)(jnp.eye(1 + len(by)))
        found = jnp.abs(x[0] - target) <= _NEAR
        return tuple(jnp.where(found, a, jnp.nan) for a in (stroke, time[0], *slopes))

    return jax.vmap(aim_one)(velocity, target, mu_s, longest)
