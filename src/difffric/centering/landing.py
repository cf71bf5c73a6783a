"""Where a push leaves the part, and the stroke that leaves it at a given place."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from difffric.compute.event_root import falling_root
from difffric.compute.xla_options import soon_compiled
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.observables import observe

_NEAR = 1e-9
"""[m] from the target, within which a stroke is taken for found"""
PARTS = 64
"""Pushes in a program of their own: always so many, so that few programs are compiled."""


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


def pushed(rig: Rig, velocity, stroke, mu_s, integrator=None) -> Landing:
    """n pushes of one rig: speeds [m/s], strokes [m], mu_s, each one value or n."""
    columns = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(x, float)) for x in (velocity, stroke, mu_s))
    )
    numbers = _numbers(rig)
    return Landing(*_in_parts(lambda *own: _pushed(numbers, *own, integrator), columns))


def stroke_to(
    rig: Rig, velocity, target, mu_s, longest, *, by: tuple[str, ...] = ("mu_s",), integrator=None
) -> Stroke:
    """The strokes [m], up to `longest`, that leave the part at `target` [m] from its start.

    The displacement grows with the stroke, if not everywhere strictly; the root is found by
    Newton's method on exact derivatives, in a bracket. Speeds [m/s], targets, mu_s and the
    longest strokes are one value or n; `by` names what derivatives are wanted for.
    """
    columns = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(x, float)) for x in (velocity, target, mu_s, longest))
    )
    numbers = _numbers(rig)
    stroke, duration, slope, *rest = _in_parts(
        lambda *own: _solved(numbers, *own, by, integrator), columns
    )
    return Stroke(stroke, duration, slope, dict(zip(by, rest, strict=True)))


def _numbers(rig: Rig) -> Rig:
    """The rig with a stroke, each number a NumPy array ()."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, float), parameters.with_stroke(rig, 1.0))


def _in_parts(program, columns) -> list[NDArray]:
    """A program of PARTS rows, applied to any number of them."""
    n = len(columns[0])
    found = []
    for first in range(0, n, PARTS):
        at = np.minimum(np.arange(first, first + PARTS), n - 1)
        found.append(np.stack(program(*(column[at] for column in columns))))
    return list(np.concatenate(found, axis=1)[:, :n])


def _displaced(rig: Rig, velocity, stroke, changed, integrator):
    rig = parameters.with_stroke(parameters.with_values(rig, changed), stroke)
    return observe(rig, velocity, integrator)


@soon_compiled
def _pushed(rig, velocity, stroke, mu_s, integrator):
    def one(velocity, stroke, mu_s):
        seen = _displaced(rig, velocity, stroke, {"mu_s": mu_s}, integrator)
        return seen.displacement, seen.duration, seen.peak_force, seen.sliding_distance

    return jax.vmap(one)(velocity, stroke, mu_s)


@soon_compiled
def _solved(rig, velocity, target, mu_s, longest, by, integrator):
    values = parameters.values(rig)

    def one(velocity, target, mu_s, longest):
        def lands(stroke, changed):
            seen = _displaced(rig, velocity, stroke, {"mu_s": mu_s} | changed, integrator)
            return seen.displacement, seen.duration

        def short_of(stroke, _):
            (x, _), (slope, _) = jax.jvp(
                lambda s: lands(s, {}), (stroke,), (jnp.ones_like(stroke),)
            )
            return target - x, -slope

        stroke = falling_root(short_of, None, jnp.zeros_like(longest), longest, target)
        here = jnp.stack([stroke, *(mu_s if n == "mu_s" else values[n] for n in by)])

        def moved(point):
            return lands(point[0], dict(zip(by, point[1:], strict=True)))

        def along(direction):
            return jax.jvp(moved, (here,), (direction,))

        (x, time), (slopes, _) = jax.vmap(along)(jnp.eye(1 + len(by)))
        found = jnp.abs(x[0] - target) <= _NEAR
        return tuple(jnp.where(found, a, jnp.nan) for a in (stroke, time[0], *slopes))

    return jax.vmap(one)(velocity, target, mu_s, longest)
