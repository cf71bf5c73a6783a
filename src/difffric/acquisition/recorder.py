"""Recording pushes: from a session with the card into a .tdms file, counting what was lost."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.acquisition.card import (
    METRES_PER_COUNT,
    VOLTS_PER_WORD,
    CardError,
    CardSession,
    FifoReader,
    card_words,
    check_interface,
)
from difffric.acquisition.hardware_check import Hardware, Watch
from difffric.errors import DifffricError, DiskError, InputError
from difffric.measurements.files.tdms_writer import RecordingWriter, Waveform
from difffric.measurements.recordings import Channel, Recording
from difffric.units import to_mm, to_mm_min

SEGMENT = 100_000
"""Samples written at a time; the last ones of a push are fewer."""
_BLOCK = 4e-3  # [s] of samples that are waited for at a time
_PAUSE = 2e-3  # [s] before the next look at FIFOs that were found empty
_TOLD = (
    "peak_word", "released", "release_sample", "release_count", "encoder_error",
    "saturated_samples", "overflow",
)  # fmt: skip


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
    hardware: Hardware
    """what the card itself saw"""
    fault: str = ""
    """why the samples are not to be trusted; empty where they are"""
    began: float = field(default=math.nan, compare=False)
    """when the push was started, by the host's clock [s]"""
    ended: float = field(default=math.nan, compare=False)
    """when its last sample was taken"""


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
    all that are missing are counted. What is wrong with a push (`fault`) or with what the card
    says of it (`hardware.problems`) is told, and the next push made.

    The session is open, and stays so. Raises `InputError` where it lacks a register or FIFO and
    where `path` exists or cannot be made; `CardError` where the card fails, or sends nothing
    for `timeout` [s] within a push, and `DiskError` where the disk takes no more: what came until
    then is in the file.
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
            for words in troubles(acquired):
                if tell:
                    tell(f"{name}: {words}", (i + 1) / len(pushes))
            if on_push:
                on_push(acquired, recording)
    except DifffricError as error:
        whole = f"; whole pushes in {path}: {len(found)}" if found else ""
        raise type(error)(f"{error}{whole}") from None
    finally:
        stream.close()
        writer.close()
        if os.path.getsize(path) == 0:  # an empty file is no recording
            writer.discard()
    return found


def troubles(push: Acquired) -> list[str]:
    """What is wrong with a recorded push, a line each."""
    said = [f"{push.lost} samples lost" if push.lost else "", push.fault]
    return [*filter(None, said), *push.hardware.problems]


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


class _Buffers:
    """Room for a segment, filled again and again."""

    def __init__(self):
        self.force = np.empty(SEGMENT, np.int16)
        self.position = np.empty(SEGMENT, np.uint64)
        self.count = np.empty(SEGMENT, np.int32)
        self._number = np.empty(SEGMENT, np.uint64)
        self._due = np.arange(SEGMENT, dtype=np.uint64)

    def split(self, lo: int, hi: int, number: int) -> int:
        """The counts of the position words lo <= i < hi, and how many of these are numbered as
        they should, from `number` on."""
        words, numbers = self.position[lo:hi], self._number[lo:hi]
        np.copyto(self.count[lo:hi].view(np.uint32), words, casting="unsafe")
        np.right_shift(words, np.uint64(32), out=numbers)
        numbers -= self._due[: hi - lo]
        good = numbers == np.uint64(number)
        return hi - lo if good.all() else int(np.argmin(good))


class _Group:
    """A push on its way into the file, in segments. Its first one brings the group there, as a
    group without samples is no recording."""

    def __init__(self, writer: RecordingWriter, begin: tuple, watch: Watch, keep: bool):
        self.n = 0
        self.watch = watch
        self._writer, self._begin = writer, begin
        self._keep, self._kept = keep, []

    def add(self, force: NDArray[np.int16], count: NDArray[np.int32]) -> None:
        if not len(force):
            return
        if self.n == 0:
            name, channels, properties = self._begin
            self._writer.begin(name, channels, **properties)
        self._writer.append(force=force, position=count)
        self.n += len(force)
        self.watch.add(force, count)
        if self._keep:
            self._kept.append((force.copy(), count.copy()))

    def kept(self, which: int) -> NDArray:
        """All force words (0) or encoder counts (1), where they were to be kept."""
        return np.concatenate([np.zeros(0), *(parts[which] for parts in self._kept)])


