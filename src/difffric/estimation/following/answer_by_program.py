"""The answers for recorded pushes, tables and free slides by one compiled program for every effect.

Coordinates are the plain parameters and all the effects' numbers; the program answers for many
pairs of a push and its coordinates at once. Axes: B pairs, K coordinates, D directions.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from difffric.compute.xla_options import compile_quickly, compile_soon, in_one_piece
from difffric.estimation.block_means import UnevenBlocks
from difffric.estimation.effect_coordinates import Coordinates
from difffric.estimation.following.push_answer import AnswerRows
from difffric.estimation.stacked_data import RECORDINGS, SLIDES, TABLE
from difffric.rig.rig import Rig
from difffric.simulation.observables import observe, observe_steps
from difffric.simulation.stepping.integrator import RungeKutta
from difffric.simulation.stepping.path import PushPath, follow_together

CHUNK = 128
"""Instants that are read at once: what they need stays in a core's own memory."""
TOLERANCE = 1e-7
"""The integrator's tolerance of a step: far below what measured pushes let see."""

Array = Any  # NumPy's outside a compiled program, JAX's within


class StackedPushes(NamedTuple):
    """What each of n pushes says of itself, and its samples; every array has an axis of pushes in
    front."""

    velocity: Array
    """[m/s]; of a free slide, that at its release"""
    mass: Array
    """[kg]"""
    stroke: Array
    """[m], or the tips' recorded motions"""
    share: Array
    """of friction's drift: 0 at the first push, 1 at the last"""
    rest: Array
    """time at rest before the push [s]"""
    data: Any
    """(force, position), both `UnevenBlocks`; or, of a table, (measured (n, 2), 1 / standard error
    (n, 2))"""
    until: Array
    """time [s] after which nothing is asked of a recorded push"""


def build_push_rig(coordinates: Coordinates, rig: Rig, push: StackedPushes, c: Array) -> Rig:
    """The rig of one push at coordinates c (K,), with what the push's record says; traceable."""
    known = {name.partition(".")[0] for name in coordinates.names}
    given = {"mass_kg": push.mass}
    for name, said in (("friction_drift.share", push.share), ("static_dwell.rest", push.rest)):
        if name.partition(".")[0] in known:
            given[name] = said
    return coordinates.rig(rig, c, given, push.stroke)


def _average(blocks: UnevenBlocks, at_instants: Array) -> Array:
    """The model's means over m blocks (m,) from its values at e instants (e,)."""
    return 0.5 * (at_instants[blocks.first] + at_instants[blocks.second])


def _whiten(blocks: UnevenBlocks, r: Array) -> Array:
    """Residuals (m, ...) made independent, of unit variance."""
    before = jnp.concatenate([jnp.zeros_like(r[:1]), r[:-1]])
    return (blocks.a * r.T - blocks.b * before.T).T


def _answer_recordings(
    coordinates: Coordinates,
    rig: Rig,
    pushes: StackedPushes,
    c: Array,
    directions: Array,
    steps: int,
) -> AnswerRows:
    """The answers for B recorded pushes at coordinates c (B, K), along directions (B, D, K)."""
    force, position = pushes.data
    build = partial(RungeKutta(TOLERANCE).build_loop, blind=True)

    def read(c: Array) -> Any:
        rigs = jax.vmap(lambda push, c: build_push_rig(coordinates, rig, push, c))(pushes, c)
        v = jax.vmap(lambda rig, v: rig.pusher.speed(v))(rigs, pushes.velocity)
        paths = follow_together(build, rigs, v, steps, pushes.until)
        f, x = _read_in_chunks(paths, force, position)
        # What could not be followed to its end is no number, and no fit goes there.
        known = jnp.where(paths.end.lost_track, jnp.nan, 1.0)[:, None]
        f, x = known * f, known * x
        seen = jax.vmap(lambda *at, m: observe_steps(build(*at), m))(rigs, v, m=paths.end)
        peak = jax.vmap(PushPath.find_read_peak)(paths, force.t, f, seen.peak_force)
        slid = seen.sliding_distance
        if rigs.probe.looked_up:
            slid = slid + jax.vmap(PushPath.measure_late_distance)(paths)
        model = jnp.stack([peak, slid], axis=1)
        means = jax.vmap(_average)
        return (means(force, f), means(position, x)), model

    ((f, x), model), (by, _) = _differentiate(read, c, directions)

    def compare(blocks: UnevenBlocks, model: Array, by: Array, centred: bool) -> Any:
        A = _whiten(blocks, jnp.column_stack([-by.T, blocks.y - model]))
        if centred:  # the position's zero is arbitrary
            one = _whiten(blocks, jnp.ones_like(blocks.y))
            norm = jnp.sum(one**2)
            A = A - one[:, None] * ((one @ A) / jnp.where(norm > 0, norm, 1.0))
        if blocks.doubt is not None:
            A = A - blocks.doubt @ (blocks.doubt.T @ A)
        return A

    by_f, by_x = (jnp.moveaxis(a, 0, 1) for a in by)
    of_force = jax.vmap(partial(compare, centred=False))(force, f, by_f)
    of_position = jax.vmap(partial(compare, centred=True))(position, x, by_x)
    return AnswerRows(jnp.stack([of_force, of_position], 1), model)


