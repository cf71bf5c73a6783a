"""A whole computation as one native function, where XLA would make one of each of its loops.

XLA's CPU backend runs a program loop by loop, handing each to its thread pool: a closed-form push
has some 70, and starting one costs more than running it over a few hundred pushes. A computation
that it deems small it compiles as one function instead, which runs where it is called, loops and
all. XLA deems by the bytes that are touched; the same mark can be set from outside.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

import jax
from jax.experimental.xla_metadata import set_xla_metadata

_TESTED = jax.__version_info__ < (0, 11)
"""The mark is internal to XLA: where it has not been tried, programs are compiled as usual."""
_MARKS = {"xla_cpu_small_call": "true", "inlineable": "false"}
"""XLA's frontend attributes: `small_while_loop_hoisting_pass.cc`, `call_inliner.cc`."""


def in_one_piece(function: Callable) -> Callable:
    """`function` of arrays, for use within `jax.jit`: compiled as one native function on CPUs.

    It then runs on the thread that calls it, and no other. Only what XLA itself generates code
    for may be in it: no linear algebra. Where XLA does not know the mark it changes nothing but
    that the function is called, not inlined.
    """

    def unmarked(*args):
        with set_xla_metadata(**dict.fromkeys(_MARKS)):
            # XLA aborts where such a function leaves an argument unused: all are handed back.
            return function(*args), jax.lax.optimization_barrier(args)

    if not _TESTED:
        return function
    called = jax.jit(unmarked)

    @wraps(function)
    def marked(*args):
        with set_xla_metadata(**_MARKS):
            return jax.lax.optimization_barrier(called(*args))[0]

    return marked
