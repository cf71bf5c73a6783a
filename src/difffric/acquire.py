"""Recording pushes: from a session with the card into a .tdms file, counting what was lost."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.card import (
    METRES_PER_COUNT,
    VOLTS_PER_WORD,
    CardError,
    CardSession,
    card_words,
    check_interface,
    split_position,
)
from difffric.errors import DifffricError, InputError
from difffric.recordings import Channel, Recording
from difffric.tdms_writer import RecordingWriter, Waveform
from difffric.units import to_mm, to_mm_min

SEGMENT = 100_000
"""Samples written at a time; the last ones of a push are fewer."""
_PAUSE = 2e-3  # [s] before the next look at FIFOs that were found empty


@dataclass(frozen=True)
class Command:
    """One push to make. Raises `InputError` for what the card's registers cannot hold."""

    velocity: float
    """[m/s]"""
    stroke: float
    """[m]"""
    mass: float = math.nan
    """[kg]; NaN: not said"""
    condition: str = ""

    def __post_init__(self):
        for name, unit in (("velocity", "m/s"), ("stroke", "m")):
            value = getattr(self, name)
            if not 1 <= value * 1e9 < 2**32:
                raise InputError(f"{name}: expected 1e-9 to 4.29 {unit}, got {value:g}")


@dataclass(frozen=True)
class Acquired:
    """What was recorded of one push."""

    name: str
    """of the file's group"""
    command: Command
    rate: float
    """[Hz]"""
    samples: int
    """in the file: all up to the first one lost"""
    lost: int
    """taken by the card and not in the file"""


