"""The push that would say most."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

import difffric as df
from difffric.calibration.optimal_push import next_push
from difffric.errors import InputError
from difffric.rig.sensors import ForceSensor
from tests.reference import data as reference
from tests.unit.calibration.designs import TRUTH, calibrate


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
    again = calibrate(known, more)
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
    again = calibrate(known, both)
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
    fit = calibrate(replace(known, rig=rig), pushes)
    push = next_push(fit, speeds=[0.02, 0.05, 0.5])
    assert push.peak_force <= limit and push.velocity < 0.5
    assert any("force sensor" in note for note in push.notes)
    with pytest.raises(InputError, match="none of 1 candidates can be used"):
        next_push(fit, speeds=[0.5])


def replace_sensor(rig, limit):
    return eqx.tree_at(lambda r: r.force_sensor, rig, ForceSensor(range=limit))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda fit: next_push(fit, target="mass_kg"), "target is mass_kg, expected one of k_N"),
        (lambda fit: next_push(fit, speeds=[-1.0]), "expected numbers > 0"),
        (lambda fit: next_push(fit, condition="WET"), "condition is WET"),
    ],
)
def test_bad_input_is_one_clear_line(coarse, call, message):
    with pytest.raises(InputError, match=message) as error:
        call(coarse[2])
    assert "\n" not in str(error.value)
