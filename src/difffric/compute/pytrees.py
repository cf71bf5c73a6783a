"""Trees of numbers, such as a rig or the state of a push, treated as if they were one number."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from difffric.compute import arrays as xp
from difffric.compute.dual_numbers import Dual

Tree = TypeVar("Tree")

_LEAVES = {float, int, bool, np.ndarray, np.float64, np.bool_, np.int64, Dual}
"""Kinds that are one number or array, and need not be looked into."""


def map_tree(function: Callable[..., Any], tree: Any, *others: Any) -> Any:
    """`jax.tree.map` that needs no JAX: a tree like `tree`, each leaf of it what `function` makes
    of its leaf and of those of `others` in the same place.

    Branches are None, tuples, lists, dicts and dataclasses, whose fields of the metadata `static`
    stay as they are; of other objects JAX decides where it is loaded.
    """
    kind = type(tree)
    if kind in _LEAVES:
        return function(tree, *others)
    if tree is None:
        return None
    if isinstance(tree, tuple | list):
        parts = [map_tree(function, *nodes) for nodes in zip(tree, *others, strict=True)]
        return kind(*parts) if hasattr(kind, "_fields") else kind(parts)
    if kind is dict:
        return {key: map_tree(function, tree[key], *(o[key] for o in others)) for key in tree}
    if is_dataclass(kind):
        new = object.__new__(kind)
        for field in fields(kind):
            own = getattr(tree, field.name)
            if not field.metadata.get("static"):
                own = map_tree(function, own, *(getattr(o, field.name) for o in others))
            object.__setattr__(new, field.name, own)
        return new
    jax: Any = sys.modules.get("jax")
    if hasattr(jax, "tree"):
        return jax.tree.map(function, tree, *others)
    return function(tree, *others)


def list_leaves(tree: Any) -> list[Any]:
    """The numbers and arrays of a tree, in order."""
    leaves: list[Any] = []
    map_tree(leaves.append, tree)
    return leaves


def select(condition: Any, new: Tree, old: Tree) -> Tree:
    """Each leaf of `new` where the condition holds, else that of `old`; both are computed."""
    walk = map_tree
    if xp.uses_jax(condition):
        import jax

        walk = jax.tree.map
    return walk(lambda a, b: xp.where(condition, a, b), new, old)


def as_arrays(tree: Tree) -> Tree:
    """A tree (a rig, or what holds one) with every number an array of JAX's, so that one compiled
    program serves all trees of its kind."""
    import jax
    import jax.numpy as jnp

    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)


def replicate(tree: Tree, n: int) -> Tree:
    """n copies of a tree (a rig) in one: every number becomes a NumPy array of that length, to be
    mapped over by `jax.vmap`."""

    def copy(leaf):
        return np.broadcast_to(np.asarray(leaf, float), (n,))

    return map_tree(copy, tree)


def pick(tree: Any, index: NDArray | slice | int) -> Any:
    """Some entries of a tree of arrays, such as replicated rigs, by an array of indices."""

    # NumPy's own arrays stay so: to index one of JAX's takes a hundred times as long.
    return map_tree(lambda leaf: xp.asarray(leaf)[index], tree)
