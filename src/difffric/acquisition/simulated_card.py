"""A card in place of hardware: the registers and FIFOs of `card`, fed by simulated pushes.

Its clock is its own and goes on while the host looks or waits: a recording is the same on every
machine, and made faster than real time.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from difffric.acquisition.card import (
    METRES_PER_COUNT,
    VOLTS_PER_WORD,
    position_words,
    split_position,
)
from difffric.acquisition.card_registers import AT_RESET, INDICATORS
from difffric.errors import InputError

Evaluate = Callable[[NDArray], tuple[NDArray, NDArray]]
"""times (n,) [s] to force (n,) [N] and position (n,) [m]"""

_BLOCK = 8192  # times asked for at once: always so many, so that a compiled trace is compiled once
_DEFAULT_DEPTH = 16384  # what a FIFO holds on the host unless it is configured

ReadValues = namedtuple("ReadValues", ["data", "elements_remaining"])


class SimulatedCard:
    """What `acquire` needs of a `nifpga.Session`, fed by `trace(velocity, stroke)`: the push at
    any time, and when part and pusher are at rest for good [s].

    Force is sampled at `rate` [Hz] with white noise of `noise_force` [N], clipped at the sensor's
    `range` [N], scaled by its `sensitivity` [V/N], and digitised over 16 bits. The position, with
    white noise of `noise_position` [m], is counted in steps of `resolution` [m]. The n-th push's
    noise follows from `seed` and n alone.

    A read waits, for at most `timeout_ms` of the card's time; each look (a register read, a read
    of no elements) takes `look` [s] of it, so a host may be too slow for its FIFOs' depth.

    Raises `InputError` for a rate that is not a whole number > 0.
    """

    def __init__(
        self,
        trace: Callable[[float, float], tuple[Evaluate, float]],
        *,
        rate: float = 200e3,
        sensitivity: float = 11.2e-3,
        range: float = 446.0,
        noise_force: float = 0.5,
        resolution: float = METRES_PER_COUNT,
        noise_position: float = 0.3e-6,
        seed: int = 0,
        look: float = 1e-3,
    ):
        if not (1 <= rate < 2**32 and rate == int(rate)):
            raise InputError(f"rate: expected a whole number of samples a second, got {rate:g}")
        self.trace, self.rate, self.seed, self.look = trace, int(rate), seed, look
        self.words_per_newton, self.range = sensitivity / VOLTS_PER_WORD, range
        self.resolution = resolution
        self.noise_force, self.noise_position = noise_force, noise_position
        self.fifos = {
            "force": _SimulatedFifo(self, np.int16),
            "position": _SimulatedFifo(self, np.uint64),
        }
        self.state: dict[str, int] = {}
        self.registers = {name: _SimulatedRegister(self, name) for name in AT_RESET}
        self.pushes = 0
        self.reset()

    def __enter__(self) -> SimulatedCard:
        return self

    def __exit__(self, exception_type, exception_val, trace) -> None:
        self.reset()

    def run(self, wait_until_done: bool = False) -> None:
        """As the real one; there is nothing to run."""

    def reset(self) -> None:
        """Ends the push, stops the FIFOs and puts the registers back."""
        for fifo in self.fifos.values():
            fifo.stop()
        self.state |= AT_RESET
        self._clear()
        self._words = np.zeros(0, np.int16), np.zeros(0, np.uint64)

    def begin(self) -> None:
        """Start the push that the registers say."""
        self._clear()
        self._words = self._digitise()
        self.pushes += 1

    def _clear(self) -> None:
        self.state |= {name: AT_RESET[name] for name in INDICATORS} | {"sample_rate_Hz": self.rate}
        self._time = 0.0  # of the card's clock since the push's first sample
        self._contact = False

    def _digitise(self) -> tuple[NDArray, NDArray]:
        """The words of both FIFOs for the whole push."""
        state = self.state
        evaluate, end = self.trace(state["velocity_nm_per_s"] * 1e-9, state["stroke_nm"] * 1e-9)
        quiet = state["quiet_samples"]
        n = quiet + int(np.ceil(end * self.rate)) + state["rest_samples"]
        random = np.random.default_rng([self.seed, self.pushes])
        words, counts = np.empty(n, np.int16), np.empty(n, np.int64)
        for lo in range(0, n, _BLOCK):
            part = slice(lo, min(lo + _BLOCK, n))
            # Half a sample off, so that none falls on the force's jump at t = 0.
            force, position = evaluate((np.arange(lo, lo + _BLOCK) - quiet + 0.5) / self.rate)
            force = force + self.noise_force * random.standard_normal(_BLOCK)
            position = position + self.noise_position * random.standard_normal(_BLOCK)
            volts = np.rint(np.clip(force, -self.range, self.range) * self.words_per_newton)
            words[part] = np.clip(volts, -(2**15), 2**15 - 1)[: part.stop - lo]
            counts[part] = np.rint(position / self.resolution)[: part.stop - lo]
        return words, position_words(np.arange(n), counts)

    def wait(self, seconds: float) -> None:
        """Let the clock go on: samples are taken, and their words go into the FIFOs."""
        words, total = self._words, len(self._words[0])
        self._time += seconds
        taken, state = self.state["samples"], self.state
        now = min(int(self._time * self.rate), total)
        room = min(fifo.room for fifo in self.fifos.values())
        passed = 0 if state["overflow"] else min(now - taken, room)
        for fifo, source in zip(self.fifos.values(), words, strict=True):
            fifo.held = np.concatenate([fifo.held, source[taken : taken + passed]])
        state["overflow"] = state["overflow"] or taken + passed < now
        self._watch(taken, now)
        state |= {"samples": now, "streamed": state["streamed"] + passed}
        state["done"] = now == total > 0

    def _watch(self, taken: int, now: int) -> None:
        """What the card itself sees of the samples from `taken` to `now`."""
        force, state = self._words[0][taken:now], self.state
        if not len(force):
            return
        state["peak_word"] = max(state["peak_word"], int(force.max()))
        at_an_end = (force == -(2**15)) | (force == 2**15 - 1)
        state["saturated_samples"] += int(at_an_end.sum())
        low = state["contact_threshold_word"]
        made, below = force >= low + state["contact_hysteresis_word"], force < low
        crossings = np.flatnonzero(made | below)
        if not len(crossings):
            return
        contact = made[crossings]
        losses = crossings[~contact & np.concatenate([[self._contact], contact[:-1]])]
        self._contact = bool(contact[-1])
        if len(losses):
            sample = taken + int(losses[-1])
            _, count = split_position(self._words[1][sample])
            state |= {"released": True, "release_sample": sample, "release_count": int(count)}
        if self._contact:
            state["released"] = False


class _SimulatedRegister:
    def __init__(self, card: SimulatedCard, name: str):
        self._card, self._name = card, name

    def read(self):
        self._card.wait(self._card.look)
        return self._card.state[self._name]

    def write(self, data) -> None:
        if self._name != "start":
            self._card.state[self._name] = data
        elif data:
            self._card.begin()


class _SimulatedFifo:
    def __init__(self, card: SimulatedCard, kind: type):
        self._card = card
        self._depth, self._started = _DEFAULT_DEPTH, False
        self.held: NDArray = np.zeros(0, kind)

    @property
    def room(self) -> int:
        return self._depth - len(self.held) if self._started else 0

    def configure(self, requested_depth: int) -> int:
        self.stop()
        self._depth = requested_depth
        return self._depth

    def start(self) -> None:
        self._started = True

    def stop(self) -> None:
        self._started, self.held = False, self.held[:0]

    def read(self, number_of_elements: int, timeout_ms: int = 0) -> ReadValues:
        data = np.empty(number_of_elements, self.held.dtype)
        remaining = self.read_into(data, timeout_ms)
        return ReadValues(data.tolist(), remaining)

    def read_into(self, buffer: NDArray, timeout_ms: int = 0) -> int:
        """Fill the buffer; how many elements remain. Waits as `read` does."""
        number_of_elements = len(buffer)
        self._started = True
        waited, limit = 0.0, timeout_ms * 1e-3
        if number_of_elements == 0:
            self._card.wait(self._card.look)
        while len(self.held) < number_of_elements:
            if waited >= limit:
                from nifpga import status  # for the class of the real one's error

                asked = (number_of_elements, timeout_ms)
                timed_out = vars(status)["FifoTimeoutError"]  # made by nifpga when imported
                raise timed_out("Read", ["number_of_elements", "timeout_ms"], asked)
            step = min(self._card.look, limit - waited)
            self._card.wait(step)
            waited += step
        buffer[:], self.held = self.held[:number_of_elements], self.held[number_of_elements:]
        return len(self.held)
