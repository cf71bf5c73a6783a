"""Compiled programs kept on disk: a process that finds its program there neither traces nor
compiles it.

JAX's own cache keeps what XLA compiled, by what was traced; tracing a push takes seconds. Here a
program is found by what it was made from: the function, the kinds of its arguments, this library's
files, the versions and the processor below. The files are pickles, so a folder that another user
could write is refused.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, update_wrapper
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.experimental.compilation_cache import compilation_cache

import difffric
from difffric.compute.private_folder import REFUSED, is_private, is_running, make_private

FOLDER = "DIFFFRIC_PROGRAMS"
"""Environment variable: where programs are kept; unset or empty: nowhere."""
_PACKAGE = Path(difffric.__path__[0])
"""The folder whose files, however deep, make a program: a changed law must never run an old one."""
_MADE_WITH = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
_FLAGS = ("XLA_FLAGS", "JAX_PLATFORMS", "EQX_ON_ERROR", "NPROC")
_OWN = ("difffric.", "equinox.", "jax.", "jaxlib.", "builtins", "collections")
_PLAIN = (bool, int, float, str, type(None))
_FOREIGN = re.compile(r'custom_call_target="([^"]+)"')
_MARK = ".first-"
_NAMELESS = " at 0x"
"""In what Python says of an object that has no name beyond this process."""
_OLD = 30 * 86400.0
"""Age [s] at which the programs of another version are removed."""


def cache_program(
    function: Callable, options: Callable[[], dict | None] = lambda: None
) -> CachedProgram:
    """`function` compiled, and its programs kept on disk where that is switched on; use it as a
    decorator. `options` gives the compiler's options, when the first program is made."""
    return CachedProgram(function, options)


class CachedProgram:
    """`equinox.filter_jit`, with programs kept on disk where that is switched on (`FOLDER`).

    A program is kept where all of its arguments are of this library's own kinds and its results are
    arrays: another's class may change without a trace in the key. Within a trace, and for all else,
    it is `filter_jit` alone.
    """

    def __init__(self, function: Callable, options: Callable[[], dict | None]):
        self._function, self._options = function, options
        self._ready: dict[Any, Callable | None] = {}
        self._jitted: Any = None
        update_wrapper(self, function)

    def __call__(self, *args: Any) -> Any:
        folder = _folder(os.environ.get(FOLDER, ""))
        if folder is None:
            return self.jitted(*args)
        leaves, tree = jax.tree.flatten(args)
        arrays = [x for x in leaves if eqx.is_array(x)]
        if any(isinstance(x, Tracer) for x in arrays):
            return self.jitted(*args)
        # With its class, as 1, 1.0 and True are equal.
        kinds = tuple(_kind(x) if eqx.is_array(x) else (type(x), x) for x in leaves)
        try:
            key = (tree, kinds)
            if key not in self._ready:
                self._ready[key] = self._load_or_compile(tree, leaves, arrays)
            program = self._ready[key]
        except TypeError:  # an argument that cannot be hashed
            program = None
        return self.jitted(*args) if program is None else program(arrays)

    @property
    def jitted(self) -> Any:
        """The function as `equinox.filter_jit` has it."""
        if self._jitted is None:
            jit: Any = eqx.filter_jit
            self._jitted = jit(self._function, compiler_options=self._options())
        return self._jitted

    def lower(self, *args: Any) -> Any:
        """The program for these arguments, traced: `.compile()` makes it ready for later calls."""
        return self.jitted.lower(*args)

    def _load_or_compile(self, tree, leaves, arrays) -> Callable | None:
        """The program for arguments like these, from the disk or put there; None: by `jitted`."""
        args = jax.tree.unflatten(tree, leaves)
        others = [x for x in leaves if not eqx.is_array(x)]
        named = str(tree)
        if (
            not all(isinstance(x, _PLAIN) for x in others)
            or not has_own_classes(args)
            or _NAMELESS in named
        ):
            return None
        where = (self._function.__module__, self._function.__qualname__)
        kinds = [_kind(x) if eqx.is_array(x) else (type(x).__name__, x) for x in leaves]

        def flat(arrays):
            given = iter(arrays)
            whole = [next(given) if eqx.is_array(x) else x for x in leaves]
            return self._function(*jax.tree.unflatten(tree, whole))

        return load_or_compile((*where, named, kinds), flat, arrays, self._options())


def load_or_compile(
    key: tuple, function: Callable, arrays: list, options: dict | None = None
) -> Callable | None:
    """`function` of a list of arrays compiled for arrays like these: from the disk, or put there.
    None where no programs are kept.

    `key` is all that makes the program but this library, what it stands on and the processor; its
    repr counts.
    """
    folder = _folder(os.environ.get(FOLDER, ""))
    if folder is None:
        return None
    whole = repr((key, list(map(_kind, arrays)), options))
    path = folder / hashlib.sha256(whole.encode()).hexdigest()[:40]
    if _fatal(path):
        return None
    call = _read(path)
    if call is None:
        shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype, weak_type=_kind(x)[2]) for x in arrays]
        trees = []

        def list_leaves(arrays):
            leaves, tree = jax.tree.flatten(function(arrays))
            trees.append(tree)
            return leaves

        with _without_jax_cache():
            compiled = jax.jit(list_leaves, compiler_options=options).lower(shapes).compile()
        call = _wrap(compiled, trees[0])
        _write(path, compiled, trees[0])
        # What is kept is believed only where it gives the same once more.
        again = _read(path)
        if again is not None and not _same(call(arrays), again(arrays)):
            path.unlink(missing_ok=True)
    return call


