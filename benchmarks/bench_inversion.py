"""One identification: mu_s from F_p, from d, and from both, from Python floats to Python floats.

All search the same bracket, and the truth is known: the push is simulated.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import contest, model, numba_closed_form, scipy_push
from difffric import inversion

V, MU_S = 0.05, 0.141
OTHERS = tuple(contest.PUSH[name] for name in ("k", "b", "k_v", "m", "ratio"))
REFERENCE = "difffric, bracketed Newton on exact derivatives"
BOTH = ("F_p", "d")
TASKS = {
    ("F_p",): "4. One identification: mu_s from F_p",
    ("d",): "5. One identification: mu_s from d",
    BOTH: "6. One identification: mu_s from F_p and mu_s from d",
}
ROW = {"F_p": 0, "d": 1}


def _difffric(task, measured):
    rig = model.rig()

    @jax.jit
    def solve(v, values):
        found = []
        for name, value in zip(task, values, strict=True):
            by_force = name == "F_p"  # which grows with mu_s, d falls
            root = inversion.solve(rig, v, value, by_force, inversion.BRACKET, by_force)
            found.append(root.mu_s)
        return jnp.stack(found)

    return lambda: np.asarray(solve(V, measured)).tolist()


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
    "scipy DOP853, scipy.optimize.brentq": (_brent(scipy_push.push), 1e-7, 10, 1),
}


@pytest.fixture(scope="module")
def truth():
    return model.batch()(np.array([V]), np.array([MU_S]))[:, 0].tolist()


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
        reference=lambda: [MU_S] * len(task),
        within=within,
        rounds=rounds,
        iterations=iterations,
        is_reference=contender == REFERENCE,
    )
