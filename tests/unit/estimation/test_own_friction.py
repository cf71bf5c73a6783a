"""Each push's own mu_s, followed to what is best for it from anywhere."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.own_friction import settle_by_push
from tests.unit.diagnosis.linear_rig import make_task, start

N = 12


def make_far(scatter: float) -> tuple[Any, ensemble.Fits]:
    """Pushes whose answers go with mu_s itself and tell it to a thousandth, and a fit that has each
    own log mu_s off by up to 1."""
    rng = np.random.default_rng(7)
    slopes = np.zeros((N, 2, 2))
    slopes[:, :, 0] = rng.uniform(500.0, 2000.0, (N, 2))
    own = rng.uniform(-1.0, 1.0, N)
    measured = slopes[:, :, 0] * np.exp(own)[:, None] + rng.standard_normal((N, 2))
    task: Any = make_task(slopes, measured, ("k",), shared=(1,))
    task.model.exponential = True
    return task, ensemble.evaluate(task, start(task, scatter))


@pytest.mark.parametrize("scatter", [0.01, 0.3])
def test_each_comes_to_the_minimum_of_its_own_cost(scatter):
    task, at = make_far(scatter)
    found = settle_by_push(task, at)
    for i in range(N):
        slope, value = task.model.slopes[i, :, 0], task.model.measured[i]

        def cost(x, slope=slope, value=value):
            return ((value - slope * np.exp(x)) ** 2).sum() + (x / scatter) ** 2

        best = minimize_scalar(cost, bounds=(-2.0, 2.0), method="bounded", options={"xatol": 1e-9})
        error = (float((slope**2).sum()) * np.exp(2 * best.x)) ** -0.5
        assert found.own[0, i] == pytest.approx(best.x, abs=error)
    np.testing.assert_array_equal(found.c, at.c)
    np.testing.assert_array_equal(found.scatter, at.scatter)
    again = ensemble.evaluate(task, found)
    np.testing.assert_allclose(found.gram, again.gram)


def test_a_push_that_cannot_be_followed_keeps_no_other_from_its_own():
    task, at = make_far(0.3)
    free = settle_by_push(task, at)
    asked = task.model.answers

    there = at.own[0, 4]

    def answers(index, c, directions, keep_rows=False):
        found = asked(index, c, directions, keep_rows)
        lost = (np.asarray(index) == 4) & (c[:, 0] != there)
        found.gram[lost] = np.nan
        return found

    task.model.answers = answers
    found = settle_by_push(task, at)
    others = np.arange(N) != 4
    np.testing.assert_array_equal(found.own[0, others], free.own[0, others])
    assert found.own[0, 4] == there
