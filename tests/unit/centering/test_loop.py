"""The loop on a machine that is not the library's: rings end within the tolerance, fast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from difffric import centre, spring_damper_rig
from difffric.centering import Belief, Known
from difffric.centering.loop import identify_push
from difffric.centering.machine import PushReadings, SimulatedMachine
from difffric.centering.planning import WITHIN
from difffric.commands.reports.centre import assess_probabilities, describe_centering
from difffric.rig import extended
from difffric.studies.centering_runs import OURS, draw_rings, run_rings
from difffric.studies.other_centering import NOMINAL, RIVALS, SLOWEST, SURROGATES
from difffric.units import from_um
from tests.unit.centering.reference_machine import ReferenceMachine

LAWS = {"m": 18.9, "ratio": 0.75, "k_v": 5.0, "k": 8e5, "b": 1500.0}
RIG = spring_damper_rig(mass=18.9, mu_s=0.141, mu_k_over_mu_s=0.75, k_v=5.0, k=8e5, b=1500.0)
KNOWN = Known(RIG, Belief.uniform(0.08, 0.25, 0.015))


@pytest.fixture(scope="module")
def independent():
    """(machine, centering) of forty rings before the tests' own pushes."""
    out = []
    for ring in draw_rings(40, seed=11):
        random = np.random.default_rng(ring.seed)
        machine = ReferenceMachine(LAWS, ring.offset, random, mean=ring.mu_s)
        out.append((machine, centre(machine, KNOWN)))
    return out


def test_every_ring_ends_within_the_tolerance(independent):
    assert all(np.hypot(*machine.offset) <= WITHIN for machine, _ in independent)
    assert all(c.reason is None and c.probability >= 0.99 for _, c in independent)


def test_two_pushes_and_one_measurement_are_the_rule(independent):
    assert np.median([len(c.pushes) for _, c in independent]) == 2
    assert np.median([c.measurements for _, c in independent]) == 1
    for _, c in independent:
        own = sum(p.readings.duration for p in c.pushes)
        assert c.time == pytest.approx(2 * c.measurements + len(c.pushes) + own)


def test_what_the_loop_believes_of_mu_s_holds(independent):
    """The truth lies within three deviations of the mean in the end, nearly always."""
    off = []
    for machine, c in independent:
        if c.pushes:
            mean, spread = c.mu_s.mean
            off.append(np.log(mean / machine.mean) / spread)
    assert np.mean(np.abs(off) < 3) > 0.95
    assert np.std(off) < 1.5


def test_where_the_ring_is_believed_to_be_it_is(independent):
    errors = [np.hypot(*(c.offset - m.offset)) / c.deviation for m, c in independent]
    assert np.mean(np.square(errors)) < 2.5  # one along the push, a little across


@pytest.mark.parametrize("mu_s", [0.08, 0.16, 0.25])
@pytest.mark.parametrize("stroke_um", [30.0, 300.0, 2000.0])
def test_a_push_tells_its_own_mu_s(mu_s, stroke_um):
    """Normalised errors over pushes of the tests' own code."""
    off = []
    for seed in range(12):
        random = np.random.default_rng(seed)
        machine = ReferenceMachine(LAWS, [1e-2, 0.0], random, mean=mu_s, scatter=0.0)
        read = machine.push(0.05, from_um(stroke_um), 0.0)
        found = identify_push(KNOWN, 0.05, from_um(stroke_um), read)
        if found.mu_s is not None:
            off.append(np.log(found.mu_s / mu_s) / found.error)
    assert len(off) > 6 and np.sqrt(np.mean(np.square(off))) < 1.7


def test_readings_that_say_nothing_change_nothing():
    nan = float("nan")
    blind = PushReadings(nan, 0.5, nan, 3e-7, nan, 4e-7, 0.1)
    told = identify_push(KNOWN, 0.05, 3e-4, blind)
    assert told.mu_s is None and (told.likelihood == 1).all()
    after = KNOWN.mu_s.update_with_likelihood(told.log_mu_s, told.likelihood)
    np.testing.assert_allclose(after.weight, KNOWN.mu_s.weight, atol=1e-9)


