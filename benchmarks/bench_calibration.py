"""A calibration: k, b and k_v from the paper's 24 measurements (Tables I-IV), mu_s known.

The standard errors are given, so that all minimise the same sum of squares, from one start and
from ten (factors of 3 about k and b), which is what finds the lowest of several minima.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from benchmarks import contest, numba_closed_form, scipy_push
from difffric import fit
from difffric.rig.rig import spring_damper_rig
from difffric.studies import published_tables as paper

GROUP = "7. A calibration: k, b and k_v from 24 measurements"
NAMES = ("k", "b", "k_v")
FREE = ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m")
SE_FORCE, SE_DISTANCE = 4.0, 150e-6
START = {"k": 6e5, "b": 1200.0, "k_v": 5.0}
REFERENCE = "difffric.fit, 10 starts"


@pytest.fixture(scope="module")
def pushes():
    measured = paper.load_pushes()
    n = len(measured)
    return replace(
        measured,
        peak_force_se=np.full(n, SE_FORCE),
        sliding_distance_se=np.full(n, SE_DISTANCE),
    )


def _difffric(pushes):
    rig = spring_damper_rig(mass=contest.PUSH["m"], mu_s=0.141, **START)

    def call():
        found = fit(rig, pushes, free=FREE)
        return [found.value(name) for name in FREE]

    return call


def _scipy(push, diff_step, starts):
    """Least squares in log-parameters, as difffric's, on finite differences."""

    def make(pushes):
        table = list(zip(pushes.velocity.tolist(), pushes.mu_s_gauge.tolist(), strict=True))
        m, ratio = contest.PUSH["m"], contest.PUSH["ratio"]

        def misfit(log_values):
            values = np.exp(log_values).tolist()
            model = np.array([push(v, mu_s, *values, m, ratio)[:2] for v, mu_s in table])
            F_p, d = model.T
            return np.concatenate(
                [
                    (F_p - pushes.peak_force) / SE_FORCE,
                    (np.where(np.isnan(d), 0.0, d) - pushes.sliding_distance) / SE_DISTANCE,
                ]
            )

        centre = np.log(list(START.values()))
        shifts = [(0, 0)] + [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        grid = [centre + np.log(3) * np.array([i, j, 0]) for i, j in shifts[:starts]]

        def call():
            found = [least_squares(misfit, x, diff_step=diff_step, xtol=1e-10) for x in grid]
            return np.exp(min(found, key=lambda f: f.cost).x).tolist()

        return call

    return make


# contender -> what makes its call, the error allowed, rounds
CONTENDERS = {
    REFERENCE: (_difffric, 0.0, 10),
    "numba, by hand, scipy least_squares, 10 starts": (
        _scipy(numba_closed_form.push, None, 10),
        1e-3,
        10,
    ),
    "numba, by hand, scipy least_squares, 1 start": (
        _scipy(numba_closed_form.push, None, 1),
        1e-3,
        20,
    ),
    "scipy DOP853, scipy least_squares, 1 start": (_scipy(scipy_push.push, 1e-5, 1), 1e-3, 2),
}


@pytest.fixture(scope="module")
def reference(pushes):
    return _difffric(pushes)()


@pytest.mark.benchmark(group=GROUP)
@pytest.mark.parametrize("contender", CONTENDERS)
def test_calibration(benchmark, contender, pushes, request):
    make, within, rounds = CONTENDERS[contender]
    is_reference = contender == REFERENCE
    contest.race(
        benchmark,
        contender,
        make(pushes),
        names=NAMES,
        # Asked for only now: its first call is then the one that was timed.
        reference=None if is_reference else lambda: request.getfixturevalue("reference"),
        within=within,
        rounds=rounds,
        is_reference=is_reference,
    )
