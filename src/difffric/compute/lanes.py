"""Loops and choices over whole columns of cases, in which each lane goes its own way.

For JAX these are its own loop and a selection, of one case, to be mapped over others. By NumPy all
lanes of a column go together, and what concerns some of them is computed for those alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.compute.arrays import uses_jax, where
from difffric.compute.dual_numbers import Dual, highest, new_level, split
from difffric.compute.pytrees import list_leaves, map_tree, select


def repeat_while(
    goes_on: Callable[..., Any], body: Callable[..., Any], state: Any, *given: Any
) -> Any:
    """`state = body(state, *given)` for as long as `goes_on(state)`, each lane by itself.

    The state is a tree whose leaves have one entry a lane; what is given may be shared.
    """
    if uses_jax(*list_leaves((state, given))):
        import jax

        return jax.lax.while_loop(goes_on, lambda state: body(state, *given), state)
    live = goes_on(state)
    if np.ndim(live) == 0:
        while goes_on(state):
            state = body(state, *given)
        return state
    n, index = len(live), np.flatnonzero(live)
    part, own = pick_lanes((state, given), index)
    while len(index):
        part = body(part, *own)
        live = goes_on(part)
        if live.all():
            continue
        state = put_lanes(state, index, part, n)
        index = index[live]
        part, own = pick_lanes((part, own), np.flatnonzero(live))
    return state


def change_where(condition: Any, change: Callable[..., Any], state: Any, *given: Any) -> Any:
    """`change(state, *given)` where the condition holds, else the state as it is."""
    if uses_jax(condition):
        return select(condition, change(state, *given), state)
    if np.all(condition):
        return change(state, *given)
    index = np.flatnonzero(condition)
    if not len(index):
        return state
    part, own = pick_lanes((state, given), index)
    return put_lanes(state, index, change(part, *own), len(condition))


def choose(condition: Any, new: Callable[[], Any], old: Callable[[], Any]) -> Any:
    """`new()` where the condition holds, else `old()`; by NumPy, one that holds nowhere is not
    computed."""
    if not uses_jax(condition):
        if not np.any(condition):
            return old()
        if np.all(condition):
            return new()
    return where(condition, new(), old())


def pick_lanes(tree: Any, index: NDArray) -> Any:
    """Some lanes of a tree of columns; what all lanes share stays as it is."""
    return map_tree(lambda leaf: _take(leaf, index), tree)


def _take(leaf, index):
    if type(leaf) is Dual:
        return Dual(_take(leaf.value, index), _take(leaf.tangent, index), leaf.level)
    shape = np.shape(leaf)
    return leaf if not shape or shape[-1] == 1 else leaf[..., index]


def put_lanes(tree: Any, index: NDArray, part: Any, n: int) -> Any:
    """A tree of n lanes, some of them replaced by those of `part`."""
    return map_tree(lambda old, new: _put(old, index, new, n), tree, part)


def _put(old, index, new, n):
    level = highest((old, new))
    if level:
        (a, da), (b, db) = split(old, level), split(new, level)
        tangent = _put(0.0 if da is None else da, index, 0.0 if db is None else db, n)
        return Dual(_put(a, index, b, n), tangent, level)
    old, new = np.asarray(old), np.asarray(new)
    directions = max(old.shape[:-1], new.shape[:-1], key=len)
    out = np.empty((*directions, n), np.result_type(old, new))
    out[...] = old
    out[..., index] = new
    return out


def spread(tree: Any, n: int) -> Any:
    """A tree in which every number is a column of n lanes."""

    def widen(leaf):
        if type(leaf) is Dual:
            return Dual(widen(leaf.value), leaf.tangent, leaf.level)
        return np.broadcast_to(leaf, (n,))

    return map_tree(widen, tree)


def join_lanes(parts: Sequence[Any]) -> Any:
    """Trees of columns one behind the other; at least one."""
    return parts[0] if len(parts) == 1 else map_tree(_join, *parts)


def _join(*columns):
    level = highest(columns)
    if not level:
        directions = np.broadcast_shapes(*(np.shape(x)[:-1] for x in columns))
        parts = [np.broadcast_to(x, (*directions, np.shape(x)[-1])) for x in columns]
        return np.concatenate(parts, axis=-1)
    values = [split(column, level)[0] for column in columns]
    return Dual(
        _join(*values),
        _join(*(_tangent(c, v, level) for c, v in zip(columns, values, strict=True))),
        level,
    )


def _tangent(result, value, level):
    """How a result changes, in the shape of its value or with the directions before it."""
    tangent = split(result, level)[1]
    own = np.zeros(()) if tangent is None else np.asarray(tangent)
    return np.broadcast_to(own, np.broadcast_shapes(own.shape, np.shape(value)))


def differentiate(function: Callable[[Any], Any], at: Any, along: Any) -> tuple[Any, Any]:
    """(function(at), its derivative) by NumPy: trees of the columns that the function gives.

    `along` says how each number of the tree `at` changes: arrays (n,) for one direction, (k, n) or
    (k, 1) for k. The derivative has (k, n) likewise, or what the function does not change (n,).
    """
    level = new_level()
    given = map_tree(
        lambda x, dx: Dual(np.asarray(x, float), np.asarray(dx, float), level), at, along
    )
    result = function(given)
    values = map_tree(lambda x: split(x, level)[0], result)
    return values, map_tree(lambda x, value: _tangent(x, value, level), result, values)


def count_lanes(tree: Any) -> int:
    """How many lanes the columns of a tree have; 1 where all of it is shared."""
    return max((np.shape(leaf)[-1] for leaf in list_leaves(tree) if np.shape(leaf)), default=1)