def test_a_part_that_did_not_move_tells_that_friction_is_not_small():
    """A tip that stops before any friction above 0.15 lets go."""
    stroke, velocity = from_um(20.0), 500e-3 / 60
    machine = ReferenceMachine(LAWS, [1e-2, 0.0], np.random.default_rng(0), mean=0.22, scatter=0.0)
    read = machine.push(velocity, stroke, 0.0)
    assert abs(read.displacement) < 2e-6
    told = identify_push(KNOWN, velocity, stroke, read)
    after = KNOWN.mu_s.update_with_likelihood(told.log_mu_s, told.likelihood)
    least = after.quantiles(np.array([0.01]))[0]
    assert 0.09 < least < 0.22 and after.quantiles(np.array([0.99]))[0] > 0.24


def test_faster_than_the_other_ways():
    """Without shared code the paired study is studies/centering.py, with 500 rings."""
    found = list(
        run_rings(KNOWN, draw_rings(12, seed=4), ways=(OURS, SURROGATES, NOMINAL, SLOWEST))
    )
    ways = describe_centering(found, KNOWN, 4)["ways"]
    assert ways[OURS]["centred"] == 1.0
    for way in (NOMINAL, SLOWEST):
        assert ways[OURS]["time_median_s"] < 2 / 3 * ways[way]["time_median_s"]
    assert ways[OURS]["time_mean_s"] < ways[SURROGATES]["time_mean_s"]


def test_every_way_meets_the_same_ring():
    found = list(run_rings(KNOWN, draw_rings(1, seed=2)))
    assert [r.way for r in found] == [OURS, *RIVALS]
    starts = np.array([r.path[0] for r in found])
    assert (starts == starts[0]).all()


def test_a_hidden_effect_and_drift_do_not_keep_a_ring_from_its_target():
    truth = extended(RIG, {"tilt": {"alpha_rad": 2e-3}})
    known = replace(KNOWN, mu_s=Belief.uniform(0.08, 0.25, 0.015, drift=0.005))
    found = list(run_rings(known, draw_rings(4, 3), truth=truth, ways=(OURS,), drift=0.005))
    assert all(r.is_centred(WITHIN) for r in found)


def test_verifying_measures_at_the_end():
    machine = SimulatedMachine(RIG, np.array([3e-4, 0.0]), np.random.default_rng(0))
    c = centre(machine, KNOWN, verify=True)
    assert c.events[-1][0] == "measure" and c.measurements >= 2


def test_a_ring_that_is_centred_is_left_alone():
    machine = SimulatedMachine(RIG, np.array([5e-7, 5e-7]), np.random.default_rng(0))
    c = centre(machine, KNOWN)
    assert not c.pushes and c.time == 2.0 and c.reason is None


def test_a_loop_that_does_not_come_to_its_end_says_so():
    machine = SimulatedMachine(RIG, np.array([4e-3, 0.0]), np.random.default_rng(0))
    c = centre(machine, KNOWN, most=1)
    assert c.reason == "not centred after 1 pushes" and len(c.pushes) == 1


def test_a_probe_whose_scale_is_off_is_noticed_when_the_ring_is_measured_again():
    rig = extended(RIG, {"probe_scale": {"factor": 1.01}})
    machine = SimulatedMachine(rig, np.array([4e-3, 0.0]), np.random.default_rng(0))
    c = centre(machine, KNOWN, verify=True)
    assert any("its scale, or what moves beside the part" in note for note in c.notes)


def test_the_slope_of_calibrated_statements_is_one():
    random = np.random.default_rng(0)
    stated = random.uniform(0, 1, 4000)
    for slope in (1.0, 0.5):
        landed = random.random(4000) < 0.5 + slope * (stated - 0.5)
        found = assess_probabilities(stated, landed.astype(float))
        assert abs(found["slope"] - slope) < 4 * found["slope_standard_error"]
        assert 0.01 < found["slope_standard_error"] < 0.05
