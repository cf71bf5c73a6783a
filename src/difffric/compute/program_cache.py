"""Compiled programs kept on disk: a process that finds its program there neither traces nor
compiles it.

JAX's own cache keeps what XLA compiled, by what was traced; tracing a push takes seconds. Here a
program is found by what it was made from: the function, the kinds of its arguments, this library's
files, the versions and the processor below (`program_store`).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import update_wrapper
from threading import Lock
from typing import Any

import numpy as np

from difffric.compute.programs.private_folder import FOLDER

# JAX is imported by the first call: a module with a program in it may serve without.

_OWN = ("difffric.", "equinox.", "jax.", "jaxlib.", "builtins", "collections")
_PLAIN = (bool, int, float, str, type(None))
_NAMELESS = " at 0x"
"""In what Python says of an object that has no name beyond this process."""


def cache_program(function: Callable, options: dict[str, Any] | None = None) -> CachedProgram:
    """`function` compiled, and its programs kept on disk where that is switched on; use it as a
    decorator. `options` are the compiler's; none of them, where it does not know them."""
    return CachedProgram(function, options)


class CachedProgram:
    """`equinox.filter_jit`, with programs kept on disk where that is switched on (`FOLDER`).

    A program is kept where all of its arguments are of this library's own kinds and its results are
    arrays: another's class may change without a trace in the key. Within a trace, and for all else,
    it is `filter_jit` alone.
    """

    def __init__(self, function: Callable, options: dict[str, Any] | None = None):
        self._function, self._options = function, options
        self._ready: dict[Any, Callable | None] = {}
        self._making: dict[Any, Lock] = {}
        self._jitted: Any = None
        update_wrapper(self, function)

    def __call__(self, *args: Any) -> Any:
        if not self._ready and not os.environ.get(FOLDER):
            return self.jitted(*args)
        return self._call(args)

    def _call(self, args: tuple) -> Any:
        import jax
        from jax.core import Tracer

        from difffric.compute.programs.store import is_tracing

        leaves, tree = jax.tree.flatten(args)
        arrays = list(filter(_is_array, leaves))
        if any(isinstance(x, Tracer) for x in arrays) or is_tracing():
            return self.jitted(*args)
        program = self._find(leaves, tree, arrays)
        return self.jitted(*args) if program is None else program(arrays)

    def prepare(self, *args: Any) -> None:
        """Make the program for arguments like these ready for later calls; may be left to another
        thread, for which a call that comes meanwhile waits."""
        import jax

        leaves, tree = jax.tree.flatten(args)
        self._find(leaves, tree, list(filter(_is_array, leaves)), needed=True)

    @property
    def jitted(self) -> Any:
        """The function as `equinox.filter_jit` has it."""
        if self._jitted is None:
            import equinox as eqx

            from difffric.compute.programs.store import keep_known_options

            jit: Any = eqx.filter_jit
            options = keep_known_options(self._options) if self._options else None
            self._jitted = jit(self._function, compiler_options=options)
        return self._jitted

    def _find(self, leaves, tree, arrays, needed: bool = False) -> Callable | None:
        """The program for arguments like these; None: by `jitted`, unless it is `needed`."""
        from difffric.compute.programs.store import describe_kind

        # With its class, as 1, 1.0 and True are equal.
        kinds = tuple(describe_kind(x) if _is_array(x) else (type(x), x) for x in leaves)
        key = (tree, kinds)
        try:
            if key in self._ready:
                return self._ready[key]
            if not needed and not os.environ.get(FOLDER) and key not in self._making:
                return None
        except TypeError:  # an argument that cannot be hashed
            return None
        with self._making.setdefault(key, Lock()):
            if key not in self._ready:
                self._ready[key] = self._load_or_compile(tree, leaves, arrays, needed)
        return self._ready[key]

    def _load_or_compile(self, tree, leaves, arrays, needed: bool) -> Callable | None:
        """The program for arguments like these, from the disk or put there; one that cannot be
        kept is compiled if it is `needed`, and is else None."""
        import jax

        from difffric.compute.programs.record import Record
        from difffric.compute.programs.store import (
            compile_now,
            describe_kind,
            load_or_compile,
            wrap,
        )

        name = f"{self._function.__module__}.{self._function.__qualname__}"

        def flat(arrays):
            given = iter(arrays)
            whole = [next(given) if _is_array(x) else x for x in leaves]
            return self._function(*jax.tree.unflatten(tree, whole))

        others = [x for x in leaves if not _is_array(x)]
        named, kept = str(tree), None
        if (
            all(isinstance(x, _PLAIN) for x in others)
            and has_own_classes(jax.tree.unflatten(tree, leaves))
            and _NAMELESS not in named
        ):
            kinds = [describe_kind(x) if _is_array(x) else (type(x).__name__, x) for x in leaves]
            kept = load_or_compile((name, named, kinds), flat, arrays, self._options)
        if kept is None and needed:
            return wrap(*compile_now(flat, arrays, self._options, Record(name, "")))
        return kept


def _is_array(x: Any) -> bool:
    """Whether `equinox.filter_jit` traces it."""
    import jax

    return isinstance(x, (jax.Array, np.ndarray, np.generic))


def has_own_classes(args: Any) -> bool:
    """Whether every node of a tree is of a class whose source a key knows of."""
    import jax

    modules = set()

    def node(x) -> bool:
        modules.add(type(x).__module__ + ".")
        return False

    leaves = jax.tree.leaves(args, is_leaf=node)
    modules -= {type(x).__module__ + "." for x in leaves}
    return all(m.startswith(_OWN) for m in modules)
