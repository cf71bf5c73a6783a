"""Hidden effects of an axis are named with their numbers, and nothing where nothing is hidden."""

import numpy as np
import pytest

from difffric.axis import diagnose_axis, fit_axis
from tests.reference.axis import Axis
from tests.unit.axis.made import ROUGH, make

HIDDEN = {
    "friction_direction": ({"viscous_share": 0.1}, {"viscous_share": 0.1}),
    "cogging": (
        {"amplitude": 0.5, "period": 0.012, "phase": 1.0},
        {"amplitude_N": 0.5, "period_m": 0.012, "phase_rad": 1.0},
    ),
    "friction_strengthening": (
        {"strength": 0.1, "strength_speed": 0.002},
        {"amplitude": 0.1, "speed_m_per_s": 0.002},
    ),
    "stribeck": ({"v_s": 0.03}, {"v_s_m_per_s": 0.03}),
    "friction_waviness": (
        {"waviness": 0.05, "wavelength": 0.03, "wave_phase": 0.5},
        {"amplitude": 0.05, "wavelength_m": 0.03, "phase_rad": 0.5},
    ),
    "quadratic_drag": ({"drag": 100.0}, {"c_N_s2_per_m2": 100.0}),
}


def diagnose(seed=1, delay=0.0, **effects):
    speeds = (0.05, 0.1, 0.2, 0.3)
    return diagnose_axis(ROUGH, make(Axis(delay=delay, effects=effects), seed=seed, speeds=speeds))


def test_an_axis_that_hides_nothing_is_adequate():
    found = diagnose()
    assert found.verdict == "adequate"
    assert found.causes == ()
    assert found.gain.before == pytest.approx(1.0, abs=0.1)


QUICK = ("friction_direction", "cogging", "stribeck")


@pytest.mark.parametrize(
    "kind", [*QUICK, *(pytest.param(x, marks=pytest.mark.slow) for x in HIDDEN if x not in QUICK)]
)
def test_a_hidden_effect_is_named_with_its_numbers(kind):
    hidden, numbers = HIDDEN[kind]
    found = diagnose(**hidden)
    assert (found.verdict, found.causes[0].id) == ("named", kind)
    for key, truth in numbers.items():
        value, error = found.causes[0].parameters[key]
        assert abs(value - truth) < 4 * error
    assert found.gain.after < found.gain.before
    assert found.gain.after == pytest.approx(1.0, abs=0.15)
    assert found.setup.effects[kind]


def test_a_late_drive_is_named():
    found = diagnose(delay=0.002)
    assert found.causes[0].id == "drive_delay"
    assert found.causes[0].parameters["delay_s"][0] == pytest.approx(0.002, rel=0.01)


@pytest.mark.slow
def test_two_effects_are_both_named():
    hidden = {**HIDDEN["friction_direction"][0], **HIDDEN["cogging"][0]}
    assert {x.id for x in diagnose(**hidden).causes} == {"friction_direction", "cogging"}


def test_the_extended_set_up_explains_what_the_plain_one_did_not():
    found = diagnose(**HIDDEN["cogging"][0])
    axis = Axis(effects=HIDDEN["cogging"][0])
    fit = fit_axis(found.setup, make(axis, seed=2))
    assert fit.noise.force < 0.02
    assert np.isfinite(fit.standard_error("mass_kg"))


def test_what_is_too_small_to_matter_is_not_left_over_either():
    """A cogging of 1 % of Coulomb friction, where only 5 % matter."""
    axis = Axis(effects={"amplitude": 0.2, "period": 0.012, "phase": 1.0})
    data = make(axis, seed=1, speeds=(0.05, 0.1, 0.2, 0.3))
    found = diagnose_axis(ROUGH, data, matters=0.05)
    assert (found.verdict, found.causes) == ("adequate", ())
    assert [x.id for x in found.negligible] == ["cogging"]


def test_a_force_that_comes_and_goes_is_no_effect_of_the_table():
    speeds = (0.05, 0.1, 0.2)
    found = diagnose_axis(ROUGH, make(Axis(), seed=3, disturbance=1.0, speeds=speeds))
    assert found.verdict == "unexplained"
    assert found.location in ("friction", "pusher")
    assert found.remaining.force == pytest.approx(1.0, rel=0.4)
