"""Fits of made axes: within their errors of the truth, from set-ups that are far off."""

from dataclasses import replace

import numpy as np
import pytest

from difffric.axis import AxisRecordings, AxisSetup, AxisStretch, fit_axis, identify_axis
from difffric.axis.breakaway import _slide
from difffric.axis.setup import AxisExtras
from difffric.errors import InputError
from tests.reference.axis import Axis, record
from tests.unit.axis.made import ROUGH, as_recording, make

TRUTH = {"mass_kg": 95.0, "coulomb_N": 20.0, "k_v_N_s_per_m": 200.0, "offset_N": -3.0}


def distance(fit, name, truth=TRUTH):
    """How far a parameter is from the truth, in its standard errors."""
    return abs(fit.value(name) - truth[name]) / fit.standard_error(name)


@pytest.fixture(scope="module")
def fitted():
    return fit_axis(ROUGH, make(Axis(), seed=5))


@pytest.mark.parametrize("name", TRUTH)
def test_the_truth_is_within_its_errors(fitted, name):
    assert distance(fitted, name) < 3.5


def test_what_is_determined_well_says_so(fitted):
    assert fitted.standard_error("mass_kg") < 1e-3 * 95
    assert fitted.standard_error("k_v_N_s_per_m") < 0.01 * 200
    assert fitted.converged
    assert fitted.not_identifiable == ()


def test_the_force_that_ends_a_rest_is_that_of_break_away(fitted):
    assert abs(fitted.value("breakaway_N") - 24.0) < 3.5 * fitted.standard_error("breakaway_N")
    assert fitted.standard_error("breakaway_N") < 1.5


def test_so_it_is_where_friction_brakes_within_samples_and_noise_is_coloured():
    """A light axis under strong viscous friction, mass / k_v of eight samples: its first motion is
    that of the exact solution, not of a speed held from sample to sample. At rest a coloured noise
    strays by four times what neighbours differ by."""
    axis = Axis(mass=2.5, coulomb=6.0, breakaway=7.1, k_v=300.0, offset=2.9)
    rough = AxisSetup(mass=1.0, coulomb=2.0, k_v=900.0)
    rounds = {"speeds": (0.05, 0.1, 0.2, 0.1), "travel": 0.08, "scatter": 0.0}
    for colour in (0.0, 0.9):
        found = fit_axis(rough, make(axis, noise=1e-6, colour=colour, **rounds)).breakaway
        assert abs(found.value - 7.1) < 3 * found.standard_error
        assert found.standard_error < 0.2


def test_a_motion_from_rest_is_the_exact_solution():
    """x = u_e (t - tau (1 - exp(-t / tau))) under one force, tau = m / k_v; m x'' = F - F_c where
    k_v vanishes."""
    values = {"mass_kg": 2.0, "coulomb_N": 6.0, "k_v_N_s_per_m": 300.0}
    t = 1e-3 * np.arange(50)
    tau, end = 2.0 / 300.0, (9.0 - 6.0) / 300.0
    exact = end * (t + tau * np.expm1(-t / tau))
    np.testing.assert_allclose(_slide(np.full(50, 9.0), 1e-3, values), exact, atol=1e-15)
    free = _slide(np.full(50, 9.0), 1e-3, values | {"k_v_N_s_per_m": 0.0})
    np.testing.assert_allclose(free, 0.5 * 1.5 * t**2, rtol=1e-4)


def test_the_noise_of_the_encoder_is_found(fitted):
    assert fitted.noise.encoder == pytest.approx(1e-6, rel=0.1)
    assert fitted.noise.force < 0.01


def test_no_start_is_too_far():
    data = make(Axis(), seed=5)
    far, near = (fit_axis(replace(ROUGH, mass=m, coulomb=c), data) for m, c in ((1, 1), (95, 20)))
    for name in TRUTH:
        assert far.value(name) == pytest.approx(
            near.value(name), abs=0.1 * near.standard_error(name)
        )


@pytest.mark.parametrize("disturbance", [0.3, 3.0])
def test_forces_that_nothing_explains_widen_the_errors_and_bias_nothing(disturbance):
    fit = fit_axis(ROUGH, make(Axis(), seed=6, disturbance=disturbance))
    assert all(distance(fit, name) < 3.5 for name in TRUTH)
    assert fit.noise.force == pytest.approx(disturbance, rel=0.5)
    assert fit.noise.force_p_value < 1e-6
    assert all(abs(fit.value(x) / TRUTH[x] - 1) < 0.05 for x in ("mass_kg", "coulomb_N"))


def test_coloured_noise_of_the_encoder_widens_the_errors():
    white, coloured = (fit_axis(ROUGH, make(Axis(), seed=7, colour=c)) for c in (0.0, 0.95))
    assert coloured.standard_error("mass_kg") > 2 * white.standard_error("mass_kg")
    assert distance(coloured, "mass_kg") < 3.5


def test_a_recording_in_one_piece_is_cut_and_fitted():
    data = make(Axis(), given=False, seed=5)
    fit = fit_axis(ROUGH, data)
    assert len(fit.data) > 1
    assert all(abs(fit.value(x) / TRUTH[x] - 1) < 0.03 for x in TRUTH)


