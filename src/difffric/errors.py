"""What can go wrong, said in one line: what, where, what was expected."""

from __future__ import annotations


class DifffricError(Exception):
    """Base class of the errors this library raises on purpose."""


class InputError(DifffricError, ValueError):
    """The input cannot be used (the command line's exit status 2)."""


class NumericalError(DifffricError, ArithmeticError):
    """The input is fine and still there is no answer; the message says why."""


class DiskError(DifffricError):
    """What was recorded cannot be written any more; the message says what is in the file."""
