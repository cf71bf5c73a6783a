"""Ctrl-C: the command ends within a second, says what is known so far, and leaves no half a file.

Python raises `KeyboardInterrupt` once the main thread comes back to it, and a compiler or a
compiled program may take minutes. A thread that the signal wakes therefore waits for a moment, and
then ends the process itself.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock, Thread, current_thread, main_thread
from typing import NoReturn

from difffric import leftovers
from difffric.known_so_far import KEPT_ON_DISK, KnownSoFar, keep_known
from difffric.name_text import make_printable

STOPPED = 130
"""Exit status of a command that Ctrl-C ended, as a shell has it: 128 and the signal's number."""
_PATIENCE = 0.5
"""How long [s] the main thread may take to tidy up by itself: files are removed in less."""
_PLACING = 5.0
"""How long [s] files that take their places are waited for: it takes them milliseconds."""


class RunningCommand:
    """The command that runs: what it does, what it knows, and how it is ended."""

    def __init__(self) -> None:
        self.name = ""
        self.out: Path | None = None
        """the folder that was asked for"""
        self.now = ""
        """what is being done"""
        self.known = KnownSoFar()
        self._began = time.monotonic()
        self._patience = _PATIENCE
        self._ending = Lock()
        self._interrupted = False
        self._excused = 0

    def begin(self, words: Sequence[str]) -> None:
        """Begin anew, with the words of a command line."""
        self.__init__()
        self.name = next((word for word in words if not word.startswith("-")), "")

    @contextmanager
    def keep_known(self) -> Iterator[None]:
        """Keep what becomes known within, for the end."""
        with keep_known() as self.known:
            yield

    @contextmanager
    def end_by_ctrl_c(self) -> Iterator[None]:
        """What is done within goes on until Ctrl-C, after which the command goes on."""
        try:
            yield
        except KeyboardInterrupt:
            self._excused += 1
            self._interrupted = False

    @contextmanager
    def take_time(self, seconds: float) -> Iterator[None]:
        """What is done within may take so long to stop, as a device must be let go of."""
        self._patience = seconds
        try:
            yield
        finally:
            self._patience = _PATIENCE

    @contextmanager
    def watch(self) -> Iterator[None]:
        """End the process at Ctrl-C within. Does nothing where the signal is ignored already, and
        outside the main thread, where nobody may ask for it."""
        before = signal.getsignal(signal.SIGINT)
        if current_thread() is not main_thread() or before is not signal.default_int_handler:
            yield
            return
        reader, writer = socket.socketpair()
        writer.setblocking(False)
        waker = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
        signal.signal(signal.SIGINT, self._interrupt)
        Thread(target=self._await_signals, args=(reader,), daemon=True).start()
        try:
            yield
        finally:
            if self._interrupted:  # whatever became of the exception on its way
                self.end()
            signal.signal(signal.SIGINT, before)
            signal.set_wakeup_fd(waker)
            writer.close()  # the thread reads the end, and returns

    def _interrupt(self, number: int, frame: object) -> None:
        """Raise `KeyboardInterrupt`, but not between files of a folder that take their places."""
        if not leftovers.PLACING.locked():
            self._interrupted = True
            raise KeyboardInterrupt

    def _await_signals(self, reader: socket.socket) -> None:
        with reader:
            while found := reader.recv(1):
                if found[0] != signal.SIGINT:
                    continue
                time.sleep(self._patience)
                if not self._excused:
                    self.end()
                self._excused -= 1

    def end(self) -> NoReturn:
        """End the process: say what is known, remove what is half-written. The first thread that
        comes does; any other waits for its end."""
        self._ending.acquire()
        leftovers.PLACING.acquire(timeout=_PLACING)
        _kill_children()
        leftovers.remove_leftovers()
        with suppress(Exception):  # whatever cannot be said, the end comes
            lines = self.describe()
            if sys.stderr.isatty():  # a line of progress may stand there, and the cursor be hidden
                lines[0] = f"\r\x1b[2K\x1b[?25h{lines[0]}"
            with suppress(OSError):
                os.write(2, ("\n".join(lines) + "\n").encode(errors="replace"))
        os._exit(STOPPED)

    def describe(self) -> list[str]:
        """Say, line by line, what was stopped, what is known, and what is on disk; write the file
        of what is known where there is one."""
        now = f", at: {self.now}" if self.now else ""
        lines = [f"difffric: stopped by Ctrl-C after {time.monotonic() - self._began:.0f} s{now}"]
        parts = self.known.parts
        lines += [f"known so far, {what}: {part.words}" for what, part in parts.items()]
        if self.out is not None:
            if KEPT_ON_DISK not in parts:
                lines.append(f"{self.out} is as it was before")
            path = self._write_known()
            if path is not None:
                lines.append(f"written to {path}, which is no whole answer")
        return [make_printable(line) for line in lines]

    def _write_known(self) -> Path | None:
        answers = {w: p.answer for w, p in self.known.parts.items() if p.answer is not None}
        if not answers or self.out is None:
            return None
        # Here, as few commands are stopped.
        from difffric.atomic_files import write_whole
        from difffric.output_folder import to_json_types

        answer = {"partial": True, "command": self.name, "stopped_at": self.now, "known": answers}
        text = json.dumps(to_json_types(answer), indent=1, allow_nan=False) + "\n"
        path = name_partial(self.out)
        with suppress(Exception):  # said or not, what is known is printed
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, lambda file: file.write(text.encode()))
            return path
        return None


def name_partial(out: Path) -> Path:
    """Return the file beside a folder that holds what was known when a command was stopped."""
    whole = Path(os.path.abspath(out))
    return whole.with_name(f"{whole.name}.partial.json")


def _kill_children() -> None:
    """Kill the processes that this one started by `multiprocessing`: they have nothing to tidy."""
    module = sys.modules.get("multiprocessing")
    for child in module.active_children() if module else ():
        with suppress(Exception):
            child.kill()


COMMAND = RunningCommand()
"""The one of this process."""
