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


def require_float64() -> None:
    """Raise `InputError` unless JAX computes in 64 bits.

    Event times and the derivatives through them lose all meaning in 32 bits.
    """
    import jax  # here, as errors are told where no JAX is needed

    if not jax.config.read("jax_enable_x64"):
        raise InputError(
            "difffric needs 64-bit floats and JAX is in 32-bit mode: call "
            'jax.config.update("jax_enable_x64", True) before the first computation, '
            "or set JAX_ENABLE_X64=1"
        )
