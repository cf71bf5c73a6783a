"""Exact derivatives of F_p and d in every parameter, and how far the next regime is."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from difffric.compute import pytrees
from difffric.compute.program_cache import kept
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.observables import Observables, observe

VELOCITY = "velocity_m_per_s"
NEAR_EDGE = 1e-3
"""A margin below this makes derivatives one-sided in the answer."""


class Sensitivity(NamedTuple):
    """Observables of one push and the derivatives of F_p and d by parameter name [SI]."""

    observables: Observables
    peak_force: dict[str, jax.Array]
    sliding_distance: dict[str, jax.Array]


def sensitivity(rig: Rig, velocity, integrator=None) -> Sensitivity:
    """F_p, d and their exact derivatives by forward mode. Traceable.

    NaN stands where d does not exist.
    """
    point = _point(rig, velocity)
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((rig, velocity))):
        directions = {name: _along(point, name) for name in point}
        stacked = jax.tree.map(lambda *d: jnp.stack(d), *directions.values())
        follow = jax.vmap(lambda d: _directional(rig, point, d, integrator))
        dF, dd, seen = follow(stacked)
        seen = jax.tree.map(lambda leaf: leaf[0], seen)
        columns = {name: (dF[i], dd[i]) for i, name in enumerate(point)}
    else:  # one small program, called for each parameter: it compiles and loads in less time
        rig = pytrees.as_arrays(rig)
        found = {n: _directional_jit(rig, point, _along(point, n), integrator) for n in point}
        seen = found[VELOCITY][2]
        columns = {name: answer[:2] for name, answer in found.items()}
    return Sensitivity(
        seen, {n: c[0] for n, c in columns.items()}, {n: c[1] for n, c in columns.items()}
    )


def _point(rig, velocity):
    point = {**parameters.values(rig), VELOCITY: velocity}
    return {name: jnp.asarray(value, float) for name, value in point.items()}


def _along(point, name):
    return {n: jnp.ones_like(x) if n == name else jnp.zeros_like(x) for n, x in point.items()}


def _directional(rig, point, direction, integrator):
    """Derivatives of F_p and d along a direction of parameters, and the observables."""

    def measured(point):
        rest = {name: value for name, value in point.items() if name != VELOCITY}
        seen = observe(parameters.with_values(rig, rest), point[VELOCITY], integrator)
        return (seen.peak_force, seen.sliding_distance), seen

    _, (dF, dd), seen = jax.jvp(measured, (point,), (direction,), has_aux=True)
    return dF, jnp.where(jnp.isnan(seen.sliding_distance), jnp.nan, dd), seen


_directional_jit = kept(_directional)


class Margin(NamedTuple):
    """The relative change of mu_s to the nearest regime change, and the side on which
    derivatives hold: `both`, or `left`/`right` (smaller/larger mu_s) within 1e-3 of it."""

    margin: float
    side: str


def regime_margin(rig: Rig, velocity, integrator=None) -> Margin:
    """Distance to the nearest mu_s at which the push goes another way.

    Counted are the regime, whether the part sticks first, the number of contacts and of
    sticks, and the contact in which the peak falls: wherever a derivative may jump. Found by
    a scan over mu_s (factor 0.001 to 10, 48 points a side) refined to 1e-7; a window of
    another regime narrower than the scan's step (a factor 1.4 of the distance) is missed.
    Infinite where the scan finds no change.
    """
    rig, point = pytrees.as_arrays(rig), _point(rig, velocity)
    mu_s = float(point["mu_s"])
    here = int(_kinds(rig, point, integrator, np.array([mu_s]))[0])
    steps = [np.geomspace(1e-8, top, 48) for top in (0.999, 9.0)]
    found = [np.inf, np.inf]
    inside = [0.0, 0.0]
    for _ in range(5):
        deltas = np.concatenate([-steps[0], steps[1]])
        differ = np.split(_kinds(rig, point, integrator, mu_s * (1 + deltas)) != here, 2)
        for side in (0, 1):
            if not differ[side].any():
                continue
            first = int(np.argmax(differ[side]))
            inside[side] = steps[side][first - 1] if first else inside[side]
            found[side] = steps[side][first]
            steps[side] = np.linspace(inside[side], found[side], 49)[1:]
    margin = min(found)
    side = "both" if margin >= NEAR_EDGE else ("right" if found[0] < found[1] else "left")
    return Margin(margin, side)


def _kinds(rig, point, integrator, mu_s):
    """The kind of push at each mu_s, by the program that gives the derivatives."""
    nowhere = {name: jnp.zeros_like(x) for name, x in point.items()}
    at = [jnp.asarray(value) for value in mu_s]
    kinds = [
        _directional_jit(rig, {**point, "mu_s": value}, nowhere, integrator)[2].kind for value in at
    ]
    return np.array([int(kind) for kind in kinds])
