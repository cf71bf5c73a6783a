"""Many pushes at once, on all cores: F_p, d and their exact derivatives as NumPy arrays.

One compiled program takes the pushes in tiles that stay in the first-level cache. Each of as many
threads as there are cores calls it with a share of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache, lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int8
from numpy.typing import NDArray

from difffric.compute.precision import require_float64
from difffric.compute.program_cache import has_own_classes
from difffric.compute.programs.store import keep_known_options, load_or_compile
from difffric.compute.xla_options import in_one_piece
from difffric.cores import count_cores
from difffric.errors import InputError
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.closed_form import ClosedForm
from difffric.simulation.observables import observe
from difffric.simulation.segments import Integrator
from difffric.simulation.sensitivities import VELOCITY

_TILE = 128
"""Pushes at a time: their some hundred intermediate arrays fill the first-level cache."""
_TILES = (8, 64)
"""A program takes so many tiles at most; the small one is called in less time."""
_WAKING = 1024
"""Pushes that the calling thread follows while another one wakes: its share is larger by them."""
_OPTIONS: dict[str, Any] = {"xla_cpu_prefer_vector_width": 512}
"""XLA takes 256 bits unless told otherwise; wider than the processor's does no harm."""


def observe_batch(
    rigs: Rig,
    velocity: Float[ArrayLike, "*n"],
    *,
    derivatives: Sequence[str] = ("mu_s",),
    integrator: Integrator | None = None,
    threads: int | None = None,
) -> Batch:
    """F_p and d of n pushes, and their exact derivatives by the parameters named in
    `derivatives`: those of `parameters.names`, or `velocity_m_per_s`.

    `velocity` [m/s] and every number of the rig are one value or n. `threads`: as many as there
    are cores, unless given. A program is compiled for each kind of rig and set of names, one for
    up to 1024 pushes and one for more. Not traceable: within `jax.jit`, vmap `observe`.

    Raises `InputError` for lengths that differ, an unknown name, and a velocity that is not > 0.
    """
    require_float64()
    if integrator is not None:
        integrator.check(rigs)
    leaves, structure = jax.tree.flatten((rigs, integrator))
    numbers = [np.asarray(leaf, float) for leaf in leaves]
    speeds = np.asarray(velocity, float)
    n = max(a.size for a in (*numbers, speeds))
    if any(a.ndim > 1 or a.size not in (1, n) for a in (*numbers, speeds)):
        shapes = sorted({a.shape for a in (*numbers, speeds)})
        raise InputError(
            f"observe_batch: expected one value or n for each number of the rig and for the "
            f"velocity, got arrays of the shapes {shapes}"
        )
    if not (speeds > 0).all():
        raise InputError("velocity: expected numbers > 0")
    varying = tuple(i for i, a in enumerate(numbers) if a.size > 1)
    fixed = np.array([a.item() for a in numbers if a.size == 1])
    rows = [speeds, *(numbers[i] for i in varying)]
    tiles = _TILES[n > _TILE * _TILES[0]]
    program = _compile_batch(structure, varying, tuple(derivatives), tiles)
    columns = _BatchWork(program, fixed, rows, n).run(threads or count_cores())
    seen, by = columns[:4], iter(columns[4:])
    dF, dd = ({name: next(by) for name in derivatives} for _ in range(2))
    return Batch._make([*seen, dF, dd])


class Batch(NamedTuple):
    """What was asked of n pushes: (n,) NumPy arrays in SI units."""

    peak_force: Float[NDArray, " n"]
    """F_p [N]"""
    sliding_distance: Float[NDArray, " n"]
    """d [m]; NaN where `reason` is not 0"""
    reason: Int8[NDArray, " n"]
    """why there is no d, a code of `events.Reason`"""
    regime: Int8[NDArray, " n"]
    """a code of `events.Regime`"""
    peak_force_by: dict[str, NDArray]
    """its derivatives, by the parameter's name"""
    sliding_distance_by: dict[str, NDArray]


class _BatchProgram(NamedTuple):
    """A compiled function of (how many pushes, the numbers that all share, an array of those
    that differ, a row each), which gives an array for each of `types`."""

    call: Any
    types: tuple[np.dtype, ...]
    room: int


