"""How long work tells how far it has come: any function of a text and a share."""

from __future__ import annotations

from typing import Protocol


class Tell(Protocol):
    """Is called with what is being done and the share of the whole that is done, 0 to 1."""

    def __call__(self, what: str, share: float, /) -> object: ...


def silent(what: str, share: float, /) -> None:
    """Tell nobody: the default of everything that takes a `Tell`."""
