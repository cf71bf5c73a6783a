"""Trees of numbers, such as a rig or the state of a push, treated as if they were one number."""

from __future__ import annotations

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Bool
from numpy.typing import NDArray

Tree = TypeVar("Tree")


def select(condition: Bool[ArrayLike, ""], new: Tree, old: Tree) -> Tree:
    """Each leaf of `new` where the condition holds, else that of `old`; both are computed."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), new, old)


def as_arrays(tree: Tree) -> Tree:
    """A tree (a rig, or what holds one) with every number an array, so that one compiled program
    serves all trees of its kind."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)


def replicate(tree: Tree, n: int) -> Tree:
    """n copies of a tree (a rig) in one: every number becomes a NumPy array of that length, to be
    mapped over by `jax.vmap`."""

    def copy(leaf):
        return np.broadcast_to(np.asarray(leaf, float), (n,))

    return jax.tree.map(copy, tree)


def pick(tree: Any, index: NDArray | slice | int) -> Any:
    """Some entries of a tree of arrays, such as replicated rigs, by an array of indices."""

    def take_entries(leaf):
        # NumPy's own arrays stay so: to index one of JAX's takes a hundred times as long.
        return (leaf if isinstance(leaf, np.ndarray) else jnp.asarray(leaf))[index]

    return jax.tree.map(take_entries, tree)
