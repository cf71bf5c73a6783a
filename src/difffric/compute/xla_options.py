"""Large programs compiled in half the time, for a run time up to twice as long."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import jax

from difffric.compute.program_cache import kept

_OPTIONS: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False}
"""XLA's newer code generator for fused loops takes most of the time that a large program needs
to compile, and 0.5 GB."""


def soon_compiled(function: Callable) -> kept:
    """`kept`, for a program whose first call counts more than each of the next.

    With a jaxlib that does not know the option it is `kept` alone.
    """
    return kept(function, lambda: known_options(_OPTIONS))


def known_options(options: dict[str, Any]) -> dict[str, Any] | None:
    """The compiler's options, or none where this jaxlib does not know them."""
    return dict(options) if _are_known(tuple(options.items())) else None


@cache
def _are_known(options: tuple[tuple[str, Any], ...]) -> bool:
    # Asked at the first use: at import there may be no device yet.
    try:
        jax.jit(lambda x: x, compiler_options=dict(options)).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True
