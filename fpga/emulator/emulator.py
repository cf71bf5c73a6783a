"""The emulator from Python: built, fed with pushes, and found by nifpga as NI's library.

with emulated_card() as card:
    card.add_push(words, counts)
    with card.open() as session:  # a nifpga.Session
        ...
"""

from __future__ import annotations

import ctypes
import ctypes.util
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import nifpga
import numpy as np
from numpy.typing import ArrayLike

HERE = Path(__file__).parent
DESCRIPTION = HERE.parent / "difffric_push.description.lvbitx"
RESOURCE = "RIO0"
CACHE = HERE.parents[1] / ".pytest_cache" / "emulator"

_FLAGS = (
    "-std=gnu11", "-O3", "-Wall", "-Wextra", "-fPIC", "-shared", "-fvisibility=hidden", "-pthread",
    "-Wl,-soname,libNiFpga.so",
)  # fmt: skip
_NEVER = 2**64 - 1


class NoCompilerError(RuntimeError):
    """The emulator cannot be built here; the message says why."""


def compiler() -> list[str]:
    """The system's C compiler, else that of the ziglang wheel. Raises `NoCompilerError`."""
    if not sys.platform.startswith("linux"):
        raise NoCompilerError("the emulator is built on Linux only")
    if found := shutil.which("cc"):
        return [found]
    if importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "cc"]
    raise NoCompilerError("no C compiler: neither cc nor the ziglang wheel is installed")


def build(cache: Path = CACHE) -> Path:
    """The library, compiled unless `cache` has it of these sources and this compiler."""
    command = [*compiler(), *_FLAGS]
    sources = sorted(HERE.glob("*.c"))
    digest = hashlib.sha256("\0".join(command).encode())
    for path in (*sources, *sorted(HERE.glob("*.h"))):
        digest.update(path.read_bytes())
    library = cache / digest.hexdigest()[:16] / "libNiFpga.so"
    if not library.exists():
        library.parent.mkdir(parents=True, exist_ok=True)
        # Made elsewhere and moved, as several processes may do this at once.
        with tempfile.TemporaryDirectory(dir=library.parent) as folder:
            made = Path(folder) / library.name
            done = subprocess.run(
                [*command, "-o", str(made), *map(str, sources)],
                capture_output=True, text=True, timeout=300,
            )  # fmt: skip
            if done.returncode:
                raise RuntimeError(f"the emulator does not compile:\n{done.stderr}")
            os.replace(made, library)
    return library


class Emulator:
    """The one card of this process, new and with nothing to play.

    `rate` is that of both FIFOs [Hz], `look` the time that a call takes which waits for nothing
    (a register read, a FIFO read of no elements) [s]. The clock is virtual, moved on by what the
    host waits for and looks at, or `real`. `signature` is the card's, where it is to be another
    than the interface's.
    """

    def __init__(
        self,
        library: Path,
        *,
        rate: int = 200_000,
        look: float = 1e-3,
        real: bool = False,
        signature: str | None = None,
    ):
        self._library = ctypes.CDLL(str(library))
        words = np.ctypeslib.ndpointer(np.int16, flags="C")
        counts = np.ctypeslib.ndpointer(np.int32, flags="C")
        u64, i64 = ctypes.c_uint64, ctypes.c_int64
        for name, arguments, result in (
            ("restart", (ctypes.c_bool, ctypes.c_uint32, i64, ctypes.c_char_p), None),
            ("add_push", (words, counts, ctypes.c_size_t, u64, u64, u64, u64), ctypes.c_int32),
            ("fail", (ctypes.c_char_p, ctypes.c_int32, u64, u64), ctypes.c_int32),
            ("pass", (i64,), None),
            ("now", (), i64),
        ):
            function = self._call(name)
            function.argtypes, function.restype = arguments, result
        other = signature.encode() if signature else None
        self._call("restart")(real, rate, round(look * 1e9), other)

    def _call(self, name: str):
        return getattr(self._library, f"difffric_emulator_{name}")

    def add_push(
        self,
        words: ArrayLike,
        counts: ArrayLike,
        *,
        repeats: int = 1,
        silent_at: int | None = None,
        removed_at: int | None = None,
        encoder_error_at: int | None = None,
    ) -> None:
        """Add a push to those to be played, one at each start: force words and encoder counts,
        `repeats` times over.

        Faults, each at a sample's number: the card takes no more samples; it is gone; its encoder
        fails.
        """
        force, position = np.asarray(words).astype(np.int16), np.asarray(counts).astype(np.int32)
        if not (len(force) == len(position) and 0 < len(force) * repeats < 2**32):
            raise ValueError(
                f"expected as many counts as words, 1 to 2^32 - 1 of them; got {len(position)} "
                f"and {len(force)}, {repeats} times"
            )
        if not (np.array_equal(force, words) and np.array_equal(position, counts)):
            raise ValueError("expected words of 16 bits and counts of 32")
        faults = (_NEVER if at is None else at for at in (silent_at, removed_at, encoder_error_at))
        if self._call("add_push")(force, position, len(force), repeats, *faults):
            raise MemoryError

    def fail(self, call: str, status: int, *, skip: int = 0, times: int | None = None) -> None:
        """Let NiFpgaDll_`call` end in `status`, after `skip` calls that do not; negative instead
        of what it does, positive (a warning) with it."""
        if self._call("fail")(call.encode(), status, skip, _NEVER if times is None else times):
            raise ValueError("more failures than the emulator keeps")

    def pass_time(self, seconds: float) -> None:
        """Let the virtual clock go on, as where the host is busy elsewhere."""
        self._call("pass")(round(seconds * 1e9))

    @property
    def now(self) -> float:
        """The clock's time [s]."""
        return self._call("now")() * 1e-9

    def open(self, **options) -> nifpga.Session:
        """A session that is not yet running."""
        return nifpga.Session(os.fspath(DESCRIPTION), RESOURCE, no_run=True, **options)


@contextmanager
def emulated_card(**options) -> Iterator[Emulator]:
    """A new card (`options` are those of `Emulator`), which nifpga takes for NI's.

    Raises `NoCompilerError` where it cannot be built.
    """
    library, find = build(), ctypes.util.find_library

    def find_library(name: str) -> str | None:
        return str(library) if name == "NiFpga" else find(name)

    with mock.patch.object(ctypes.util, "find_library", find_library):
        yield Emulator(library, **options)
