"""Recording pushes: a session with the card makes them, and a .tdms file takes what it samples."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from difffric.acquisition.card import (
    METRES_PER_COUNT,
    CardError,
    CardSession,
    check_interface,
    format_card_error,
)
from difffric.acquisition.push import Acquired, Command
from difffric.acquisition.stream import CardStream
from difffric.errors import DifffricError, InputError
from difffric.known_so_far import KEPT_ON_DISK, tell_known
from difffric.measurements.files.tdms_writer import RecordingWriter
from difffric.measurements.recordings import Recording
from difffric.progress import Tell, silent


def acquire(
    session: CardSession,
    pushes: Sequence[Command],
    path: str | os.PathLike,
    *,
    on_push: Callable[[Acquired, Recording], None] | None = None,
    tell: Tell | None = None,
    quiet: float = 0.02,
    rest: float = 0.03,
    resolution: float = METRES_PER_COUNT,
    depth: int = 1 << 20,
    timeout: float = 10.0,
) -> list[Acquired]:
    """Make the pushes and stream them into `path`, a .tdms with a group a push, force in volts.

    Each push is recorded from `quiet` [s] before it until `rest` [s] after it; `resolution` is the
    encoder's step [m], `depth` what each FIFO may hold on the host (5 s at 200 kHz). `on_push` is
    called after each push with what went into the file, `tell` with what goes on and the share
    done. A recording ends at its first lost sample, as later ones would stand at a wrong time;
    all that are missing are counted. What is wrong with a push (`fault`) or with what the card
    says of it (`hardware.problems`) goes to `tell`, and the next push is made.

    The session is open, and stays so. Raises `InputError` where it lacks a register or FIFO and
    where `path` exists or cannot be made; `CardError` where the card fails, or sends nothing
    for `timeout` [s] within a push, and `DiskError` where the disk takes no more: what came until
    then is in the file.
    """
    if not pushes:
        raise InputError("no pushes to make: at least one is needed")
    tell = tell or silent
    check_interface(session)
    made: list[Acquired] = []
    writer = RecordingWriter(path)
    stream = CardStream(session, writer, resolution, timeout)
    try:
        with _name_card_failures("starting"):
            stream.open(depth, quiet, rest)
        for i, command in enumerate(pushes):
            name = f"push_{i + 1:04d}"
            tell(f"push {i + 1} of {len(pushes)}", i / len(pushes))
            with _name_card_failures(name):
                acquired, recording = stream.record(name, i + 1, command, on_push is not None)
            made.append(acquired)
            tell_known(KEPT_ON_DISK, f"{path}: {len(made)} whole pushes")
            for words in acquired.troubles:
                tell(f"{name}: {words}", (i + 1) / len(pushes))
            if on_push:
                on_push(acquired, recording)
    except DifffricError as error:
        whole = f"; whole pushes in {path}: {len(made)}" if made else ""
        raise type(error)(f"{error}{whole}") from None
    finally:
        stream.close()
        writer.close()
        if os.path.getsize(path) == 0:  # an empty file is no recording
            writer.discard()
    return made


@contextmanager
def _name_card_failures(where: str) -> Iterator[None]:
    """Turn what nifpga raises, every status of which is a `RuntimeError`, into a `CardError`."""
    try:
        yield
    except RuntimeError as error:
        raise CardError(f"{where}: the card failed: {format_card_error(error)}") from None
