"""The limit that the processor sets: a push's arithmetic at its full rate, and nothing else.

No calls, no memory, no waiting for a result: as many multiplications and additions as the
compiled closed form has operations, on all cores, from registers.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache

import jax
import numpy as np

from difffric.compute.xla_options import in_one_piece

_LANES, _CHAINS = 64, 4
"""Numbers at a time: eight vectors of eight, in each of four independent chains."""
_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


@cache
def _spin():
    def steps(count, x):
        def step(_, chains):
            for _ in range(8):
                chains = [c * 0.999999 + 1e-9 for c in chains]
            return chains

        return jax.lax.fori_loop(0, count, step, [x + i for i in range(_CHAINS)])

    example = 0, np.ones(_LANES)
    return jax.jit(in_one_piece(steps), compiler_options=_OPTIONS).lower(*example).compile()


def arithmetic(points: int, operations: float, threads: int = 2):
    """A call that does so many floating-point operations for each of so many points."""
    run, x = _spin(), np.ones(_LANES)
    per_step = _LANES * _CHAINS * 8 * 2
    count = max(1, round(points * operations / per_step / threads))
    pool = ThreadPoolExecutor(threads)

    def share():
        jax.block_until_ready(run(count, x))

    def call():
        others = [pool.submit(share) for _ in range(threads - 1 if count > 100 else 0)]
        share()
        for other in others:
            other.result()

    return call
