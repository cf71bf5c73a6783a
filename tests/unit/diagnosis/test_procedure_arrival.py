"""What matters and what is left, in absolute terms, by whole diagnoses."""

from __future__ import annotations

import numpy as np
import pytest

from tests.hidden import random_case, with_nuisances
from tests.unit.diagnosis.analysis import Analysis

MATTERS = 0.005


def measure_friction_error(one: Analysis) -> float:
    """The relative error (rms over the pushes) of the friction that each push is told to have had,
    drift included."""
    pushes = sorted(one.case.pushes, key=lambda push: push.order)
    drift = one.case.effects.get("friction_drift", {"drift": 0.0})["drift"]
    had = [p.mu_s * (1 + drift * i / (len(pushes) - 1)) for i, p in enumerate(pushes)]
    return float(np.sqrt(np.mean((np.array(one.found.mu_s) / had - 1) ** 2)))


def test_what_shows_and_changes_next_to_nothing_is_no_cause(tmp_path):
    case = random_case(1).with_effect("force_gain", {"factor": 1.0005})
    found = Analysis(case, tmp_path, MATTERS).found
    assert found.verdict == "adequate" and not found.causes and found.remaining is None
    assert "force_gain" in {cause.id for cause in found.negligible}
    assert all(0 < cause.change_as_mu_s < MATTERS for cause in found.negligible)
    assert "force_gain.factor" not in found.setup.extras
    assert found.as_dict()["remaining"] is None


@pytest.mark.slow
def test_a_cause_is_named_whose_fit_is_surer_than_linear_answers_have_it(tmp_path):
    one = Analysis(random_case(1600018, "force_lowpass", 4.0), tmp_path)  # a push's mu_s moves
    assert [cause.id for cause in one.found.causes] == ["force_lowpass"]


@pytest.mark.slow
def test_no_patch_from_where_pushes_begin_stands_for_friction_beside_a_background(tmp_path):
    # A patch of -0.0055 from 3 um on was named, and mu_s was 0.9 % off.
    seed = 1_200_019
    case = with_nuisances(random_case(seed), np.random.default_rng([seed, 5]), share=0.0035)
    one = Analysis(case, tmp_path, MATTERS)
    assert one.found.verdict == "adequate" and not one.found.causes
    assert measure_friction_error(one) < MATTERS


@pytest.mark.slow
def test_a_drift_is_a_cause_however_strong_a_gap_is_beside_it(tmp_path):
    case = random_case(1, scatter=0.015).with_effect("initial_gap", {"gap_m": 150e-6})
    one = Analysis(case.with_effect("friction_drift", {"drift": 0.1}), tmp_path, MATTERS)
    assert one.found.verdict == "named" and one.found.remaining is None
    assert {cause.id for cause in one.found.causes} == {"initial_gap", "friction_drift"}
    assert measure_friction_error(one) < 0.002


@pytest.mark.slow
def test_a_lag_that_changes_everything_is_followed_to_the_floor(tmp_path):
    case = random_case(3, scatter=0.015).with_effect("pusher_lag", {"tau_s": 3e-3})
    one = Analysis(case, tmp_path, MATTERS)
    assert [cause.id for cause in one.found.causes] == ["pusher_lag"]
    assert one.found.gain.after < 1.05 < one.found.gain.before
    assert one.found.remaining is None and measure_friction_error(one) < 0.002


@pytest.mark.slow
def test_a_dwell_that_each_pushs_own_friction_makes_up_for_is_named_beside_a_scale(tmp_path):
    one = Analysis(random_case(900009, ["probe_scale", "static_dwell"], 30.0), tmp_path)
    causes = {cause.id: cause for cause in one.found.causes}
    assert set(causes) == {"probe_scale", "static_dwell"}
    assert one.found.gain.after < 1.02 < one.found.gain.before
    value, error = causes["static_dwell"].parameters["amplitude"]
    assert abs(value - one.case.effects["static_dwell"]["amplitude"]) < 3 * error


@pytest.mark.slow
def test_a_fall_of_friction_is_named_though_a_push_is_beside_a_jump(tmp_path):
    one = Analysis(random_case(400023, "stribeck", 10.0, delta=1.0), tmp_path)
    assert [cause.id for cause in one.found.causes] == ["stribeck"]
    assert one.found.gain.after < one.found.gain.before
    assert measure_friction_error(one) < 0.005


@pytest.mark.slow
def test_what_is_confused_with_a_cause_is_told_though_linear_answers_doubt_it(tmp_path):
    (cause,) = Analysis(random_case(400031, "tilt", 10.0), tmp_path).found.causes
    assert {cause.id, *cause.confusable_with} == {"tilt", "friction_ratio"}
    assert cause.probability < 0.8
