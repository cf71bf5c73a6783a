"""How long work tells how far it has come: any function of a text and a share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol


class Tell(Protocol):
    """Is called with what is being done and the share of the whole that is done, 0 to 1."""

    def __call__(self, what: str, share: float, /) -> object: ...


def silent(what: str, share: float, /) -> None:
    """Tell nobody: the default of everything that takes a `Tell`."""


class Steps:
    """A piece of work in steps, each told with its number: `step 2 of 6: what`.

    `ends` has the share of the whole that is done at the end of each.
    """

    def __init__(self, tell: Tell, ends: Sequence[float]):
        self._tell, self._ends, self._number = tell, [0.0, *ends], 0

    def begin(self, what: str) -> Tell:
        """Begin the next step, and return whom its own parts are told, with their share of it."""
        self._number += 1
        place = f"step {self._number} of {len(self._ends) - 1}: "
        start, end = self._ends[self._number - 1 : self._number + 1]
        self._tell(place + what, start)

        def tell(part: str, share: float, /) -> None:
            self._tell(f"{place}{what}, {part}", start + (end - start) * share)

        return tell