def test_a_single_direction_leaves_the_offset_open():
    made = record(Axis(), seed=8, speeds=(0.1, 0.2, 0.3))
    forwards = [
        AxisStretch(x.name, *(a[: np.argmax(x.position)] for a in (x.time, x.force, x.position)))
        for x in as_recording(made).stretches
    ]
    fit = fit_axis(ROUGH, AxisRecordings(forwards))
    (said,) = fit.not_identifiable
    assert said["parameters"] == ["offset_N", "coulomb_N"]
    assert "forwards only" in said["reason"]
    assert fit.standard_error("offset_N") is None
    assert fit.value("coulomb_N") == pytest.approx(20.0 + 3.0, rel=0.03)


def test_a_motion_that_is_imposed_gives_the_friction_and_leaves_the_mass_open():
    """Forces that answer to a slow motion: what acts is friction, noise and nothing else."""
    g = np.random.default_rng(9)
    t = np.arange(0, 40, 0.01)
    x = 0.02 * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * t / 8))
    force = 4.0 * np.sign(np.gradient(x)) - 0.75 + 0.3 * g.normal(size=len(t))
    data = AxisRecordings(
        [AxisStretch("1", t, force, x + 1e-5 * g.normal(size=len(t)))], are_given=False
    )
    fit = fit_axis(AxisSetup(mass=0.5, coulomb=1.0), data)
    assert fit.imposed
    assert [x["parameters"][0] for x in fit.not_identifiable] == ["mass_kg", "k_v_N_s_per_m"]
    assert fit.value("coulomb_N") == pytest.approx(4.0, rel=0.01)
    assert fit.value("offset_N") == pytest.approx(0.75, abs=0.03)


@pytest.mark.parametrize(("sign", "words"), [(-1, "is its sign"), (0, "is its channel the drive")])
def test_a_force_that_does_not_answer_to_an_imposed_motion_is_refused(sign, words):
    g = np.random.default_rng(9)
    t = np.arange(0, 40, 0.01)
    x = 0.02 * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * t / 8))
    force = sign * 4.0 * np.sign(np.gradient(x)) + 0.3 * g.normal(size=len(t))
    data = AxisRecordings([AxisStretch("1", t, force, x)], are_given=False)
    with pytest.raises(InputError, match=words):
        fit_axis(AxisSetup(mass=0.5, coulomb=1.0), data)


def test_a_late_drive_leaves_a_force_over_and_no_sure_break_away():
    """4 ms late, on an axis that breaks away at 24 N: the fit says that something is missing."""
    fit = fit_axis(ROUGH, make(Axis(delay=0.004), seed=5))
    assert distance(fit, "breakaway_N", {"breakaway_N": 24.0}) < 4
    assert any("diagnose looks for its cause" in note for note in fit.notes)


def test_parameters_that_are_held_stay():
    held = replace(ROUGH, k_v=190.0, extras={"k_v_N_s_per_m": AxisExtras(free=False)})
    fit = fit_axis(held, make(Axis(), seed=5))
    assert "k_v_N_s_per_m" not in fit.names
    assert fit.value("k_v_N_s_per_m") == 190.0
    assert fit_axis(ROUGH, make(Axis(), seed=5), free=["mass_kg"]).names == ("mass_kg",)
    with pytest.raises(InputError, match="no parameter mu_s"):
        fit_axis(ROUGH, make(Axis(), seed=5), free=["mu_s"])


def test_each_stretch_has_the_friction_that_it_had(fitted):
    made = record(Axis(), speeds=(0.05, 0.1, 0.2), travel=0.1, seed=5)
    truth = [20.0 * made.level[made.stretch == k][0] for k in range(3)]
    for levels in (fitted.levels, identify_axis(fitted, as_recording(made))):
        for level, expected in zip(levels, truth, strict=True):
            assert abs(level.coulomb - expected) < 4 * level.standard_error
            assert level.standard_error < 0.005 * expected


def test_a_mass_a_thousand_times_off_is_told_with_a_guess():
    data = make(Axis(), seed=5)
    wrong = [replace(x, position=1e3 * x.position) for x in data.stretches]
    fit = fit_axis(ROUGH, AxisRecordings(wrong))
    (note,) = (x for x in fit.notes if "a unit may be wrong" in x)
    assert "mm that is called m" in note


def test_a_force_of_the_wrong_sign_is_refused():
    data = make(Axis(), seed=5)
    wrong = AxisRecordings([replace(x, force=-x.force) for x in data.stretches])
    with pytest.raises(InputError, match="against the recorded force"):
        fit_axis(ROUGH, wrong)


def test_friction_that_falls_with_speed_is_told():
    axis = Axis(k_v=5.0, effects={"drag": -60.0})
    fit = fit_axis(ROUGH, make(axis, seed=5, speeds=(0.1, 0.15, 0.2)))
    assert fit.value("k_v_N_s_per_m") == 0
    assert any("friction falls with speed" in note for note in fit.notes)


def test_a_bound_holds():
    bounded = replace(ROUGH, extras={"mass_kg": AxisExtras(upper=90.0)})
    fit = fit_axis(bounded, make(Axis(), seed=5))
    assert fit.value("mass_kg") == 90.0
    assert fit.standard_error("mass_kg") is None
    assert any("mass_kg would be 95" in note for note in fit.notes)