class _Stream:
    """The session's FIFOs on their way into a file."""

    def __init__(self, session: CardSession, writer: RecordingWriter, resolution, timeout):
        self.session, self.writer = session, writer
        self.resolution, self.timeout = resolution, timeout
        self.force, self.position = (FifoReader(session.fifos[x]) for x in ("force", "position"))
        self.readers = self.force, self.position
        self.buffers = _Buffers()

    def open(self, depth: int, quiet: float, rest: float) -> None:
        """Bring the card into the state in which it takes pushes."""
        self.session.reset()
        depth = min(reader.fifo.configure(depth) for reader in self.readers)
        self.session.run()
        for reader in self.readers:
            reader.fifo.start()
        self.rate = self._read("sample_rate_Hz")
        self.quiet = math.ceil(quiet * self.rate)
        self._write("quiet_samples", self.quiet)
        self._write("rest_samples", math.ceil(rest * self.rate))
        self.block = max(min(math.ceil(_BLOCK * self.rate), depth // 2, SEGMENT), 1)
        self.wait_ms = math.ceil(1.2e3 * self.block / self.rate)
        low = self._read("contact_threshold_word")
        self.contact = low, low + self._read("contact_hysteresis_word")

    def close(self) -> None:
        """Stop the FIFOs, as far as the card still answers."""
        for reader in self.readers:
            with suppress(RuntimeError):
                reader.fifo.stop()

    def push(self, name: str, order: int, command: Command, keep: bool):
        """Make one push; what was recorded, and the recording itself where it is to be kept."""
        dt, start = 1.0 / self.rate, (0.5 - self.quiet) / self.rate
        channels = {
            "force": Waveform("V", dt, start, slope=VOLTS_PER_WORD),
            "position": Waveform("m", dt, start, slope=self.resolution),
        }
        begin = name, channels, _properties(order, command)
        group = _Group(self.writer, begin, Watch(*self.contact), keep)
        self._write("velocity_nm_per_s", round(command.velocity * 1e9))
        self._write("stroke_nm", round(command.stroke * 1e9))
        self._write("start", False)  # a push begins as it becomes true
        self._write("start", True)
        began = time.monotonic()
        try:
            ended = self._drain(name, group)
        except DiskError as error:
            taken = "an unknown number"
            with suppress(RuntimeError):
                taken = str(self._read("samples"))
            words = f"the file has {group.n} samples of it, of {taken} taken"
            raise DiskError(f"{name}: {error}; {words}") from None
        except RuntimeError as error:  # which every status of nifpga is
            raise CardError(
                f"{name}: the card failed: {card_words(error)}; the file has {group.n} samples of "
                "it, and what else was taken is lost"
            ) from None
        says = {register: self._read(register) for register in _TOLD}
        lost = self._read("samples") - group.n
        if group.n:
            self.writer.end(lost)
        acquired = Acquired(
            name, command, self.rate, group.n, lost, group.watch.hardware(says, lost),
            group.watch.fault(says), began, ended,
        )  # fmt: skip
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
        return acquired, recording

    def _drain(self, name: str, group: _Group) -> float:
        """All samples of a push up to the first one lost into the file; when it ended."""
        buffers, at = self.buffers, 0  # samples in the buffers
        came, whole, ended, taken = 0, True, False, 0
        heard = block_came = time.monotonic()
        since = 0  # samples after that block
        try:
            while True:
                n = self._fill(name, at, not ended)
                if n == 0:  # no block in time: the push's end, or nothing comes
                    ended = ended or self._read("done")  # what the FIFOs then hold is all
                    for reader in self.readers:
                        reader.look()
                    n = self._fill(name, at, False)
                if n:
                    good = buffers.split(at, at + n, came)
                    came += n
                    at += good if whole else 0
                    whole = whole and good == n
                    if at == SEGMENT:
                        group.add(buffers.force, buffers.count)
                        at = 0
                    heard, since = time.monotonic(), since + n
                    if not ended:
                        block_came, since = heard, 0
                    continue
                now, before, taken = time.monotonic(), taken, self._read("samples")
                if ended and came >= self._read("streamed"):
                    break
                if taken != before:  # the card goes on, with its FIFOs closed
                    heard = now
                elif now - heard > self.timeout:
                    sent = self._read("streamed")
                    raise CardError(
                        f"{name}: {came} samples came of {sent} sent, then none for "
                        f"{self.timeout:g} s"
                    )
                time.sleep(_PAUSE)
        except DiskError:
            raise
        except BaseException:  # what came before a failure belongs in the file too
            group.add(buffers.force[:at], buffers.count[:at])
            raise
        group.add(buffers.force[:at], buffers.count[:at])
        return min(now, block_came + since / self.rate)

    def _fill(self, name: str, at: int, wait: bool) -> int:
        """Samples into the buffers from `at` on: all that are known to be there, and at least a
        block where it is waited for. How many; 0: none, or no block in time."""
        n, timeout_ms = min(reader.waiting for reader in self.readers), 0
        if wait and n < self.block:
            n, timeout_ms = self.block, self.wait_ms
        n = min(n, SEGMENT - at)
        if n == 0 or not self.force.fill(self.buffers.force[at : at + n], timeout_ms):
            return 0
        # Both words of a sample go into their FIFOs together.
        if not self.position.fill(self.buffers.position[at : at + n], round(1e3 * self.timeout)):
            raise CardError(f"{name}: {n} force words came without their positions")
        return n

    def _read(self, register: str):
        return self.session.registers[register].read()

    def _write(self, register: str, data) -> None:
        self.session.registers[register].write(data)
