"""How XLA is asked to compile a program: sooner at the price of its speed, or as one function.

A large program compiles in a fraction of the time where an older code generator and fewer of
LLVM's passes are asked for; it then takes up to twice as long to run (`compile_soon`).

XLA's CPU backend runs a program loop by loop, and hands each loop to its thread pool: a closed-form
push has some 70, and to start one costs more than to run it over a few hundred pushes. A
computation that XLA deems small it compiles as one function instead, which runs where it is
called, loops and all. XLA deems by the bytes that are touched; the same mark can be set from
outside (`in_one_piece`).

Within a function XLA computes a value anew in every loop that needs it, all that leads to it
included, unless that is an operation it deems expensive: of a step of a push with every effect
sixty results each began with all twelve stages (`hold`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import Any

from difffric.compute.program_cache import CachedProgram, cache_program

_SOON: dict[str, Any] = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_backend_optimization_level": 1,
    "xla_cpu_prefer_vector_width": 512,
}
"""XLA's newer code generator for fused loops takes most of the time that a large program needs
to compile, and 0.5 GB. LLVM's third level took 118 s for a program of long functions (a table's
pushes without derivatives), and the first takes 15 s; what either makes runs within a tenth as
fast. Vectors of 512 bits, which XLA does not use unasked, make a step of many pushes a fifth
faster where the processor has them."""
_QUICKLY: dict[str, Any] = {
    **_SOON,
    "xla_backend_optimization_level": 0,
    "xla_cpu_parallel_codegen_split_count": 1,
}
"""Machine code as it comes, all of it at once: made in a third of the time, up to six times slower
where loops are long."""
_TESTED = (0, 11)
"""The mark is internal to XLA: from this version of JAX on it has not been tried, and programs are
compiled as usual."""
_MARKS = {"xla_cpu_small_call": "true", "inlineable": "false"}
"""XLA's frontend attributes: `small_while_loop_hoisting_pass.cc`, `call_inliner.cc`."""
_NO_MARKS = {"xla_cpu_small_call": "false", "inlineable": "true"}
"""Their opposite. Within a derivative JAX forgets that no mark was asked for, but not this."""


def compile_soon(function: Callable) -> CachedProgram:
    """`cache_program`, for a program whose first call counts more than each of the next.

    With a jaxlib that does not know the option it is `cache_program` alone.
    """
    return cache_program(function, _SOON)


def compile_quickly(function: Callable) -> CachedProgram:
    """`cache_program`, for a large program of short loops that takes longer to compile than to run
    in all."""
    return cache_program(function, _QUICKLY)


def in_one_piece(function: Callable) -> Callable:
    """`function` of arrays, for use within `jax.jit`: compiled as one native function on CPUs.

    It then runs on the thread that calls it, and no other. Only what XLA itself generates code
    for may be in it: no linear algebra. Where XLA does not know the mark it changes nothing but
    that the function is called, not inlined.
    """

    @cache
    def make_called():
        import jax
        from jax.experimental.xla_metadata import set_xla_metadata

        def call_unmarked(*args):
            with set_xla_metadata(**_NO_MARKS):
                # XLA aborts where such a function leaves an argument unused: all are handed back.
                return function(*args), jax.lax.optimization_barrier(args)

        return jax.jit(call_unmarked)

    @wraps(function)
    def call_marked(*args):
        import jax
        from jax.experimental.xla_metadata import set_xla_metadata

        if jax.__version_info__ >= _TESTED:
            return function(*args)
        with set_xla_metadata(**_MARKS):
            return jax.lax.optimization_barrier(make_called()(*args))[0]

    return call_marked


def hold(values: Any) -> Any:
    """The same numbers, a pytree, which a compiled program then computes once: for what much
    leads to and many results need. So are their derivatives. It costs a division each."""
    import jax

    def hold_one(x):
        if not isinstance(x, jax.Array):
            return x
        if x.dtype == bool:
            return _make_divide()(x.astype(float)) > 0.5
        return _make_divide()(x.astype(float)).astype(x.dtype)

    return jax.tree.map(hold_one, values)


@cache
def _make_divide() -> Callable:
    """x / 1, of which XLA does not know that it is 1. It makes a product of what is divided by the
    same number in every derivative, and that again and again: each has a 1 of its own."""
    import jax
    import jax.numpy as jnp
    from jax.custom_derivatives import SymbolicZero

    @jax.custom_jvp
    def divide(x):
        return x / jnp.where(x == x, 1.0, x)

    def follow(primals, tangents):
        (x,), (dx,) = primals, tangents
        return divide(x), dx if isinstance(dx, SymbolicZero) else divide(dx)

    divide.defjvp(follow, symbolic_zeros=True)
    return divide
