"""The probability of a drop by chance, all effects and looks counted."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from difffric.diagnosis.score_test import compute_p_value, run_score_tests
from difffric.estimation.ensembles import ensemble, ensemble_refits
from tests.unit.diagnosis.linear_rig import make_task, start


def test_a_scan_counts_as_many_looks_and_each_effect_as_one():
    one = scipy.stats.chi2.sf(12.0, 1)
    assert compute_p_value("tilt", 12.0, 1) == pytest.approx(one)
    assert compute_p_value("tilt", 12.0, 20) == pytest.approx(20 * one)
    assert compute_p_value("stribeck", 12.0, 1) > 5 * one


@pytest.mark.parametrize("drop", [-3.0, 0.0])
def test_a_fit_that_is_no_better_is_chance_for_certain(drop):
    assert compute_p_value("tilt", drop, 5) == 1.0


def test_a_drift_that_the_scatter_has_taken_in_is_predicted_as_the_refit_finds_it():
    """At the scatter without it, no drift drops -2 log likelihood by more than a number a push."""
    n, rng = 14, np.random.default_rng(3)
    share = np.linspace(0, 1, n)
    slopes = np.zeros((n, 2, 2))
    slopes[:, :, 0] = [[100.0, 300.0]]
    slopes[:, :, 1] = slopes[:, :, 0] * share[:, None]
    own = 0.2 * share + 0.01 * rng.standard_normal(n)
    measured = slopes[:, :, 0] * own[:, None] + rng.standard_normal((n, 2))
    task = make_task(slopes, measured, ("friction_drift.drift",))
    base = ensemble_refits.refit(task, start(task, 0.05), 10)
    score = run_score_tests(task, base, ["friction_drift"])["friction_drift"]
    free = replace(base, extra=((1,),), gram=None, residual=None, damping=None)
    refitted = ensemble_refits.refit(task, free, 10)
    drop = float(ensemble.criterion(task, base)[0] - ensemble.criterion(task, refitted)[0])
    assert drop > 2 * n
    assert score.drop == pytest.approx(drop, rel=0.05)
