"""The probability of a drop by chance, all effects and looks counted."""

import pytest
import scipy

from difffric.diagnosis.score_test import compute_p_value


def test_a_scan_counts_as_many_looks_and_each_effect_as_one():
    one = scipy.stats.chi2.sf(12.0, 1)
    assert compute_p_value("tilt", 12.0, 1) == pytest.approx(one)
    assert compute_p_value("tilt", 12.0, 20) == pytest.approx(20 * one)
    assert compute_p_value("stribeck", 12.0, 1) > 5 * one


@pytest.mark.parametrize("drop", [-3.0, 0.0])
def test_a_fit_that_is_no_better_is_chance_for_certain(drop):
    assert compute_p_value("tilt", drop, 5) == 1.0
