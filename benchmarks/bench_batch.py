"""Many pushes at once: F_p and d with their derivatives by mu_s, NumPy arrays in and out."""

from __future__ import annotations

import shutil

import jax
import numpy as np
import pytest
from numba import njit

from benchmarks import contest, diffrax_push, model, numba_closed_form, scipy_push

ONE_CONTACT = "2. A batch: the same, per push; the pusher stops at the first loss of contact"
STROKE = "3. A batch with a stroke of 2 mm: several contacts, per push"
STROKE_M = 2e-3
OTHERS = tuple(contest.PUSH[name] for name in ("k", "b", "k_v", "m", "ratio"))
ONE_CONTACT_REFERENCE = "difffric, observe_batch, 10 000 pushes"
STROKE_REFERENCE = "difffric, observe_batch, 10 000 pushes"


def _difffric(stroke, threads=None):
    return lambda v, mu_s: model.observe_batch(v, mu_s, stroke, threads)


def _difffric_jit(v, mu_s):
    call = model.batch()
    return lambda: call(v, mu_s)


difffric_one_contact, difffric_stroke = _difffric(None), _difffric(STROKE_M)


def _difffric_integrated(v, mu_s):
    integrator = model.diffrax_integrator()
    if integrator is None:
        pytest.skip("difffric.simulation.diffrax_reference is not there yet")
    call = model.batch(None, integrator)
    return lambda: call(v, mu_s)


def _numba(v, mu_s):
    compiled = njit(**numba_closed_form.FAST)(numba_closed_form.batch.py_func)
    return lambda: compiled(v, mu_s, *OTHERS)


def _numba_parallel(v, mu_s):
    compiled = njit(parallel=True, **numba_closed_form.FAST)(
        numba_closed_form.batch_parallel.py_func
    )
    return lambda: compiled(v, mu_s, *OTHERS)


def _casadi(threads, compiled):
    def make(v, mu_s):
        casadi_closed_form = pytest.importorskip("benchmarks.casadi_closed_form")
        if compiled and shutil.which("gcc") is None:
            pytest.skip("no C compiler")
        return casadi_closed_form.batch(v, mu_s, OTHERS, threads, compiled)

    return make


def _diffrax(v, mu_s):
    compiled = jax.jit(
        jax.vmap(lambda v, mu_s: diffrax_push.with_derivative(v, mu_s, *OTHERS), out_axes=1)
    )
    return lambda: np.asarray(compiled(v, mu_s))


def _scipy(stroke):
    def make(v, mu_s):
        points = list(zip(v.tolist(), mu_s.tolist(), strict=True))

        def call():
            rows = [scipy_push.with_derivative(*p, *OTHERS, stroke=stroke) for p in points]
            return np.array(rows).T

        return call

    return make


# contender -> what makes its call, pushes, the error allowed, rounds, iterations
ONE_CONTACT_CONTENDERS = {
    ONE_CONTACT_REFERENCE: (difffric_one_contact, 10_000, 1e-9, 60, 3),
    "the same, one thread": (_difffric(None, 1), 10_000, 1e-9, 60, 3),
    "difffric, one's own jit of vmap of observe": (_difffric_jit, 10_000, 1e-9, 60, 3),
    "numba, by hand, 10 000 pushes, one thread": (_numba, 10_000, 1e-9, 60, 3),
    "numba, by hand, 10 000 pushes, all cores": (_numba_parallel, 10_000, 1e-9, 60, 3),
    "CasADi, 10 000 pushes, one thread": (_casadi(1, False), 10_000, 1e-9, 10, 1),
    "CasADi, 10 000 pushes, two threads": (_casadi(2, False), 10_000, 1e-9, 10, 1),
    "CasADi, turned into C (gcc -O3), two threads": (_casadi(2, True), 10_000, 1e-9, 20, 1),
    "difffric, integrated, 1000 pushes": (_difffric_integrated, 1000, 1e-4, 3, 1),
    "diffrax by hand, 10 000 pushes": (_diffrax, 10_000, 1e-4, 3, 1),
    "scipy DOP853, central differences, 20 pushes": (_scipy(np.inf), 20, 1e-4, 3, 1),
}
STROKE_CONTENDERS = {
    STROKE_REFERENCE: (difffric_stroke, 10_000, 0.0, 5, 1),
    "scipy DOP853, central differences, 20 pushes": (_scipy(STROKE_M), 20, 1e-2, 3, 1),
}


@pytest.fixture(scope="module")
def points():
    return model.points(10_000)


def _race(benchmark, contenders, contender, points, reference):
    """`reference()` is called after the contender's first call, which may compile it."""
    make, n, within, rounds, iterations = contenders[contender]
    contest.race(
        benchmark,
        contender,
        make(points[0][:n], points[1][:n]),
        names=contest.ANSWERS,
        reference=reference,
        within=within,
        points=n,
        rounds=rounds,
        iterations=iterations,
        is_reference=contender in (ONE_CONTACT_REFERENCE, STROKE_REFERENCE),
    )


@pytest.mark.benchmark(group=ONE_CONTACT)
@pytest.mark.parametrize("contender", ONE_CONTACT_CONTENDERS)
def test_batch(benchmark, contender, points):
    n = ONE_CONTACT_CONTENDERS[contender][1]
    other = _numba if contender == ONE_CONTACT_REFERENCE else difffric_one_contact
    _race(
        benchmark,
        ONE_CONTACT_CONTENDERS,
        contender,
        points,
        lambda: np.array(other(*points)())[:, :n],
    )


@pytest.mark.benchmark(group=STROKE)
@pytest.mark.parametrize("contender", STROKE_CONTENDERS)
def test_batch_with_a_stroke(benchmark, contender, points):
    n = STROKE_CONTENDERS[contender][1]
    reference = None
    if contender != STROKE_REFERENCE:
        reference = lambda: np.array(difffric_stroke(*points)())[:, :n]  # noqa: E731
    _race(benchmark, STROKE_CONTENDERS, contender, points, reference)
