"""The extended model against measured pushes: every effect of the catalogue in one program.

Coordinates are the plain parameters and all the effects' numbers, each effect at its null unless
a candidate says otherwise. The program answers for many pairs of a push and its coordinates at
once, with the Gram matrix of the whitened residuals and of their exact derivatives in a few
directions that are chosen when it is called: a score test, a scan and a refit of any subset run
the same compiled code. Axes: B pairs of a push and its coordinates, K coordinates, D directions.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from difffric.compute import pytrees
from difffric.compute.xla_options import compile_quickly, compile_soon
from difffric.estimation.block_means import UnevenBlocks
from difffric.estimation.effect_coordinates import FORMED, Coordinates
from difffric.estimation.following.answer_in_columns import answer_in_columns
from difffric.estimation.following.push_answer import AnswerRows, PushAnswer
from difffric.estimation.following.thread_pool import map_in_threads
from difffric.estimation.stacked_data import RECORDINGS, SLIDES, TABLE
from difffric.rig import catalogue
from difffric.rig.rig import Rig
from difffric.simulation.observables import observe, observe_steps
from difffric.simulation.stepping.integrator import RungeKutta
from difffric.simulation.stepping.path import PushPath, follow_together
from difffric.timings import count_followed

PRESLIDING = "presliding"
BRISTLES = f"{PRESLIDING}.sigma_0_N_per_m"
BATCH = 4
"""Pairs that one call answers for: as many as are computed abreast. All wait for the longest."""
VALUES = 16
"""The same where no derivatives are asked for: fewer take no less time, more no less for each."""
CHUNK = 128
"""Instants that are read at once: what they need stays in a core's own memory."""
STEPS, BENT_STEPS = 1000, 2000
"""Steps of the integrator that a push may take, and with bristles, which swing until they rest."""
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
        model = jnp.stack([peak, seen.sliding_distance], axis=1)
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
        new = jax.vmap(lambda path, *t: path.read(*t))(paths, *t)
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
    answer = {RECORDINGS: _answer_recordings, TABLE: _answer_table, SLIDES: _answer_slides}[kind]
    return answer(Coordinates(*coordinates), rig, pushes, c, directions, steps)


_answer = compile_soon(_answer_any)
_answer_seldom = compile_quickly(_answer_any)
"""The same with derivatives for a rig with free forms, whose program is four times as large and is
asked some dozen times: it was compiled for a minute to run for a second."""


