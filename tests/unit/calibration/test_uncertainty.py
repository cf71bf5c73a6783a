"""Error bars: profiles, what data leave open, and the push that would say most."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import difffric as df
from difffric.calibration.identifiability import identifiable
from difffric.calibration.optimal_push import next_push
from difffric.calibration.profiles import profile
from difffric.errors import InputError
from difffric.estimation.open_parameters import list_undetermined
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.rig import parameters
from difffric.rig.sensors import ForceSensor
from difffric.rig.setup import Extras, Setup
from tests.reference import data as reference

CALIBRATED = ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m", "mu_s")
ALL = (*CALIBRATED, "mu_k_over_mu_s")
STROKE = 1.2e-3
PAPER = {"mass": 18.9, "mu_s": 0.141, "k": 8.0e5, "b": 1500.0, "k_v": 5.0, "stroke": STROKE}
TRUTH = reference.Rig(
    m=18.5, mu_s=0.144, ratio=0.75, k_v=14.8, k=5.07e5, b=2160.0, scatter=0.016, stroke=STROKE
)
FAST = (0.03, 0.035, 0.04, 0.05, 0.06, 0.07, 0.08)


def setup(truth, scatter):
    """The set-up at the truth, its scatter known."""
    rig = df.spring_damper_rig(
        mass=truth.m, mu_s=truth.mu_s, k=truth.k, b=truth.b, k_v=truth.k_v,
        mu_k_over_mu_s=truth.ratio, stroke=truth.stroke, force_sensor=ForceSensor(range=5000.0),
    )  # fmt: skip
    return Setup(rig, scatter, {"friction.mu_s_scatter": Extras(free=False)})


def calibrated(known, pushes, free=CALIBRATED):
    fit = df.fit(known, pushes, free=free, several_starts=False, use_data_mass=True)
    assert fit.converged, fit
    return fit


@pytest.fixture(scope="module")
def exact():
    """Nearly exact data of one mu_s: the model is linear over the error bars."""
    truth, rng = replace(TRUTH, scatter=0.0), np.random.default_rng(3)
    pushes = reference.make_pushes(truth, rng)
    columns = reference.measure(pushes, rng, force_se=2e-3, distance_se=2e-9)
    known = setup(truth, 0.0)
    return known, df.Pushes(**columns), calibrated(known, df.Pushes(**columns))


@pytest.fixture(scope="module")
def coarse():
    """Noisy data with a scatter of 1.6 %."""
    rng = np.random.default_rng(5)
    pushes = reference.make_pushes(TRUTH, rng, 14)
    columns = reference.measure(pushes, rng, force_se=2.0, distance_se=1e-6)
    known = setup(TRUTH, TRUTH.scatter)
    return known, df.Pushes(**columns), calibrated(known, df.Pushes(**columns))


def test_profiles_are_gaussian_where_the_model_is_linear(exact):
    *_, fit = exact
    for found in profile(fit).values():
        assert found.note is None
        for level, ends in found.intervals.items():
            gauss = found.gaussian[level]
            assert ends == pytest.approx(gauss, abs=0.01 * (gauss[1] - gauss[0]))
        assert found.asymmetry == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("label", ["b_N_s_per_m", "k_N_per_m"])
def test_at_a_profiles_end_a_fit_of_the_others_is_worse_by_the_squared_quantile(
    coarse, label, side
):
    known, pushes, fit = coarse
    end = profile(fit, [label], levels=[0.95])[label].intervals[0.95][side]
    rig = parameters.with_values(known.rig, {**_values(fit), label: end})
    others = [x for x in CALIBRATED if x != label]
    there = calibrated(replace(known, rig=rig), pushes, free=others)
    assert np.isinf(fit.freedom).all()  # all variances are known
    assert there.chi2 - fit.chi2 == pytest.approx(1.959964**2, rel=0.02)


def _values(fit):
    return {label: fit.value(label) for label in fit.free}


def test_a_profile_rises_from_the_fit_and_wider_levels_contain_narrower_ones(coarse):
    *_, fit = coarse
    for found in profile(fit).values():
        value, rise = found.curve.T
        left, right = rise[value <= found.value], rise[value >= found.value]
        assert (np.diff(left) <= 1e-6).all() and (np.diff(right) >= -1e-6).all()
        assert rise.min() == pytest.approx(0.0, abs=1e-9)
        lows, highs = zip(*found.intervals.values(), strict=True)
        lows = [-np.inf if x is None else x for x in lows]
        highs = [np.inf if x is None else x for x in highs]
        assert sorted(lows, reverse=True) == lows and sorted(highs) == highs


def test_a_damping_that_the_bound_stops_has_an_open_side_that_says_so(coarse):
    known, pushes, _ = coarse
    bounded = replace(known, extras={**known.extras, "b_N_s_per_m": Extras(lower=TRUTH.b * 0.995)})
    fit = calibrated(bounded, pushes)
    found = profile(fit, ["b_N_s_per_m"])["b_N_s_per_m"]
    assert found.intervals[0.997][0] is None
    assert "bound" in found.reasons[0]
    assert found.reasons[1] is None


def test_the_information_of_a_push_is_what_a_fit_gains_by_it(exact):
    known, pushes, fit = exact
    v = 0.0456
    push = next_push(fit, speeds=[v])
    like = int(np.argmin(np.abs(np.log(pushes.velocity / v))))
    more = df.Pushes(
        velocity=np.append(pushes.velocity, v),
        peak_force=np.append(pushes.peak_force, push.peak_force),
        sliding_distance=np.append(pushes.sliding_distance, push.sliding_distance),
        mass=np.append(pushes.mass, push.mass),
        stroke=np.append(pushes.stroke, push.stroke),
        peak_force_se=np.append(pushes.peak_force_se, pushes.peak_force_se[like]),
        sliding_distance_se=np.append(pushes.sliding_distance_se, pushes.sliding_distance_se[like]),
    )
    again = calibrated(known, more)
    gained = np.linalg.inv(again.covariance) - np.linalg.inv(fit.covariance)
    size = np.sqrt(np.diag(np.linalg.inv(fit.covariance)))
    expected = push.candidates["information"][0]
    assert gained / np.outer(size, size) == pytest.approx(expected / np.outer(size, size), abs=1e-5)
    for label, error in push.after.items():
        assert again.standard_error(label) == pytest.approx(error, rel=1e-4)


def test_the_foreseen_standard_error_is_reached_by_making_the_push(coarse):
    known, pushes, fit = coarse
    target = "b_N_s_per_m"
    push = next_push(fit, target=target, masses=[5.0, 10.0, 18.5])
    rng = np.random.default_rng(8)
    truth = replace(TRUTH, m=push.mass)
    made = reference.make_pushes(truth, rng, 1, speeds=[push.velocity])
    new = reference.measure(made, rng, force_se=2.0, distance_se=1e-6)
    old = {name: getattr(pushes, name) for name in new}
    both = df.Pushes(**{name: np.append(old[name], new[name]) for name in new})
    again = calibrated(known, both)
    assert push.after[target] < 0.9 * push.before[target]
    assert again.standard_error(target) == pytest.approx(push.after[target], rel=0.1)


def test_the_best_push_is_the_best_of_its_candidates(coarse):
    *_, fit = coarse
    push = next_push(fit, masses=[10.0, 18.5])
    now = np.linalg.inv(fit.covariance)
    gains = [
        np.linalg.slogdet(now + A)[1] - np.linalg.slogdet(now)[1]
        for A in push.candidates["information"]
    ]
    i = int(np.argmax(gains))
    assert (push.velocity, push.mass) == tuple(push.candidates[x][i] for x in ("velocity", "mass"))
    assert push.gain == pytest.approx(max(gains), rel=1e-3)


def test_no_candidate_is_beyond_the_force_sensor(coarse):
    known, pushes, _ = coarse
    limit = float(np.max(pushes.peak_force)) * 1.05
    rig = replace_sensor(known.rig, limit)
    fit = calibrated(replace(known, rig=rig), pushes)
    push = next_push(fit, speeds=[0.02, 0.05, 0.5])
    assert push.peak_force <= limit and push.velocity < 0.5
    assert any("force sensor" in note for note in push.notes)
    with pytest.raises(InputError, match="none of 1 candidates can be used"):
        next_push(fit, speeds=[0.5])


@pytest.mark.slow
def test_from_recordings_profiles_are_gaussian_too_and_a_push_is_foreseen():
    rng = np.random.default_rng(4)
    made = reference.make_pushes(TRUTH, rng, 10)
    more = reference.make_pushes(TRUTH, rng, 1, speeds=[0.06])

    def recordings(pushes):
        taken = [reference.record(p, rng) for p in pushes]
        return Recordings(
            tuple(
                Recording(
                    velocity=x.push.velocity,
                    force=Channel.of(x.force, x.dt, x.start, "N"),
                    position=Channel.of(x.position, x.dt, x.start, "m"),
                    stroke=x.push.stroke,
                    mass=np.nan,
                )
                for x in taken
            )
        )

    known, first = setup(TRUTH, TRUTH.scatter), recordings(made)
    fit = calibrated(known, first)
    for found in profile(fit, levels=[0.95]).values():
        low, high = found.gaussian[0.95]
        assert found.intervals[0.95] == pytest.approx((low, high), abs=0.03 * (high - low))
    push = next_push(fit, speeds=[0.06])
    again = calibrated(known, Recordings((*first, *recordings(more))))
    for label in CALIBRATED:
        assert again.standard_error(label) == pytest.approx(push.after[label], rel=0.05)


def replace_sensor(rig, limit):
    return eqx.tree_at(lambda r: r.force_sensor, rig, ForceSensor(range=limit))


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


def test_after_the_fit_mu_s_is_not_apart_from_mu_k_where_nothing_sticks():
    rng = np.random.default_rng(2)
    made = reference.make_pushes(replace(TRUTH, b=6000.0), rng, 14, speeds=FAST)
    pushes = df.Pushes(**reference.measure(made, rng))
    known = setup(replace(TRUTH, b=6000.0), TRUTH.scatter)
    fit = df.fit(known, pushes, free=ALL, several_starts=False)
    (group,) = fit.not_identifiable
    assert set(group["parameters"]) == {"mu_s", "mu_k_over_mu_s"}
    assert "traded off" in group["reason"]
    assert "up 1 %" in group["reason"] and "down 1 %" in group["reason"]


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


def test_a_viscous_friction_that_may_be_zero_is_determined_where_it_is_bounded():
    names = ("k_v_N_s_per_m", "mu_s")
    quarter = np.array([0.5, 1.0])  # k_v: 5 N s/m, in coordinates
    assert list_undetermined(names, names, np.diag([0.4**2, 0.01**2]), quarter) == []
    (found,) = list_undetermined(names, names, np.diag([0.6**2, 0.01**2]), quarter)
    assert found["parameters"] == ["k_v_N_s_per_m"]
    assert "flat" in found["reason"] and "6 N s/m" in found["reason"]


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000), open_=st.integers(1, 3), order=st.permutations(list(range(5))))
def test_open_directions_are_found_whatever_the_order(seed, open_, order):
    """Flat parameters stay single, one direction's members stand together."""
    rng = np.random.default_rng(seed)
    information = np.diag(rng.uniform(10, 1e4, 5))
    for j in range(open_ - 1):
        information[j, j] = 1e-4
    information[3:, 3:] = 1e4 * np.array([[1.0, -1.0], [-1.0, 1.0 + 1e-12]])
    covariance = np.linalg.inv(information)
    labels = np.array(["k_N_per_m", "b_N_s_per_m", "mass_kg", "mu_s", "mu_k_over_mu_s"])
    order = np.array(order)
    found = list_undetermined(labels[order], labels[order], covariance[np.ix_(order, order)], np.ones(5))
    expected = [{x} for x in labels[: open_ - 1]] + [{"mu_s", "mu_k_over_mu_s"}]
    assert sorted(map(sorted, groups(found))) == sorted(map(sorted, expected))
    for entry in found:
        assert ("flat" in entry["reason"]) == (len(entry["parameters"]) == 1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda fit: profile(fit, ["mass_kg"]), "not free in this fit: mass_kg"),
        (lambda fit: profile(fit, levels=[95]), "expected numbers between 0 and 1"),
        (lambda fit: next_push(fit, target="mass_kg"), "target is mass_kg, expected one of k_N"),
        (lambda fit: next_push(fit, speeds=[-1.0]), "expected numbers > 0"),
        (lambda fit: next_push(fit, condition="WET"), "condition is WET"),
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
