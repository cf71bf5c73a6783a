"""One push: F_p and d with their derivatives by mu_s, from Python floats to Python floats."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from numba import njit

from benchmarks import contest, diffrax_push, model, numba_closed_form, scipy_push

GROUP = "1. One push: F_p, d and their derivatives by mu_s, from Python floats to Python floats"
V, MU_S = 0.05, 0.141
OTHERS = tuple(contest.PUSH[name] for name in ("k", "b", "k_v", "m", "ratio"))
REFERENCE = "difffric, closed form"


def _difffric(integrator=None):
    compiled = jax.jit(model.with_derivative(None, integrator))
    return lambda: np.asarray(compiled(V, MU_S)).tolist()


def _difffric_integrated():
    integrator = model.diffrax_integrator()
    if integrator is None:
        pytest.skip("difffric.simulation.diffrax_reference is not there yet")
    return _difffric(integrator)


def _numba():
    compiled = njit(**numba_closed_form.FAST)(numba_closed_form.push.py_func)
    return lambda: compiled(V, MU_S, *OTHERS)


def _diffrax():
    compiled = jax.jit(lambda v, mu_s: diffrax_push.with_derivative(v, mu_s, *OTHERS))
    return lambda: np.asarray(compiled(V, MU_S)).tolist()


def _scipy():
    return lambda: scipy_push.with_derivative(V, MU_S, *OTHERS)


# contender -> what makes its call, the error allowed, rounds, iterations
CONTENDERS = {
    REFERENCE: (_difffric, 1e-9, 200, 50),
    "numba, closed form by hand (the practical limit)": (_numba, 1e-9, 200, 500),
    "difffric, integrated (any smooth law)": (_difffric_integrated, 1e-6, 40, 10),
    "diffrax by hand: Tsit5, events, forward mode": (_diffrax, 1e-6, 40, 10),
    "scipy DOP853, events, central differences": (_scipy, 1e-5, 40, 1),
}


def _reference(contender):
    """difffric's own answer, by its batch program; numba's for difffric itself."""
    if contender == REFERENCE:
        return lambda: numba_closed_form.push(V, MU_S, *OTHERS)
    return lambda: model.batch()(np.array([V]), np.array([MU_S]))


@pytest.mark.benchmark(group=GROUP)
@pytest.mark.parametrize("contender", CONTENDERS)
def test_one_push(benchmark, contender):
    make, within, rounds, iterations = CONTENDERS[contender]
    contest.race(
        benchmark,
        contender,
        make(),
        names=contest.ANSWERS,
        reference=_reference(contender),
        within=within,
        rounds=rounds,
        iterations=iterations,
        is_reference=contender == REFERENCE,
    )