class _BatchWork:
    """n pushes, to be done in parts that the program has room for."""

    def __init__(self, program: _BatchProgram, fixed: NDArray, rows: list[NDArray], n: int):
        self.program, self.fixed, self.rows, self.n = program, fixed, rows, n
        self.columns = [np.empty(n, kind) for kind in program.types]

    def run(self, threads: int) -> list[Any]:
        """All of it, by so many threads at most."""
        threads = max(1, min(threads, self.n // (2 * _WAKING)))
        share = (self.n - _WAKING) // threads if threads > 1 else 0
        own = self.n - share * (threads - 1)
        starts = range(own, self.n, max(share, 1))
        others = [_share_pool().submit(self._run_part, start, start + share) for start in starts]
        self._run_part(0, own)
        for other in others:
            other.result()
        return self.columns

    def _run_part(self, first: int, last: int) -> None:
        call, _, room = self.program
        size = -(-(last - first) // -(-(last - first) // room))  # equal parts that fit
        block = np.empty((len(self.rows), room))
        for start in range(first, last, size):
            stop = min(start + size, last)
            length = stop - start
            for line, row in zip(block, self.rows, strict=True):
                line[:length] = row[start:stop] if row.size > 1 else row
                line[length : length + _TILE] = line[0]  # a tile is done whole
            found = call([np.asarray(length), self.fixed, block.reshape(len(block), -1, _TILE)])
            for column, part in zip(self.columns, found, strict=True):
                column[start:stop] = np.asarray(part).ravel()[:length]


@lru_cache(maxsize=64)
def _compile_batch(
    structure: Any, varying: tuple[int, ...], names: tuple[str, ...], tiles: int
) -> _BatchProgram:
    """The program for rigs of this structure whose `varying` leaves differ from push to push, with
    derivatives by these names, for so many tiles at most."""
    rig, integrator = jax.tree.unflatten(structure, range(structure.num_leaves))
    _check_names(rig, names)
    fixed = [i for i in range(structure.num_leaves) if i not in varying]

    def push(shared, own):
        leaves = dict(zip(fixed, shared, strict=True)) | dict(zip(varying, own[1:], strict=True))
        rig, integrator = jax.tree.unflatten(structure, [leaves[i] for i in sorted(leaves)])
        return _differentiate_push(rig, own[0], names, integrator)

    def tile(shared, block):
        return jax.vmap(push, (None, 0))(list(shared), list(block))

    shapes = jax.eval_shape(tile, np.empty(len(fixed)), np.empty((1 + len(varying), _TILE)))

    def all_tiles(length, shared, block):
        def step(i, columns):
            parts = tile(shared, jax.lax.dynamic_index_in_dim(block, i, 1, keepdims=False))
            return [
                jax.lax.dynamic_update_index_in_dim(column, part, i, 0)
                for column, part in zip(columns, parts, strict=True)
            ]

        empty = [jnp.zeros((tiles, _TILE), shape.dtype) for shape in shapes]
        return jax.lax.fori_loop(0, (length + _TILE - 1) // _TILE, step, empty)

    whole = in_one_piece(all_tiles) if _may_be_one_piece(rig, integrator) else all_tiles
    example = [np.asarray(0), np.empty(len(fixed)), np.empty((1 + len(varying), tiles, _TILE))]
    call = None
    if has_own_classes((rig, integrator)):
        key = ("observe_batch", str(structure), varying, names, tiles)
        call = load_or_compile(key, lambda given: whole(*given), example, _OPTIONS)
    if call is None:
        options = keep_known_options(_OPTIONS)
        every = jax.jit(lambda given: whole(*given), compiler_options=options)
        call = every.lower(example).compile()
    return _BatchProgram(call, tuple(np.dtype(s.dtype) for s in shapes), tiles * _TILE)


def _check_names(rig: Rig, names: Sequence[str]) -> None:
    """Raise `InputError` for a name by which the rig has no derivative."""
    known = (*parameters.names(rig), VELOCITY)
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise InputError(f"no such parameter: {', '.join(unknown)}; known: {', '.join(known)}")


def _differentiate_push(
    rig: Rig, velocity: Array, names: Sequence[str], integrator: Integrator | None
) -> tuple[Array, ...]:
    """F_p, d, reason and regime of one push, then F_p's derivatives by these names and d's."""
    every = {**parameters.values(rig), VELOCITY: velocity}
    point = {name: every[name] for name in names}

    def measure(point):
        new = {name: value for name, value in point.items() if name != VELOCITY}
        speed = point.get(VELOCITY, velocity)
        seen = observe(parameters.with_values(rig, new), speed, integrator)
        return (seen.peak_force, seen.sliding_distance), seen

    along = [{n: jnp.full_like(x, n == name) for n, x in point.items()} for name in names]
    if rig.pusher.stroke is None:
        _, slopes, seen = jax.linearize(measure, point, has_aux=True)
        by = [slopes(direction) for direction in along]
    else:  # a loop over cycles, which `linearize` would run once more for each direction
        found = [jax.jvp(measure, (point,), (d,), has_aux=True)[1:] for d in along]
        by = [slope for slope, _ in found]
        seen = found[0][1] if found else measure(point)[1]
    exists = ~jnp.isnan(seen.sliding_distance)
    codes = (code.astype(jnp.int8) for code in (seen.reason, seen.regime))
    dF, dd = [dF for dF, _ in by], [jnp.where(exists, dd, jnp.nan) for _, dd in by]
    return (seen.peak_force, seen.sliding_distance, *codes, *dF, *dd)


def _may_be_one_piece(rig, integrator) -> bool:
    """Whether the whole program may be compiled in one piece: a closed form of this library's own
    laws alone, as a user's may need what such a program must not have."""
    closed = integrator is None or isinstance(integrator, ClosedForm)
    return rig.affine and closed and rig.only_own_laws


@cache
def _share_pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count_cores(), "difffric")
