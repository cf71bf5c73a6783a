"""Frozen dataclasses of numbers, which JAX takes for trees but which need no JAX themselves.

A rig is read, checked and pushed a few times in a process that never imports JAX: that import alone
takes longer than all the rest. So the classes whose numbers are differentiated (the laws, the rig)
are plain dataclasses, and JAX is told of them when it is imported, by whomever: from then on they
are trees like any `equinox.Module`.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar, dataclass_transform

import numpy as np

if TYPE_CHECKING:
    from types import ModuleType

Tree = TypeVar("Tree")


@dataclass_transform(frozen_default=True, eq_default=False)
class NumberTree:
    """A frozen dataclass whose fields are numbers, arrays, None, or trees of them.

    A subclass becomes a dataclass by itself, with the fields that it annotates. For JAX every field
    is data, but for those with `metadata={"static": True}`. Two of them are equal where class,
    structure and all numbers are.
    """

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        dataclass(frozen=True, eq=False, repr=True)(cls)
        _tell_jax(cls)

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))  # pyright: ignore[reportArgumentType]
        return all(_are_equal(a, b) for a, b in pairs)

    def __hash__(self) -> int:
        return hash((type(self), *(getattr(self, f.name) for f in fields(self))))  # pyright: ignore[reportArgumentType]


def _are_equal(a: Any, b: Any) -> bool:
    if a is None or b is None or isinstance(a, NumberTree):
        return a is b or (type(a) is type(b) and a == b)
    return a is b or np.array_equal(a, b)


def put_parts(tree: Tree, where: Callable[[Tree], Sequence[Any]], new: Sequence[Any]) -> Tree:
    """The tree with some of its parts replaced, as `equinox.tree_at` does it: `where` picks them
    out of a tree of this structure, numbers, None or whole laws."""
    marked = _mark(tree)
    replaced = {id(part): x for part, x in zip(where(marked), new, strict=True)}

    def put(old: Any, mark: Any) -> Any:
        if id(mark) in replaced:
            return replaced[id(mark)]
        parts = _read_parts(old)
        if parts is None:
            return old
        marks = _read_parts(mark) or {}
        return _rebuild(old, {name: put(x, marks[name]) for name, x in parts.items()})

    return put(tree, marked)


def is_traced(value: Any) -> bool:
    """Whether JAX is tracing with this value, so that it is no number yet."""
    return "jax" in sys.modules and isinstance(value, sys.modules["jax"].core.Tracer)


class _Mark:
    """What stands for a number or None while parts are looked up: no two are the same."""


def _mark(tree: Any) -> Any:
    parts = _read_parts(tree)
    return _Mark() if parts is None else _rebuild(tree, {n: _mark(x) for n, x in parts.items()})


def _read_parts(node: Any) -> dict[str, Any] | None:
    """The fields of a dataclass or a named tuple, the entries of another tuple; None: a number."""
    if is_dataclass(node) and not isinstance(node, type):
        own = [f.name for f in fields(node) if not f.metadata.get("static")]
        return {name: getattr(node, name) for name in own}
    if isinstance(node, tuple):
        return dict(zip(getattr(node, "_fields", map(str, range(len(node)))), node, strict=True))
    return None


def _rebuild(node: Any, parts: dict[str, Any]) -> Any:
    """A node like this one of other parts; nothing of its own making runs."""
    if isinstance(node, tuple):
        return node._make(parts.values()) if hasattr(node, "_make") else tuple(parts.values())  # pyright: ignore[reportAttributeAccessIssue]
    new = object.__new__(type(node))
    for f in fields(node):
        object.__setattr__(new, f.name, parts.get(f.name, getattr(node, f.name)))
    return new


_waiting: list[type] = []
"""Classes that JAX is to be told of as soon as it is there."""


def _tell_jax(cls: type) -> None:
    if "jax" in sys.modules and not _waiting:
        _register(sys.modules["jax"], cls)
        return
    if not _waiting:
        sys.meta_path.insert(0, _JaxWatch())
    _waiting.append(cls)


def _register(jax: Any, cls: type) -> None:
    """Make a class a tree of JAX's.

    Not as `register_dataclass` does it: two such classes with as many fields have equal structures
    for jaxlib 0.10, and a program that was compiled for a gain served a low-pass.
    """
    own = [f.name for f in fields(cls) if not f.metadata.get("static")]  # pyright: ignore[reportArgumentType]
    static = [f.name for f in fields(cls) if f.metadata.get("static")]  # pyright: ignore[reportArgumentType]
    keys = [jax.tree_util.GetAttrKey(name) for name in own]

    def flatten(node: Any) -> tuple[list[Any], tuple]:
        return [getattr(node, n) for n in own], tuple(getattr(node, n) for n in static)

    def flatten_with_keys(node: Any) -> tuple[list[Any], tuple]:
        parts, kept = flatten(node)
        return list(zip(keys, parts, strict=True)), kept

    def unflatten(kept: tuple, parts: Sequence[Any]) -> Any:
        new = object.__new__(cls)
        for name, value in zip((*own, *static), (*parts, *kept), strict=True):
            object.__setattr__(new, name, value)
        return new

    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)


class _JaxWatch(importlib.abc.MetaPathFinder):
    """Waits for the import of JAX, and tells it of the classes that were made before it."""

    def find_spec(
        self, fullname: str, path: Any, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """JAX's own spec, whose loader tells it of them at the end; None for all else."""
        if fullname != "jax":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_tell(module: ModuleType) -> None:
                load(module)
                while _waiting:
                    _register(module, _waiting.pop())

            spec.loader.exec_module = load_and_tell
        return spec
