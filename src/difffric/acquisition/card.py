"""The card as the host sees it: its registers, its FIFOs and their words, and a session with one.

The only file that knows nifpga, whose `Session` is the real session (`SimulatedCard` the other).
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
from collections.abc import Iterable, Mapping
from types import TracebackType
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.acquisition.card_registers import ADC_VOLTS, CONTROLS, FIFOS, INDICATORS
from difffric.acquisition.card_registers import METRES_PER_COUNT as METRES_PER_COUNT
from difffric.errors import DifffricError, InputError

VOLTS_PER_WORD = ADC_VOLTS / 2**15
"""the converter's range, either sign, over 16 bits"""


class CardError(DifffricError):
    """The card failed, not the input; the message says what was recorded."""


class Register(Protocol):
    """A control or an indicator."""

    def read(self) -> Any: ...

    def write(self, data: Any) -> None: ...


class Fifo(Protocol):
    """Words on their way from the card to the host."""

    def configure(self, requested_depth: int) -> int: ...

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def read(self, number_of_elements: int, timeout_ms: int = 0) -> Any:
        """`.data` and `.elements_remaining`. Waits for all the elements; on a time-out it raises
        and consumes none. One that has a `read_into(buffer, timeout_ms)`, which gives the number
        of elements remaining, is read by that instead."""
        ...


class CardSession(Protocol):
    """The part of `nifpga.Session` that is used."""

    @property
    def registers(self) -> Mapping[str, Register]: ...

    @property
    def fifos(self) -> Mapping[str, Fifo]: ...

    def __enter__(self) -> Any: ...

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception_val: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> Any: ...

    def reset(self) -> None: ...

    def run(self) -> None: ...


def position_words(index: ArrayLike, count: ArrayLike) -> NDArray[np.uint64]:
    """Sample numbers and encoder counts as the position FIFO holds them."""
    low = np.asarray(count, np.int64).astype(np.int32).view(np.uint32)
    return np.asarray(index, np.uint64) << np.uint64(32) | low.astype(np.uint64)


def split_position(words: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """(sample numbers, encoder counts) of the position FIFO's words."""
    whole = np.asarray(words, np.uint64)
    index = (whole >> np.uint64(32)).astype(np.int64)
    return index, whole.astype(np.uint32).view(np.int32)


class FifoReader:
    """A FIFO's words into arrays that are there already, and how many more wait.

    nifpga's own `read` makes a list of Python numbers, 2.5 million a second at most; the function
    of NI's driver that it binds fills memory.
    """

    def __init__(self, fifo: Fifo):
        from nifpga import status

        self.fifo, self.waiting = fifo, 0
        self._timed_out = vars(status)["FifoTimeoutError"]  # made by nifpga when imported
        self._into = getattr(fifo, "read_into", None) or self._by_driver

    def look(self) -> int:
        """How many words can be read at once: a read of none says so."""
        self.waiting = self.fifo.read(0, timeout_ms=0).elements_remaining
        return self.waiting

    def fill(self, buffer: NDArray, timeout_ms: int = 0) -> bool:
        """Whether all of the buffer could be filled in time; if not, no word is consumed."""
        try:
            self.waiting = self._into(buffer, timeout_ms)
        except self._timed_out:
            return False
        return True

    def _by_driver(self, buffer: NDArray, timeout_ms: int) -> int:
        fifo: Any = self.fifo
        rest = ctypes.c_size_t()
        words = buffer.ctypes.data_as(ctypes.POINTER(fifo._ctype_type))
        fifo._read_func(fifo._session, fifo._number, words, len(buffer), timeout_ms, rest)
        return rest.value


def check_interface(session: CardSession) -> None:
    """Raises `InputError` naming the registers and FIFOs that a session lacks."""

    def missing(wanted: Iterable[str], there: Mapping) -> str:
        return ", ".join(name for name in wanted if name not in there)

    lacks = [
        f"{kind} {names}"
        for kind, names in (
            ("registers", missing((*CONTROLS, *INDICATORS), session.registers)),
            ("FIFOs", missing(FIFOS, session.fifos)),
        )
        if names
    ]
    if lacks:
        raise InputError(f"the card's bitfile lacks {' and '.join(lacks)}")


def open_card(bitfile: str | os.PathLike | None, resource: str = "RIO0") -> CardSession:
    """A session with a card, opened and not yet running.

    Raises `InputError` where NI's driver, the bitfile or the card is not there.
    """
    if ctypes.util.find_library("NiFpga") is None:  # as nifpga looks for it, but before the bitfile
        raise InputError(
            "no card can be opened: NI's FPGA driver (the NiFpga library) is not installed; "
            "install NI R Series, or use --simulate SETUP"
        )
    if bitfile is None:
        raise InputError("no card can be opened: expected --bitfile FILE.lvbitx, got none")
    if not os.path.isfile(bitfile):
        raise InputError(f"{bitfile}: no such file")
    import nifpga

    try:
        return nifpga.Session(os.fspath(bitfile), resource, no_run=True)
    except nifpga.Status as status:
        raise InputError(
            f"{resource}: no card can be opened: {format_card_error(status)}"
        ) from None
    except Exception as error:  # the bitfile's parser raises whatever it meets
        what = format_card_error(error)
        raise InputError(f"{bitfile}: not a bitfile that nifpga can use: {what}") from None


def format_card_error(error: BaseException) -> str:
    """The first line of what a driver raised, without the arguments of its call."""
    first = (str(error).splitlines() or [""])[0].split(" with arguments")[0]
    return first or type(error).__name__