@dataclass(frozen=True)
class ExtendedModel:
    """Measured pushes, and a rig with all effects at their nulls, ready to be compared."""

    coordinates: Coordinates
    rig: Rig
    """with all effects that the coordinates know, but for bristles"""
    pushes: StackedPushes
    kind: str
    """`table`, `slides` or `recordings`"""
    directions: int = 8
    """in which the program differentiates; a call with fewer is padded, one with more asks it
    several times"""
    steps: int = STEPS
    plain: Any = None
    """the rig without any effect"""
    in_columns: bool = False
    """whether a table's pushes are followed by NumPy, which compiles nothing and knows only the
    effects of `list_served`"""

    @property
    def recordings(self) -> bool:
        """Whether whole samples are compared."""
        return self.kind == RECORDINGS

    @cached_property
    def _rig(self) -> Rig:
        return pytrees.as_arrays(self.rig)

    @cached_property
    def _bent(self) -> ExtendedModel:
        """The model with bristles, which no value makes vanish: a program of its own."""
        rig = catalogue.extended(self.rig, {PRESLIDING: {}})
        return replace(self, rig=rig, steps=BENT_STEPS)

    @cached_property
    def _unbent(self) -> ExtendedModel:
        """The model without bristles."""
        return replace(self, coordinates=self.coordinates.without(PRESLIDING))

    def _pick_rows(self, index: NDArray) -> StackedPushes:
        """Some pushes, by their numbers; the program does not know how many there are."""
        return jax.tree.map(lambda column: np.asarray(column)[index], self.pushes)

    def _make_example(self) -> tuple:
        """Arguments of the program, for their shapes."""
        K = len(self.coordinates.names)
        return (
            self._rig,
            self._pick_rows(np.zeros(self._batch, int)),
            np.zeros((self._batch, K)),
            np.zeros((self._batch, self.directions, K)),
        )

    @cached_property
    def _program(self) -> Callable[..., AnswerRows]:
        """The compiled program for these data."""
        at = self.coordinates
        given = ((at.names, at.null, at.unit), self.kind, self.steps)
        answer = _answer_seldom if self._has_forms and self.directions else _answer
        answer.prepare(*given, *self._make_example())
        return partial(answer, *given)

    @property
    def _has_forms(self) -> bool:
        """Whether free forms are among the coordinates."""
        return not set(FORMED).isdisjoint(self.coordinates.names)

    @property
    def _batch(self) -> int:
        """Pairs that one call answers for."""
        return BATCH if self.directions else VALUES

    @cached_property
    def _valued(self) -> ExtendedModel:
        """The model without derivatives: a program of its own, ten times as fast."""
        return replace(self, directions=0)

    def compile(self) -> None:
        """Make the programs ready; may be left to another thread. Those with bristles are not: few
        searches come to them."""
        with suppress(Exception):  # XLA has failed where two compiled at once; its use asks again
            _ = self._unbent._program
            _ = self._unbent._valued._program

    def answers(
        self, index: NDArray, c: NDArray, directions: NDArray, keep_rows: bool = False
    ) -> PushAnswer:
        """The answers for N pairs: pushes `index` (N,) at coordinates c (N, K), with derivatives
        along directions (N, D, K) or (D, K). NumPy arrays come back, Gram matrices of D + 1
        columns. Without directions, D = 0, it takes a tenth of the time."""
        directions = np.broadcast_to(directions, (len(c), *np.shape(directions)[-2:]))
        if self.in_columns:
            rows = self._pick_rows(index)
            found = answer_in_columns(self.coordinates, self.plain, rows, c, directions)
            count_followed(1, (len(c), len(c)), (directions.size // c.shape[1],) * 2)
            return AnswerRows(*found).compare(keep_rows)
        return self._ask_programs(index, c, directions, keep_rows)

    def _ask_programs(
        self, index: NDArray, c: NDArray, directions: NDArray, keep_rows: bool
    ) -> PushAnswer:
        """`answers` by compiled programs."""
        names = self.coordinates.names
        bent = c[:, names.index(BRISTLES)] > 0 if BRISTLES in names else np.zeros(len(c), bool)
        known = self.coordinates.indices(self._unbent.coordinates.names)
        if not bent.any():
            return self._unbent._answers(index, c[:, known], directions[..., known], keep_rows)
        parts = []
        for model, at, own in ((self._unbent, ~bent, known), (self._bent, bent, slice(None))):
            if at.any():
                asked = index[at], c[at][:, own], directions[at][..., own]
                parts.append(model._answers(*asked, keep_rows))
        back = np.argsort(np.argsort(bent, kind="stable"), kind="stable")
        return jax.tree.map(lambda *a: np.concatenate(a)[back], *parts)

    def _answers(
        self, index: NDArray, c: NDArray, directions: NDArray, keep_rows: bool
    ) -> PushAnswer:
        if not directions.shape[1] and self.directions:
            return self._valued._answers(index, c, directions, keep_rows)
        # A batch goes on for as long as its longest push: alike ones together.
        N, size = len(c), self._batch
        order = np.lexsort((index, np.asarray(self.pushes.velocity)[index]))
        index, c, directions = index[order], c[order], directions[order]
        parts = [slice(lo, min(lo + size, N)) for lo in range(0, N, size)]

        def answer(part: slice) -> PushAnswer:
            fill = np.minimum(np.arange(size), part.stop - part.start - 1)
            at = (self._pick_rows(index[part][fill]), c[part][fill])
            found = self._differentiate(*at, directions[part][fill])
            there = AnswerRows(*(a[: part.stop - part.start] for a in found))
            return there.compare(keep_rows)

        found = map_in_threads(answer, parts)
        D, asked, whole = directions.shape[1], self.directions, len(parts) * size
        calls = max(-(-D // asked), 1) if asked else 1
        count_followed(len(parts) * calls, (N, whole), (N * D, whole * calls * asked))
        back = np.argsort(order)
        return jax.tree.map(lambda *a: np.concatenate(a)[back], *found)

    def _differentiate(self, pushes: StackedPushes, c: NDArray, directions: NDArray) -> AnswerRows:
        """One batch's answers, from as many calls of the program as the directions take."""
        D, most = directions.shape[1], self.directions
        parts = []
        for lo in range(0, max(D, 1), max(most, 1)):
            some = directions[:, lo : lo + most]
            padded = np.zeros((len(c), most, c.shape[1]))
            padded[:, : some.shape[1]] = some
            rows, model = map(np.asarray, self._program(self._rig, pushes, c, padded))
            parts.append(rows[..., : some.shape[1]])
        return AnswerRows(np.concatenate([*parts, rows[..., -1:]], axis=-1), model)
