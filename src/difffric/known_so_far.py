"""What long work knows before its end, kept for whoever ends it early.

Whoever may want it opens `keep_known`; what computes tells `tell_known`, which costs nothing where
nobody listens. What is told is no answer: the work that follows may replace it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

from difffric.number_text import format_values

KEPT_ON_DISK = "kept on disk"
"""The name of what is written already, and stays."""


@dataclass(frozen=True)
class Partial:
    """One thing that is known."""

    words: str
    """for a person, on one line"""
    answer: Mapping[str, Any] | Sequence[Any] | None
    """as a file holds it; None: it is not worth one"""


@dataclass
class KnownSoFar:
    """All that is known, by what it is: what is told again replaces what was told."""

    parts: dict[str, Partial] = field(default_factory=dict)


_KEPT: ContextVar[KnownSoFar | None] = ContextVar("known", default=None)


@contextmanager
def keep_known() -> Iterator[KnownSoFar]:
    """Yield what becomes known within."""
    known = KnownSoFar()
    token = _KEPT.set(known)
    try:
        yield known
    finally:
        _KEPT.reset(token)


def tell_known(
    what: str, words: str, answer: Mapping[str, Any] | Sequence[Any] | None = None
) -> None:
    """Tell whoever keeps it what is known by now: `words` for a person, and `answer`, plain data,
    where it is worth a file."""
    known = _KEPT.get()
    if known is not None:
        known.parts[what] = Partial(words, answer)


def tell_answer(what: str, answer: Mapping[str, float] | Sequence[str]) -> None:
    """Tell numbers by their names, or a list of names, that a person reads on one line."""
    is_named = isinstance(answer, Mapping)
    tell_known(what, format_values(answer) if is_named else ", ".join(answer), answer)
