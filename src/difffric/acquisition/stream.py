"""The card's FIFOs on their way into a file: a push at a time, and no sample lost unnoticed."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.acquisition.card import (
    VOLTS_PER_WORD,
    CardError,
    CardSession,
    FifoReader,
    format_card_error,
)
from difffric.acquisition.hardware_check import Watch
from difffric.acquisition.push import Acquired, Command
from difffric.errors import DiskError
from difffric.measurements.files.tdms_writer import RecordingWriter, Waveform
from difffric.measurements.recordings import Channel, Recording
from difffric.units import to_mm, to_mm_min

SEGMENT = 100_000
"""Samples written at a time; the last ones of a push are fewer."""
_BLOCK = 4e-3  # [s] of samples that are waited for at a time
_PAUSE = 2e-3  # [s] before the next look at FIFOs that were found empty
_SEEN_BY_CARD = (
    "peak_word", "released", "release_sample", "release_count", "encoder_error",
    "saturated_samples", "overflow",
)  # fmt: skip


class CardStream:
    """The FIFOs of a session, read into a file.

    `resolution` is the encoder's step [m]; a card that sends nothing for `timeout` [s] within a
    push has failed.
    """

    def __init__(
        self, session: CardSession, writer: RecordingWriter, resolution: float, timeout: float
    ):
        self._session, self._writer = session, writer
        self._resolution, self._timeout = resolution, timeout
        self._force, self._position = (
            FifoReader(session.fifos[name]) for name in ("force", "position")
        )
        self._readers = self._force, self._position
        self._buffers = _Buffers()

    def open(self, depth: int, quiet: float, rest: float) -> None:
        """Bring the card into the state in which it takes pushes.

        Each FIFO may hold `depth` words on the host; `quiet` [s] before a push and `rest` [s]
        after it are recorded.
        """
        self._session.reset()
        depth = min(reader.fifo.configure(depth) for reader in self._readers)
        self._session.run()
        for reader in self._readers:
            reader.fifo.start()
        self._rate = self._read("sample_rate_Hz")
        self._quiet = math.ceil(quiet * self._rate)
        self._write("quiet_samples", self._quiet)
        self._write("rest_samples", math.ceil(rest * self._rate))
        self._block = max(min(math.ceil(_BLOCK * self._rate), depth // 2, SEGMENT), 1)
        self._wait_ms = math.ceil(1.2e3 * self._block / self._rate)
        low = self._read("contact_threshold_word")
        self._contact = low, low + self._read("contact_hysteresis_word")

    def close(self) -> None:
        """Stop the FIFOs, as far as the card still answers."""
        for reader in self._readers:
            with suppress(RuntimeError):
                reader.fifo.stop()

    def record(
        self, name: str, order: int, command: Command, keep: bool
    ) -> tuple[Acquired, Recording]:
        """Make one push; what was recorded, and the recording itself, which has samples where
        they are to be kept."""
        dt, start = 1.0 / self._rate, (0.5 - self._quiet) / self._rate
        channels = {
            "force": Waveform("V", dt, start, slope=VOLTS_PER_WORD),
            "position": Waveform("m", dt, start, slope=self._resolution),
        }
        begin = name, channels, _list_properties(order, command)
        push = _PushWriter(self._writer, begin, Watch(*self._contact), keep)
        self._write("velocity_nm_per_s", round(command.velocity * 1e9))
        self._write("stroke_nm", round(command.stroke * 1e9))
        self._write("start", False)  # a push begins as it becomes true
        self._write("start", True)
        began = time.monotonic()
        ended = self._drain_or_fail(name, push)
        seen = {register: self._read(register) for register in _SEEN_BY_CARD}
        lost = self._read("samples") - push.n
        if push.n:
            self._writer.end(lost)
        acquired = Acquired(
            name, command, self._rate, push.n, lost, push.watch.compare(seen, lost),
            push.watch.find_fault(seen), began, ended,
        )  # fmt: skip
        recording = Recording(
            command.velocity,
            Channel.of(VOLTS_PER_WORD * push.join_words(0), dt, start, "V"),
            Channel.of(self._resolution * push.join_words(1), dt, start, "m"),
            mass=command.mass,
            stroke=command.stroke,
            condition=command.condition,
            order=order,
            name=name,
        )
        return acquired, recording

    def _drain_or_fail(self, name: str, push: _PushWriter) -> float:
        """As `_drain`; where disk or card fails, the message says what is in the file."""
        try:
            return self._drain(name, push)
        except DiskError as error:
            taken = "an unknown number"
            with suppress(RuntimeError):
                taken = str(self._read("samples"))
            words = f"the file has {push.n} samples of it, of {taken} taken"
            raise DiskError(f"{name}: {error}; {words}") from None
        except RuntimeError as error:  # which every status of nifpga is
            raise CardError(
                f"{name}: the card failed: {format_card_error(error)}; the file has {push.n} "
                "samples of it, and what else was taken is lost"
            ) from None

    def _drain(self, name: str, push: _PushWriter) -> float:
        """All samples of a push up to the first one lost into the file; when it ended."""
        buffers, arrived = self._buffers, _Arrivals(time.monotonic())
        try:
            while True:
                if n := self._fetch(name, arrived):
                    self._take(n, push, arrived)
                    continue
                now, before = time.monotonic(), arrived.taken
                arrived.taken = self._read("samples")
                if arrived.ended and arrived.came >= self._read("streamed"):
                    break
                if arrived.taken != before:  # the card goes on, with its FIFOs closed
                    arrived.heard = now
                elif now - arrived.heard > self._timeout:
                    sent = self._read("streamed")
                    raise CardError(
                        f"{name}: {arrived.came} samples came of {sent} sent, then none for "
                        f"{self._timeout:g} s"
                    )
                time.sleep(_PAUSE)
        except DiskError:
            raise
        except BaseException:  # what came before a failure belongs in the file too
            push.add(buffers.force[: arrived.at], buffers.count[: arrived.at])
            raise
        push.add(buffers.force[: arrived.at], buffers.count[: arrived.at])
        return min(now, arrived.block_came + arrived.since / self._rate)

    def _fetch(self, name: str, arrived: _Arrivals) -> int:
        """The next samples into the buffers. How many; 0: there are none now."""
        n = self._fill(name, arrived.at, not arrived.ended)
        if n == 0:  # no block in time: the push's end, or nothing comes
            arrived.ended = arrived.ended or self._read("done")  # what the FIFOs then hold is all
            for reader in self._readers:
                reader.look()
            n = self._fill(name, arrived.at, False)
        return n

    def _take(self, n: int, push: _PushWriter, arrived: _Arrivals) -> None:
        """Account for n samples that came into the buffers, and write the buffers when full."""
        buffers = self._buffers
        good = buffers.split(arrived.at, arrived.at + n, arrived.came)
        arrived.came += n
        arrived.at += good if arrived.whole else 0
        arrived.whole = arrived.whole and good == n
        if arrived.at == SEGMENT:
            push.add(buffers.force, buffers.count)
            arrived.at = 0
        arrived.heard, arrived.since = time.monotonic(), arrived.since + n
        if not arrived.ended:
            arrived.block_came, arrived.since = arrived.heard, 0

    def _fill(self, name: str, at: int, wait: bool) -> int:
        """Samples into the buffers from `at` on: all that are known to be there, and at least a
        block where it is waited for. How many; 0: none, or no block in time."""
        n, timeout_ms = min(reader.waiting for reader in self._readers), 0
        if wait and n < self._block:
            n, timeout_ms = self._block, self._wait_ms
        n = min(n, SEGMENT - at)
        if n == 0 or not self._force.fill(self._buffers.force[at : at + n], timeout_ms):
            return 0
        # Both words of a sample go into their FIFOs together.
        patience_ms = round(1e3 * self._timeout)
        if not self._position.fill(self._buffers.position[at : at + n], patience_ms):
            raise CardError(f"{name}: {n} force words came without their positions")
        return n

    def _read(self, register: str) -> Any:
        return self._session.registers[register].read()

    def _write(self, register: str, data: Any) -> None:
        self._session.registers[register].write(data)


def _list_properties(order: int, command: Command) -> dict[str, Any]:
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


@dataclass
class _Arrivals:
    """What has arrived of a push so far."""

    heard: float
    """when the card last gave a sign of life [s]"""
    at: int = 0
    """good samples in the buffers"""
    came: int = 0
    """samples that came, good or not"""
    whole: bool = True
    """whether none was lost so far"""
    ended: bool = False
    """whether the card says that the push is over"""
    taken: int = 0
    """samples that the card says it has taken"""
    block_came: float = math.nan
    """when the last block came before the push was over [s]"""
    since: int = 0
    """samples that came after that block"""

    def __post_init__(self):
        self.block_came = self.heard


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


class _PushWriter:
    """A push on its way into the file, in segments. Its first one brings the group there, as a
    group without samples is no recording."""

    def __init__(self, writer: RecordingWriter, begin: tuple, watch: Watch, keep: bool):
        self.n = 0
        """samples in the file"""
        self.watch = watch
        self._writer, self._begin = writer, begin
        self._keep, self._kept = keep, []

    def add(self, force: NDArray[np.int16], count: NDArray[np.int32]) -> None:
        """Write a segment: force words (n,) and encoder counts (n,)."""
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

    def join_words(self, which: int) -> NDArray:
        """All force words (0) or encoder counts (1), where they were to be kept."""
        return np.concatenate([np.zeros(0), *(parts[which] for parts in self._kept)])
