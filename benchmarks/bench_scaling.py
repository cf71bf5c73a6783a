"""From one push to a million: F_p, d and their derivatives by mu_s, on one core and on two.

The figure that `benchmarks.figures` draws of it is in docs/performance.md.
"""

from __future__ import annotations

import jax
import numpy as np
import pytest

from benchmarks import contest, diffrax_push, limit, model, numba_closed_form, scipy_push

GROUP = "9. From one push to a million, per push"
OTHERS = tuple(contest.PUSH[name] for name in ("k", "b", "k_v", "m", "ratio"))
SIZES = (1, 10, 100, 1000, 10_000, 100_000, 1_000_000)
REFERENCE = "difffric, two cores"


def _difffric(threads):
    return lambda v, mu_s: model.observe_batch(v, mu_s, threads=threads)


def _numba(threads):
    def make(v, mu_s):
        serial, parallel = numba_closed_form.batch, numba_closed_form.batch_parallel
        compiled = parallel if threads > 1 else serial
        return lambda: compiled(v, mu_s, *OTHERS)

    return make


def _casadi(v, mu_s):
    return pytest.importorskip("benchmarks.casadi_closed_form").batch(v, mu_s, OTHERS, 2)


def _diffrax(v, mu_s):
    compiled = jax.jit(
        jax.vmap(lambda v, mu_s: diffrax_push.with_derivative(v, mu_s, *OTHERS), out_axes=1)
    )
    return lambda: np.asarray(compiled(v, mu_s))


def _scipy(v, mu_s):
    pairs = list(zip(v.tolist(), mu_s.tolist(), strict=True))
    return lambda: np.array([scipy_push.with_derivative(*p, *OTHERS) for p in pairs]).T


def _limit(v, mu_s):
    return limit.arithmetic(len(v), model.operations())


# contender -> what makes its call, the most pushes, the error allowed (None: it has no answer)
CONTENDERS = {
    REFERENCE: (_difffric(2), SIZES[-1], 1e-9),
    "difffric, one core": (_difffric(1), SIZES[-1], 1e-9),
    "numba by hand, two cores": (_numba(2), SIZES[-1], 1e-9),
    "numba by hand, one core": (_numba(1), SIZES[-1], 1e-9),
    "CasADi, two cores": (_casadi, 10_000, 1e-9),
    "diffrax by hand": (_diffrax, 1000, 1e-4),
    "scipy DOP853, central differences": (_scipy, 10, 1e-4),
    "the limit: its arithmetic alone, two cores": (_limit, SIZES[-1], None),
}


@pytest.mark.benchmark(group=GROUP)
@pytest.mark.parametrize("contender", CONTENDERS)
@pytest.mark.parametrize("n", SIZES)
def test_scaling(benchmark, contender, n):
    make, most, within = CONTENDERS[contender]
    if n > most:
        pytest.skip("it takes too long")
    v, mu_s = model.points(n)
    few = min(n, 10_000)

    def reference():
        return numba_closed_form.batch(v, mu_s, *OTHERS)

    call = make(v, mu_s)
    call()
    contest.race(
        benchmark,
        f"{contender}, {n}",
        call,
        names=contest.ANSWERS,
        reference=None if within is None else reference,
        within=within or 0.0,
        points=n,
        rounds=40 if few == n and "scipy" not in contender else 8,
        iterations=5 if n <= 100 and "scipy" not in contender else 1,
        is_reference=contender == REFERENCE and n == SIZES[-1],
    )
    benchmark.extra_info.update(contender=contender)
