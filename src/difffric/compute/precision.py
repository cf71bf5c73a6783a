"""The precision in which JAX computes."""

from __future__ import annotations

import jax

from difffric.errors import InputError


def require_float64() -> None:
    """Raise `InputError` unless JAX computes in 64 bits.

    Event times and the derivatives through them lose all meaning in 32 bits.
    """
    if not jax.config.read("jax_enable_x64"):
        raise InputError(
            "difffric needs 64-bit floats and JAX is in 32-bit mode: call "
            'jax.config.update("jax_enable_x64", True) before the first computation, '
            "or set JAX_ENABLE_X64=1"
        )
