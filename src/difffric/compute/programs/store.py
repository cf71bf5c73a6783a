"""The store of compiled programs: found by their key without being traced, else made once.

Threads and processes that ask for one program at once wait for the first, which makes it; the
others load what it wrote. One thread traces at a time: two would only keep each other waiting,
where compiling leaves Python to the others. The files are pickles, so a folder that another user
could write is refused.
"""

from __future__ import annotations

import hashlib
import io
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
from functools import cache
from importlib.metadata import version
from pathlib import Path
from threading import Lock, local
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import difffric
from difffric import leftovers
from difffric.compute.programs.private_folder import (
    FOLDER,
    REFUSED,
    hold,
    is_private,
    is_running,
    make_private,
)
from difffric.compute.programs.record import Record
from difffric.compute.programs.stripped import find_targets, strip
from difffric.compute.programs.trial import TRIAL

_PACKAGE = Path(difffric.__path__[0])
"""The folder whose files, however deep, make a program: a changed law must never run an old one."""
_MADE_WITH = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
_FLAGS = ("XLA_FLAGS", "JAX_PLATFORMS", "EQX_ON_ERROR", "NPROC")
_STRIPPED = jax.__version_info__ < (0, 11)
"""Whether programs are stripped: what XLA writes has no promised layout, and with later versions
nobody has tried."""
_FOREIGN = re.compile(r'custom_call_target="([^"]+)"')
_MARK = ".first-"
_LOCK = ".lock"
_OLD = 30 * 86400.0
"""Age [s] at which the programs of another version are removed."""

_tracing = Lock()
"""Held by the thread that traces."""
_here = local()
"""Of each thread, whether it traces."""


def is_tracing() -> bool:
    """Whether this thread is tracing a program: it must not wait for another's then."""
    return getattr(_here, "tracing", False)


def load_or_compile(
    key: tuple, function: Callable, arrays: list, options: dict | None = None
) -> Callable | None:
    """`function` of a list of arrays compiled for arrays like these: from the disk, or put there.
    None where no programs are kept, and while another is traced.

    Of `options` the compiler is given none where it does not know them all.

    `key` is all that makes the program but this library, what it stands on and the processor; its
    repr counts, and its first is the program's name.
    """
    folder = find_folder(os.environ.get(FOLDER, ""))
    if folder is None or is_tracing():
        return None
    whole = repr((key, list(map(describe_kind, arrays)), options))
    path = folder / hashlib.sha256(whole.encode()).hexdigest()[:40]
    if _fatal(path):
        return None
    record = Record(str(key[0]), path.name[:8])
    call = read_program(path, record)
    if call is None:
        with hold(path.with_name(path.name + _LOCK)):
            call = read_program(path, record) or _make(path, function, arrays, options, record)
    return record.watch(call)


def compile_now(
    function: Callable, arrays: list, options: dict | None, record: Record
) -> tuple[Any, Any]:
    """`function` compiled for a list of arrays like these, giving a list; and the structure of
    what it gives."""
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype, weak_type=describe_kind(x)[2]) for x in arrays]
    trees = []

    def list_leaves(arrays):
        leaves, tree = jax.tree.flatten(function(arrays))
        trees.append(tree)
        return leaves

    options = keep_known_options(options) if options else None
    with record.announce():
        with _tracing, record.time("traced"):
            _here.tracing = True
            try:
                lowered = jax.jit(list_leaves, compiler_options=options).lower(shapes)
            finally:
                _here.tracing = False
        with _bypass_jax_cache(), record.time("compiled"):
            return lowered.compile(), trees[0]


def keep_known_options(options: dict[str, Any]) -> dict[str, Any] | None:
    """The compiler's options, or none where this jaxlib does not know them."""
    return dict(options) if _are_known(tuple(options.items())) else None


@cache
def _are_known(options: tuple[tuple[str, Any], ...]) -> bool:
    # Asked when something is compiled: at import there may be no device yet, and a program that is
    # found needs no answer.
    try:
        jax.jit(lambda x: x, compiler_options=dict(options)).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


def _make(
    path: Path, function: Callable, arrays: list, options: dict | None, record: Record
) -> Callable:
    """The program compiled, and kept where that is possible.

    What is kept is believed only where it gives the same once more: first the program without all
    that running it should not need, once another process has survived it, then as XLA wrote it.
    """
    if _STRIPPED:
        TRIAL.start()
    compiled, tree = compile_now(function, arrays, options, record)
    call = wrap(compiled, tree)
    wanted = call(arrays)
    for edit in (strip, None) if _STRIPPED else (None,):
        if not _write(path, compiled, tree, edit):
            continue
        survived = edit is None or TRIAL.survives(path, arrays)
        again = read_program(path, record) if survived else None
        with suppress(Exception):
            if again is not None and _same(wanted, again(arrays)):
                return again
        path.unlink(missing_ok=True)
    return call


