"""One identification: mu_s from F_p, from d, and from both, from Python floats to Python floats.

All search the same bracket, and the truth is known: the push is simulated. difffric gives the
standard error as well, the others do not. Beside them, what JAX takes to call a program that
hands back the number it was given.
"""

from __future__ import annotations

import jax
import numpy as np
import pytest

from benchmarks import contest, model, numba_closed_form, scipy_push
from difffric.identification import fast_identifier, inversion

V, MU_S = 0.05, 0.141
OTHERS = tuple(contest.PUSH[name] for name in ("k", "b", "k_v", "m", "ratio"))
REFERENCE = "difffric, identifier: mu_s with its standard error"
SE = {"F_p": 1.0, "d": 1e-6}
IDENTITY = "JAX calling the identity, a float in and a float out"
BOTH = ("F_p", "d")
TASKS = {
    ("F_p",): "4. One identification: mu_s from F_p",
    ("d",): "5. One identification: mu_s from d",
    BOTH: "6. One identification: mu_s from F_p and mu_s from d",
}
ROW = {"F_p": 0, "d": 1}


def _difffric(task, measured):
    call = fast_identifier.identifier(
        model.rig(), peak_force_se=SE["F_p"], sliding_distance_se=SE["d"]
    )
    readings = dict(zip(task, measured, strict=True))
    F_p, d = (readings.get(name, np.nan) for name in BOTH)
    if task == BOTH:
        # Two answers to compare with: the call gives both, and their weighted mean.
        return lambda: (found := call(V, F_p, d)) and [found.mu_s_force, found.mu_s_distance]
    return lambda: [call(V, F_p, d).mu_s]


def _identity(task, measured):
    call = jax.jit(lambda x: x)
    return lambda: float(call(V))


def _brent(push):
    def make(task, measured):
        def simulate(mu_s):
            return push(V, mu_s, *OTHERS)

        def call():
            return [
                scipy_push.invert(simulate, ROW[name], value, inversion.BRACKET)
                for name, value in zip(task, measured, strict=True)
            ]

        return call

    return make


# contender -> what makes its call, the error allowed, rounds, iterations
CONTENDERS = {
    REFERENCE: (_difffric, 1e-10, 200, 50),
    "numba closed form by hand, scipy.optimize.brentq": (
        _brent(numba_closed_form.push),
        1e-10,
        200,
        20,
    ),
    IDENTITY: (_identity, None, 200, 50),
    "scipy DOP853, scipy.optimize.brentq": (_brent(scipy_push.push), 1e-7, 10, 1),
}


@pytest.fixture(scope="module")
def truth():
    return [float(row[0]) for row in model.observe_batch(np.array([V]), np.array([MU_S]))()]


@pytest.mark.parametrize(
    "task", [pytest.param(t, marks=pytest.mark.benchmark(group=g)) for t, g in TASKS.items()]
)
@pytest.mark.parametrize("contender", CONTENDERS)
def test_inversion(benchmark, contender, task, truth):
    make, within, rounds, iterations = CONTENDERS[contender]
    measured = tuple(truth[ROW[name]] for name in task)
    contest.race(
        benchmark,
        contender,
        make(task, measured),
        names=[f"mu_s from {name}" for name in task],
        reference=None if within is None else lambda: [MU_S] * len(task),
        within=within or 0.0,
        rounds=rounds,
        iterations=iterations,
        is_reference=contender == REFERENCE,
    )
