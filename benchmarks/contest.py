"""How contenders are timed and compared; shared by all benchmarks."""

from __future__ import annotations

import time

import numpy as np

PUSH = {"k": 8e5, "b": 1500.0, "k_v": 5.0, "m": 18.9, "ratio": 0.75}
"""The rig of all benchmarks but the calibration's [SI]."""

ANSWERS = ("F_p", "d", "dF_p/dmu_s", "dd/dmu_s")


def worst_errors(answer, reference):
    """The largest relative error of each row; a NaN on one side only counts as infinite."""
    answer, reference = (np.atleast_2d(np.asarray(a, float).T).T for a in (answer, reference))
    scale = np.where(reference == 0, 1.0, np.abs(reference))
    error = np.abs(answer - reference) / scale
    missing = np.isnan(answer)
    error = np.where(missing & np.isnan(reference), 0.0, error)
    error = np.where(missing != np.isnan(reference), np.inf, error)
    return error.max(axis=1)


def race(
    benchmark,
    contender,
    call,
    *,
    names=(),
    reference=None,
    within=0.0,
    points=1,
    rounds=5,
    iterations=1,
    warmup_rounds=1,
    is_reference=False,
):
    """Time `call()`, after its first call (timed apart) and after a look at its answer.

    `reference()` is what it should answer, one row a name; the errors stand in the table, and
    one above `within` fails. `points`: a call's time is given per point.
    """
    start = time.perf_counter()
    call()
    first = time.perf_counter() - start
    if reference is not None:
        errors = worst_errors(call(), reference())
        benchmark.extra_info["errors"] = [float(e) for e in errors]
        assert (errors <= within).all(), f"{contender}: {errors} is not within {within}"
    benchmark.extra_info.update(
        contender=contender,
        names=list(names),
        points=points,
        first_call_s=first,
        is_reference=is_reference,
    )
    benchmark.pedantic(call, rounds=rounds, iterations=iterations, warmup_rounds=warmup_rounds)