def wrap(compiled: Any, tree: Any) -> Callable:
    """A compiled function of a list, that gives what has this structure."""
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
            with leftovers.guard(mark):
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
    """Fill the table that calls of LAPACK are made by, which loading a program does not."""
    try:
        from jaxlib.lapack import prepare_lapack_call

        prepare_lapack_call("potrf", np.dtype(float))
    except Exception:  # another version: lowering a call does it, and takes half a second
        jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))


def _same(a: Any, b: Any) -> bool:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)


@contextmanager
def _bypass_jax_cache() -> Iterator[None]:
    """In this thread JAX's own cache keeps nothing: it would keep each program a second time, and
    a program that it has loaded lacks what serialising needs."""
    try:
        from jax._src.config import persistent_cache_min_compile_time_secs as least
    except ImportError:  # what cannot be serialised for it is not kept here
        yield
        return
    with least(float("inf")):
        yield


def describe_kind(x: Any) -> tuple:
    """What of an array a program is made for."""
    return x.shape, x.dtype, getattr(x, "weak_type", False)


def read_program(path: Path, record: Record) -> Callable | None:
    """The program, or None where there is none that can be used."""
    try:
        with path.open("rb") as file:
            if not is_private(os.fstat(file.fileno())):
                return None
            digest, blob = file.read(32), file.read()
        if hashlib.sha256(blob).digest() != digest:
            raise ValueError("cut short")
        with record.time("loaded"):
            from jax.experimental import serialize_executable

            *packed, skeleton, by_lapack = pickle.loads(blob)
            if by_lapack:
                _lapack_ready()
            loaded = serialize_executable.deserialize_and_load(*packed)
        record.size = len(blob)
        return _mark_first_call(path, wrap(loaded, jax.tree.structure(skeleton)))
    except FileNotFoundError:
        return None
    except Exception:  # of another processor, or damaged: it is made anew
        with suppress(OSError):
            path.unlink()
        return None


def _write(path: Path, compiled: Any, tree: Any, edit: Callable[[bytes], bytes] | None) -> bool:
    """Put a program where others look for it, in one piece, its executable edited; whether that
    was possible."""
    from jax.experimental import serialize_executable

    try:
        payload, ins, outs = serialize_executable.serialize(compiled)
        payload, executable = _edit_executable(payload, edit)
        try:
            foreign = find_targets(executable)
        except Exception:  # laid out as no version that was tried
            foreign = set(_FOREIGN.findall(compiled.as_text()))
        if not all(name.startswith("lapack_") for name in foreign):
            return False  # an address of this process: a callback of Python's, say
        skeleton = jax.tree.unflatten(tree, list(range(tree.num_leaves)))
        blob = pickle.dumps((payload, ins, outs, skeleton, bool(foreign)))
        handle, part = tempfile.mkstemp(dir=path.parent)
        try:
            with leftovers.guard(Path(part)):
                with os.fdopen(handle, "wb") as file:
                    file.write(hashlib.sha256(blob).digest() + blob)
                os.replace(part, path)
        except BaseException:
            os.unlink(part)
            raise
    except Exception:  # a full disk, something that cannot be pickled
        return False
    return True


class _Executable:
    """Stands for XLA's executable in what JAX pickles of a program."""

    def __init__(self, content: bytes):
        self.content = content


def _edit_executable(payload: bytes, edit: Callable[[bytes], bytes] | None) -> tuple[bytes, bytes]:
    """What JAX pickled of a program, with XLA's executable edited; and that as it was before."""
    devices = {device.id: device for device in jax.devices()}
    client = jax.devices()[0].client
    found: list[bytes] = []

    class Reader(pickle.Unpickler):
        def persistent_load(self, pid: tuple) -> Any:
            if pid[0] == "exec":
                found.append(pid[1])
                return _Executable(pid[1] if edit is None else edit(pid[1]))
            return devices[pid[1]] if pid[0] == "device" else client

    class Writer(pickle.Pickler):
        def persistent_id(self, obj: Any) -> tuple | None:
            if isinstance(obj, _Executable):
                return "exec", obj.content
            if isinstance(obj, jax.Device):
                return "device", obj.id
            return ("client",) if obj is client else None

    content = Reader(io.BytesIO(payload)).load()
    (executable,) = found
    file = io.BytesIO()
    Writer(file).dump(content)
    return file.getvalue(), executable


@cache
def find_folder(root: str) -> Path | None:
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
