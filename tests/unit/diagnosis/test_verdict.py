"""What an effect changes, in absolute terms, and the friction that each push had."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import difffric as df
from difffric.diagnosis import conclusion
from difffric.diagnosis.inferred.changes import compare_readings, measure_changes
from difffric.diagnosis.inferred.friction import find_friction
from difffric.estimation.effect_coordinates import Coordinates
from difffric.rig import catalogue

RIG = df.spring_damper_rig(
    mass=18.9, mu_s=0.14, mu_k_over_mu_s=0.75, k_v=5.0, k=8e5, b=1500.0, stroke=2e-3
)
SHARE, REST = np.array([0.0, 0.5, 1.0]), np.array([0.0, 9.0, 99.0])


def place(effects, own=0.0):
    """Three pushes of a rig with effects, and a fit at their sizes (an ensemble of one). F_p goes
    with the root of mu_s, d with its square's inverse, a gain and a scale apart."""
    there = catalogue.extended(RIG, {name.partition(".")[0]: {} for name in effects})
    coordinates = Coordinates.of(there)
    c = np.zeros((1, len(coordinates.names)))
    c[0, coordinates.indices(tuple(effects))] = coordinates.point(effects)

    def answer(index, c, directions):
        values = np.array([coordinates.values(row, tuple(effects)) for row in c])
        size = dict(zip(effects, values.T, strict=True))
        force = np.exp(0.5 * c[:, 0]) * size.get("force_gain.factor", 1.0)
        distance = np.exp(-2 * c[:, 0]) * size.get("probe_scale.factor", 1.0)
        return SimpleNamespace(model=np.stack([force, distance], axis=1))

    pushes = SimpleNamespace(share=SHARE, rest=REST)
    model = SimpleNamespace(coordinates=coordinates, pushes=pushes, answers=answer)
    task = SimpleNamespace(condition=np.zeros(3, int), n=3, model=model)
    mu, own = np.array([[np.log(0.14)]]), np.full((1, 3), own)
    null = SimpleNamespace(c=np.zeros_like(c), mu=mu, own=np.zeros_like(own))
    return task, null, SimpleNamespace(c=c, mu=mu, own=own)


def test_the_friction_of_a_push_has_the_drift_and_the_dwell_in_it():
    task, _, fits = place({"friction_drift.drift": 0.1, "static_dwell.amplitude": 0.02})
    expected = 0.14 * (1 + 0.1 * SHARE) * (1 + 0.02 * np.log(1 + REST))
    np.testing.assert_allclose(np.exp(find_friction(task, fits)), expected, rtol=1e-12)


def test_without_growth_in_rest_the_friction_is_that_which_slides():
    task, _, fits = place({"friction_drift.drift": 0.1, "static_dwell.amplitude": 0.02})
    np.testing.assert_allclose(
        np.exp(find_friction(task, fits, grown=False)), 0.14 * (1 + 0.1 * SHARE), rtol=1e-12
    )


@pytest.mark.parametrize("matters", [True, False])
def test_growth_in_rest_is_told_with_the_friction_where_it_is_a_cause(monkeypatch, matters):
    task, null, fits = place({"static_dwell.amplitude": 0.02})
    task.counts, lack = np.ones(3), SimpleNamespace(chi2=np.ones(3))
    monkeypatch.setattr(conclusion, "measure_lack_of_fit", lambda *_: lack)
    monkeypatch.setattr(conclusion, "compute_friction_errors", lambda *_: np.zeros(3))
    one = SimpleNamespace(best=SimpleNamespace(effect="static_dwell"))
    found: Any = SimpleNamespace(
        setup=df.Setup(RIG), data=SimpleNamespace(task=task), plain=null, whole=fits,
        friction=None, unseen=0.0, causes=(one,) * matters, slight=(one,) * (not matters),
    )  # fmt: skip
    friction, _ = conclusion._infer_friction(found, fits, location=None)
    growth = 1 + 0.02 * np.log(1 + REST)
    np.testing.assert_allclose(np.exp(friction), 0.14 * (growth if matters else 1), rtol=1e-12)


def test_a_push_on_an_edge_does_not_hide_what_others_show():
    slope = np.array([-2.0] * 6 + [-500.0])

    def answer(index, c, directions):
        distance = np.exp(slope[index] * c[:, 0]) * (1 + c[:, 1])
        return SimpleNamespace(model=np.stack([np.ones(len(c)), distance], axis=1))

    task = SimpleNamespace(n=len(slope), model=SimpleNamespace(answers=answer))
    with_it, without = np.zeros((2, len(slope), 2))
    with_it[:, 1] = 0.03
    found = compare_readings(task, with_it, without)
    assert (found.force, found.distance) == (0.0, pytest.approx(0.03))
    assert 0.01 < found.as_mu_s < 0.03 / 2
    assert found.of_most == pytest.approx(0.03)
    with_it[0, 1] = 3.0  # a push that jumps says nothing of the others
    found = compare_readings(task, with_it, without)
    assert found.distance > 0.5 and found.of_most == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("name", "as_mu_s"), [("force_gain.factor", 0.02), ("probe_scale.factor", 0.005)]
)
def test_a_reading_counts_as_the_change_of_mu_s_that_changes_it_as_much(name, as_mu_s):
    task, without, at = place({name: 1.01})
    changes = measure_changes(task, without, at, name.partition(".")[0])
    both = changes.peak_force, changes.sliding_distance
    assert sorted(both) == pytest.approx([0.0, 0.01], rel=1e-9, abs=1e-12)
    assert changes.as_mu_s == pytest.approx(as_mu_s, rel=1e-5)
    assert changes.mu_s == 0.0


def test_what_the_inferred_mu_s_takes_up_counts_too():
    task, without, at = place({"force_gain.factor": 1.0001}, own=0.03)
    assert measure_changes(task, without, at, "force_gain").as_mu_s == pytest.approx(0.03)
