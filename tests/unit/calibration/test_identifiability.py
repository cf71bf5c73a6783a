"""What data leave open, before and after a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import difffric as df
from difffric.calibration.identifiability import identifiable
from difffric.errors import InputError
from difffric.estimation.open_parameters import find_sticking_speed
from difffric.number_text import format_number
from tests.reference import data as reference
from tests.unit.calibration.designs import ALL, CALIBRATED, FAST, PAPER, TRUTH, make_setup


def groups(found):
    return [set(x["parameters"]) for x in found]


def test_before_any_push_mu_s_is_not_apart_from_mu_k_where_nothing_sticks():
    rig = df.spring_damper_rig(**PAPER)
    noise = (0.5, 0.4e-6)
    fast = identifiable(rig, df.Pushes(velocity=np.array(FAST)), free=ALL, noise=noise)
    (group,) = fast.not_identifiable
    assert set(group["parameters"]) == {"mu_s", "mu_k_over_mu_s"}
    assert "mu_k alone" in group["reason"]
    assert fast.standard_errors["mu_s"] is None and fast.standard_errors["k_N_per_m"] > 0
    slow = df.Pushes(velocity=np.array([*FAST, 0.008, 0.01]))  # b v < mu_s F_N: it sticks first
    assert identifiable(rig, slow, free=ALL, noise=noise).not_identifiable == []


def test_mu_s_that_rests_on_the_ratio_alone_is_said():
    """The error of mu_s alone hides that no push shows it: the set-up's ratio makes it of mu_k."""
    rig = df.spring_damper_rig(**PAPER)
    fast, slow = np.array(FAST), np.array([*FAST, 0.008, 0.01])  # the last two stick first
    said = [note for note in identifiable(rig, df.Pushes(velocity=fast)).notes if "mu_k" in note]
    edge = find_sticking_speed(rig)
    assert len(said) == 1 and "no push sticks before it slides" in said[0]
    assert f"about {format_number(60e3 * edge, 2)} mm/min" in said[0] and "mu_k / 0.75" in said[0]
    for v, sticks in ((0.99 * edge, True), (1.01 * edge, False)):
        assert bool(df.observe(rig, v).stuck_first) is sticks
    free = ("mu_s", "mu_k_over_mu_s")
    for design in (
        {"pushes": df.Pushes(velocity=slow)},
        {"pushes": df.Pushes(velocity=fast), "free": free},
    ):
        assert not any("mu_k" in note for note in identifiable(rig, **design).notes)
    exact = df.observe_batch(rig, fast)
    pushes = df.Pushes(fast, exact.peak_force, exact.sliding_distance)
    assert any("no push sticks" in note for note in df.identify(rig, pushes).notes)


def test_after_the_fit_mu_s_is_not_apart_from_mu_k_where_nothing_sticks():
    rng = np.random.default_rng(2)
    made = reference.make_pushes(replace(TRUTH, b=6000.0), rng, 14, speeds=FAST)
    pushes = df.Pushes(**reference.measure(made, rng))
    known = make_setup(replace(TRUTH, b=6000.0), TRUTH.scatter)
    fit = df.fit(known, pushes, free=ALL, several_starts=False)
    (group,) = fit.not_identifiable
    assert set(group["parameters"]) == {"mu_s", "mu_k_over_mu_s"}
    assert "traded off" in group["reason"]
    assert "up 1 %" in group["reason"] and "down 1 %" in group["reason"]
    assert not any("no push sticks" in note for note in fit.notes)
    held = df.fit(known, pushes, several_starts=False)
    assert any("no push sticks" in note for note in held.notes)


def test_one_speed_and_no_force_leave_parameters_open():
    rig = df.spring_damper_rig(**PAPER)
    one = identifiable(rig, df.Pushes(velocity=np.full(10, 0.05)))
    assert any("k_v_N_s_per_m" in g for g in groups(one.not_identifiable))
    assert any("one speed" in x["reason"] for x in one.not_identifiable)
    slides = df.Pushes(release_velocity=np.linspace(0.02, 0.08, 10))
    free = identifiable(rig, slides, free=CALIBRATED)
    assert groups(free.not_identifiable) == [{"k_N_per_m"}, {"b_N_s_per_m"}]
    assert all("No force is measured" in x["reason"] for x in free.not_identifiable)


def test_the_expected_standard_errors_are_those_of_the_fit(exact):
    known, pushes, fit = exact
    before = identifiable(known, pushes, free=CALIBRATED)
    for label in CALIBRATED:
        assert before.standard_errors[label] == pytest.approx(fit.standard_error(label), rel=0.02)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda fit: identifiable(fit.rig, df.Pushes(velocity=[0.05]), noise=(0.0, None)),
            "noise: that of the force is 0.0",
        ),
    ],
)
def test_bad_input_is_one_clear_line(coarse, call, message):
    with pytest.raises(InputError, match=message) as error:
        call(coarse[2])
    assert "\n" not in str(error.value)