def _answer_table(
    coordinates: Coordinates,
    rig: Rig,
    pushes: StackedPushes,
    c: Array,
    directions: Array,
    steps: int,
) -> AnswerRows:
    """The answers for B pushes of a table, which has F_p and d."""
    integrator: Any = RungeKutta(TOLERANCE, most=steps)

    def observe_all(c: Array) -> Array:
        def one(push: StackedPushes, c: Array) -> Array:
            at = build_push_rig(coordinates, rig, push, c)
            seen = observe(at, push.velocity, integrator)
            return jnp.stack([seen.peak_force, seen.sliding_distance])

        return jax.vmap(one)(pushes._replace(data=None), c)

    return _compare_numbers(pushes, *_differentiate(observe_all, c, directions))


def _compare_numbers(pushes: StackedPushes, model: Array, by: Array) -> AnswerRows:
    """The answers from the model's numbers (B, 2) and their derivatives (D, B, 2)."""
    measured, weight = pushes.data
    # Where the part never leaves the tip it slides no distance: d counts as 0.
    r = weight * (measured - jnp.where(jnp.isnan(model), 0.0, model))
    J = -weight * jnp.where(jnp.isnan(by), 0.0, by)
    A = jnp.concatenate([jnp.moveaxis(J, 0, 2), r[:, :, None]], axis=2)
    return AnswerRows(A[:, :, None, :], model)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)
"""Gauss-Legendre's rule for a free slide's distance: what it integrates is smooth in s."""


def _answer_slides(
    coordinates: Coordinates,
    rig: Rig,
    pushes: StackedPushes,
    c: Array,
    directions: Array,
    steps: int,
) -> AnswerRows:
    """The answers for B free slides, of which the distance was measured."""

    def slide(push: StackedPushes, c: Array) -> Array:
        at = build_push_rig(coordinates, rig, push, c)
        # d = integral of u du / (F(u) / m) from 0 to v, in s with u = v s^2: fine at low speed.
        s = jnp.asarray(0.5 * (_NODES + 1))
        u = push.velocity * s**2
        slowing = -jax.vmap(at.free)(u)
        d = jnp.sum(0.5 * jnp.asarray(_WEIGHTS) * 2 * push.velocity * s * u / slowing)
        return jnp.stack([0.0 * d, d])

    def slide_all(c: Array) -> Array:
        return jax.vmap(slide)(pushes._replace(data=None), c)

    return _compare_numbers(pushes, *_differentiate(slide_all, c, directions))


def _differentiate(function: Callable[[Array], Any], c: Array, directions: Array) -> Any:
    """A function of coordinates c (B, K): its value, and its derivatives along directions
    (B, D, K), with an axis of D in front."""
    if not directions.shape[1]:
        value = function(c)
        return value, jax.tree.map(lambda x: jnp.zeros((0, *x.shape)), value)
    along = jax.vmap(lambda v: jax.jvp(function, (c,), (v,)), in_axes=1, out_axes=(None, 0))
    return along(directions)


def _read_in_chunks(paths: Any, force: UnevenBlocks, position: UnevenBlocks) -> Any:
    """What the sensors read of B pushes, force [N] and position [m], at the instants of their
    blocks: (B, e) each. Instants that no block asks for, at the end, are not read."""
    last = jnp.maximum(jnp.max(force.second), jnp.max(position.second))

    def turn(carry: Any) -> Any:
        lo, *found = carry
        t = [jax.lax.dynamic_slice_in_dim(b.t, lo, CHUNK, 1) for b in (force, position)]
        new = in_one_piece(jax.vmap(lambda path, *t: path.read(*t)))(paths, *t)
        put = jax.lax.dynamic_update_slice_in_dim
        return lo + CHUNK, *(put(a, b, lo, 1) for a, b in zip(found, new, strict=True))

    blank = jnp.zeros(force.t.shape), jnp.zeros(position.t.shape)
    return jax.lax.while_loop(lambda carry: carry[0] <= last, turn, (0, *blank))[1:]


def _answer_any(
    coordinates: tuple,
    kind: str,
    steps: int,
    rig: Rig,
    pushes: StackedPushes,
    c: Array,
    directions: Array,
) -> AnswerRows:
    """The answers for B pushes of one kind; `coordinates` are the fields of `Coordinates`."""
    own = {RECORDINGS: _answer_recordings, TABLE: _answer_table, SLIDES: _answer_slides}[kind]
    return own(Coordinates(*coordinates), rig, pushes, c, directions, steps)


answer = compile_soon(_answer_any)
answer_seldom = compile_quickly(_answer_any)
"""The same with derivatives for a rig with free forms, whose program is four times as large and is
asked some dozen times: it was compiled for a minute to run for a second."""