def _wrap(compiled, tree) -> Callable:
    return lambda arrays: jax.tree.unflatten(tree, compiled(arrays))


def _mark_first_call(path: Path, call: Callable) -> Callable:
    """The program, whose first call leaves a mark where it takes the process with it."""
    mark = path.with_name(f"{path.name}{_MARK}{os.getpid()}")
    marked: Any = call

    def first(arrays):
        nonlocal marked
        with suppress(OSError):
            mark.touch()
        try:
            return call(arrays)
        finally:
            marked = call
            with suppress(OSError):
                mark.unlink()

    marked = first
    return lambda arrays: marked(arrays)


def _fatal(path: Path) -> bool:
    """Whether processes have ended, twice, in this program's first call."""
    marks = path.parent.glob(f"{path.name}{_MARK}*")
    return sum(not is_running(int(mark.name.rpartition(_MARK)[2])) for mark in marks) > 1


@cache
def _lapack_ready() -> None:
    """Lowering a call of LAPACK fills the table that the call is made by; loading one does not."""
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))


def _same(a, b) -> bool:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)


@contextmanager
def _without_jax_cache() -> Iterator[None]:
    """A program that JAX's own cache has loaded lacks what serialising it would need."""
    config: Any = jax.config
    before = config.jax_enable_compilation_cache
    config.update("jax_enable_compilation_cache", False)
    compilation_cache.reset_cache()
    try:
        yield
    finally:
        config.update("jax_enable_compilation_cache", before)
        compilation_cache.reset_cache()


def _kind(x) -> tuple:
    return x.shape, x.dtype, getattr(x, "weak_type", False)


def has_own_classes(args: Any) -> bool:
    """Whether every node of a tree is of a class whose source a key knows of."""
    modules = set()

    def node(x) -> bool:
        modules.add(type(x).__module__ + ".")
        return False

    leaves = jax.tree.leaves(args, is_leaf=node)
    modules -= {type(x).__module__ + "." for x in leaves}
    return all(m.startswith(_OWN) for m in modules)


def _read(path: Path):
    """The program, or None where there is none that can be used."""
    from jax.experimental import serialize_executable

    try:
        with path.open("rb") as file:
            if not is_private(os.fstat(file.fileno())):
                return None
            digest, blob = file.read(32), file.read()
        if hashlib.sha256(blob).digest() != digest:
            raise ValueError("cut short")
        *packed, skeleton, by_lapack = pickle.loads(blob)
        if by_lapack:
            _lapack_ready()
        loaded = serialize_executable.deserialize_and_load(*packed)
        return _mark_first_call(path, _wrap(loaded, jax.tree.structure(skeleton)))
    except FileNotFoundError:
        return None
    except Exception:  # of another processor, or damaged: it is made anew
        with suppress(OSError):
            path.unlink()
        return None


def _write(path: Path, compiled, tree) -> None:
    """Put a program where others look for it, in one piece; what cannot be kept is not."""
    from jax.experimental import serialize_executable

    with suppress(Exception):
        foreign = set(_FOREIGN.findall(compiled.as_text()))
        if not all(name.startswith("lapack_") for name in foreign):
            return  # an address of this process: a callback of Python's, say
        payload, ins, outs = serialize_executable.serialize(compiled)
        skeleton = jax.tree.unflatten(tree, list(range(tree.num_leaves)))
        blob = pickle.dumps((payload, ins, outs, skeleton, bool(foreign)))
        handle, part = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(blob).digest() + blob)
            os.replace(part, path)
        except BaseException:
            os.unlink(part)
            raise


@cache
def _folder(root: str) -> Path | None:
    """The folder of this version's programs, made if need be; None where nothing is to be kept,
    which is said where others may write there."""
    if not root:
        return None
    folder = Path(root) / _name_version()
    for part in (Path(root), folder):
        if not make_private(part):
            sys.stderr.write(f"difffric: {part}: {REFUSED}: compiled programs are not kept\n")
            return None
    with suppress(OSError):
        os.utime(folder)
        for other in Path(root).iterdir():
            if other != folder and time.time() - other.stat().st_mtime > _OLD:
                shutil.rmtree(other, ignore_errors=True)
    return folder


def _name_version() -> str:
    """A name for this library's files, what they stand on, and the processor."""
    own = sorted(_PACKAGE.rglob("*.py"))
    files = [(str(p.relative_to(_PACKAGE)), (s := p.stat()).st_size, s.st_mtime_ns) for p in own]
    versions = [version(name) for name in _MADE_WITH]
    flags = [os.environ.get(name) for name in _FLAGS]
    all_of_it = (
        files,
        versions,
        flags,
        jax.config.read("jax_enable_x64"),
        sys.version,
        os.cpu_count(),
        _processor(),
    )
    return hashlib.sha256(repr(all_of_it).encode()).hexdigest()[:24]


def _processor() -> str:
    """What the compiler looks at: a program for a newer processor would not run on an older."""
    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as file:
        for line in file:
            if line.startswith(("flags", "Features")):
                return line
    return f"{platform.machine()} {platform.processor()}"