def acquire(
    session: CardSession,
    pushes: Sequence[Command],
    path: str | os.PathLike,
    *,
    on_push: Callable[[Acquired, Recording], None] | None = None,
    tell: Callable[[str, float], None] | None = None,
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
    all that are missing are counted.

    The session is open, and stays so. Raises `InputError` where it lacks a register or FIFO and
    where `path` exists or cannot be written; `CardError` where the card fails, or sends nothing
    for `timeout` [s] within a push: what came until then is in the file.
    """
    if not pushes:
        raise InputError("no pushes to make: at least one is needed")
    check_interface(session)
    found: list[Acquired] = []
    writer = RecordingWriter(path)
    stream = _Stream(session, writer, resolution, timeout)
    try:
        with _card_failures("starting"):
            stream.open(depth, quiet, rest)
        for i, command in enumerate(pushes):
            name = f"push_{i + 1:04d}"
            if tell:
                tell(f"push {i + 1} of {len(pushes)}", i / len(pushes))
            with _card_failures(name):
                acquired, recording = stream.push(name, i + 1, command, on_push is not None)
            found.append(acquired)
            if tell and acquired.lost:
                tell(f"{name}: {acquired.lost} samples lost", (i + 1) / len(pushes))
            if on_push:
                on_push(acquired, recording)
    except DifffricError as error:
        whole = f"; whole pushes in {path}: {len(found)}" if found else ""
        raise type(error)(f"{error}{whole}") from None
    finally:
        stream.close()
        writer.close()
        if os.path.getsize(path) == 0:  # an empty file is no recording
            os.unlink(path)
    return found


@contextmanager
def _card_failures(where: str) -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:  # which every status of nifpga is
        raise CardError(f"{where}: the card failed: {card_words(error)}") from None


def _properties(order: int, command: Command) -> dict[str, Any]:
    """A push's properties in the file."""

    def tidy(number: float) -> float:  # a change of units leaves a rounding error
        return float(f"{number:.12g}")

    return {
        "velocity_mm_min": tidy(to_mm_min(command.velocity)),
        "stroke_mm": tidy(to_mm(command.stroke)),
        "mass_kg": None if math.isnan(command.mass) else command.mass,
        "condition": command.condition or None,
        "order": order,
    }


class _Group:
    """A push on its way into the file, in segments. Its first one brings the group there, as a
    group without samples is no recording."""

    def __init__(self, writer: RecordingWriter, name: str, channels, properties, keep: bool):
        self.n = 0
        self._writer, self._begin = writer, (name, channels, properties)
        self._pending: list[tuple[NDArray, NDArray]] = []
        self._keep, self._kept = keep, []

    def add(self, force: NDArray[np.int16], count: NDArray[np.int32]) -> None:
        self._pending.append((force, count))
        if sum(len(words) for words, _ in self._pending) >= SEGMENT:
            self.flush()

    def flush(self) -> None:
        if not self._pending:
            return
        force, count = (np.concatenate(parts) for parts in zip(*self._pending, strict=True))
        self._pending.clear()
        if self.n == 0:
            name, channels, properties = self._begin
            self._writer.begin(name, channels, **properties)
        self._writer.append(force=force, position=count)
        self.n += len(force)
        if self._keep:
            self._kept.append((force, count))

    def kept(self, which: int) -> NDArray:
        """All force words (0) or encoder counts (1), where they were to be kept."""
        return np.concatenate([np.zeros(0), *(parts[which] for parts in self._kept)])


class _Stream:
    """The session's FIFOs on their way into a file."""

    def __init__(self, session: CardSession, writer: RecordingWriter, resolution, timeout):
        self.session, self.writer = session, writer
        self.resolution, self.timeout = resolution, timeout
        self.force, self.position = session.fifos["force"], session.fifos["position"]

    def open(self, depth: int, quiet: float, rest: float) -> None:
        """Bring the card into the state in which it takes pushes."""
        self.session.reset()
        for fifo in (self.force, self.position):
            fifo.configure(depth)
        self.session.run()
        for fifo in (self.force, self.position):
            fifo.start()
        self.rate = self._read("sample_rate_Hz")
        self.quiet = math.ceil(quiet * self.rate)
        self._write("quiet_samples", self.quiet)
        self._write("rest_samples", math.ceil(rest * self.rate))

    def close(self) -> None:
        """Stop the FIFOs, as far as the card still answers."""
        for fifo in (self.force, self.position):
            with suppress(RuntimeError):
                fifo.stop()

    def push(self, name: str, order: int, command: Command, keep: bool):
        """Make one push; what was recorded, and the recording itself where it is to be kept."""
        dt, start = 1.0 / self.rate, (0.5 - self.quiet) / self.rate
        channels = {
            "force": Waveform("V", dt, start, slope=VOLTS_PER_WORD),
            "position": Waveform("m", dt, start, slope=self.resolution),
        }
        group = _Group(self.writer, name, channels, _properties(order, command), keep)
        self._write("velocity_nm_per_s", round(command.velocity * 1e9))
        self._write("stroke_nm", round(command.stroke * 1e9))
        self._write("start", True)
        try:
            for force, count in self._drained(name):
                group.add(force, count)
        finally:  # what came before a failure belongs in the file too
            group.flush()
        lost = self._read("samples") - group.n
        recording = Recording(
            command.velocity,
            Channel.of(VOLTS_PER_WORD * group.kept(0), dt, start, "V"),
            Channel.of(self.resolution * group.kept(1), dt, start, "m"),
            mass=command.mass,
            stroke=command.stroke,
            condition=command.condition,
            order=order,
            name=name,
        )
        return Acquired(name, command, self.rate, group.n, lost), recording

    def _drained(self, name: str) -> Iterator[tuple[NDArray, NDArray]]:
        """Force words and encoder counts as they come, up to the first sample lost."""
        came, whole = 0, True
        last = time.monotonic()
        while True:
            ended = self._read("done")  # before the FIFOs: what they then hold is all
            n = min(self._waiting(self.force), self._waiting(self.position), SEGMENT)
            if n:
                force = np.asarray(self.force.read(n, timeout_ms=0).data, np.int16)
                index, count = split_position(self.position.read(n, timeout_ms=0).data)
                good = index == came + np.arange(n)
                first_bad = n if good.all() else int(np.argmin(good))
                if whole and first_bad:
                    yield force[:first_bad], count[:first_bad]
                whole = whole and first_bad == n
                came += n
                last = time.monotonic()
            elif ended and came >= self._read("streamed"):
                return
            elif time.monotonic() - last > self.timeout:
                sent = self._read("streamed")
                raise CardError(
                    f"{name}: {came} samples came of {sent} sent, then none for {self.timeout:g} s"
                )
            else:
                time.sleep(_PAUSE)

    @staticmethod
    def _waiting(fifo) -> int:
        """How many words can be read at once: a read of none says so."""
        return fifo.read(0, timeout_ms=0).elements_remaining

    def _read(self, register: str):
        return self.session.registers[register].read()

    def _write(self, register: str, data) -> None:
        self.session.registers[register].write(data)
