"""Planned pushes: what they promise against what the tests' own pushes do."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from difffric import InputError, plan, spring_damper_rig
from difffric.centering import Belief, Known
from difffric.centering.planning import (
    _SHARES,
    WITHIN,
    find_options,
    find_probability,
    space_speeds,
)
from difffric.rig import parameters
from difffric.rig.setup import Extras, Setup
from difffric.units import from_mm_min, from_um
from tests.reference import traces

LAWS = {"m": 18.9, "ratio": 0.75, "k_v": 5.0, "k": 8e5, "b": 1500.0}
RIG = spring_damper_rig(mass=18.9, mu_s=0.141, mu_k_over_mu_s=0.75, k_v=5.0, k=8e5, b=1500.0)
SCATTER = 0.015
ONE_PUSH = Belief.normal(0.141, 0.015, SCATTER)
SURE = {"k_N_per_m": 0.0, "b_N_s_per_m": 0.0}
"""named everywhere, so that one program is compiled"""
KNOWN = Known(RIG, ONE_PUSH, errors=SURE)


def displaced(step, mu_s, **other):
    """[m], by the tests' own code."""
    laws = {**LAWS, **other}
    return traces.follow(mu_s=mu_s, v=step.velocity, stroke=step.stroke, **laws).answer.states[-1].x


def misses(step, random, n=1500, *, mean=0.141, relative=0.0212, offset=0.0, k=0.0):
    """(n,) where the tests' own pushes land, less the aim [m]."""
    return np.array(
        [
            displaced(step, mean * math.exp(relative * a), k=LAWS["k"] + k * b)
            - step.aim
            + offset * c
            for a, b, c in random.standard_normal((n, 3))
        ]
    )


def agrees(stated, hits):
    """Whether hits of n trials agree with a probability, to four deviations."""
    n = len(hits)
    error = math.sqrt(max(stated * (1 - stated), 1 / n) / n)
    return abs(np.mean(hits) - stated) < 4 * error + 2e-3


@pytest.mark.parametrize("um", [5.0, 20.0, 100.0, 400.0, 1500.0, 5000.0])
def test_the_stated_probability_is_how_often_it_lands(um):
    first = plan(KNOWN, from_um(um), from_um(0.2)).options
    random = np.random.default_rng(int(um))
    for i in (0, 5, 10, 15):
        step = step_of(first, i, from_um(um))
        miss = misses(step, random, 600, offset=from_um(0.2))
        assert agrees(first.probability[0, i], np.abs(miss) <= WITHIN)


def step_of(first, i, aim):
    """What the tests need of one speed's push."""

    class Step:
        velocity, stroke = float(first.velocity[i]), float(first.stroke[0, i])

    Step.aim = aim
    return Step


def test_an_unsure_calibration_counts():
    known = replace(KNOWN, errors=SURE | {"k_N_per_m": 4e4})
    found = plan(known, from_um(300.0)).options
    sure = plan(KNOWN, from_um(300.0)).options
    random = np.random.default_rng(0)
    i = int(np.argmax(sure.probability[0]))
    assert found.probability[0, i] < sure.probability[0, i] - 0.02
    miss = misses(step_of(found, i, from_um(300.0)), random, 1500, k=4e4)
    assert agrees(found.probability[0, i], np.abs(miss) <= WITHIN)


@settings(max_examples=25, deadline=None)
@given(um=st.floats(4.0, 4000.0), mu_s=st.floats(0.08, 0.25))
def test_no_faster_push_is_as_sure(um, mu_s):
    known = replace(KNOWN, mu_s=Belief.normal(mu_s, 0.01, SCATTER))
    found = plan(known, from_um(um), from_um(0.1))
    first, step = found.options, found.next
    sure = np.nan_to_num(first.probability[0]) >= 0.99
    if sure.any():
        assert len(found.steps) == 1 and step.probability >= 0.99
        assert step.duration == first.duration[0][sure].min()
    else:
        assert found.probability >= np.nanmax(first.probability[0]) - 1e-12


def test_several_pushes_land_as_often_as_is_said():
    """The plan's second push is made anew from where the first one left the part."""
    known = KNOWN
    found = plan(known, from_um(100.0), from_um(0.1))
    assert len(found.steps) > 1 and found.next.probability < 0.99
    random = np.random.default_rng(5)
    hits = []
    for _ in range(150):
        mean = 0.141 * math.exp(0.015 * random.standard_normal())
        first = mean * math.exp(SCATTER * random.standard_normal())
        left = from_um(100.0) - displaced(found.next, first)
        if abs(left) > WITHIN:
            told = replace(known, mu_s=known.mu_s.update_with_value(first, 0.005))
            second = plan(told, abs(left), from_um(0.1)).next
            own = mean * math.exp(SCATTER * random.standard_normal())
            left = abs(left) - displaced(second, own)
        hits.append(abs(left) <= WITHIN)
    assert agrees(found.probability, hits)


def test_what_limits_a_push_is_named():
    exact = Belief.normal(0.141, 0.0, 0.0)
    known = replace(KNOWN, mu_s=exact, speeds=space_speeds(0.05, 0.05))
    assert plan(known, from_um(300.0), from_um(2.0)).next.limited_by == "offset"
    assert plan(replace(known, mu_s=ONE_PUSH), from_um(300.0)).next.limited_by == "mu_s"
    unsure = replace(known, errors=SURE | {"b_N_s_per_m": 300.0})
    assert plan(unsure, from_um(300.0)).next.limited_by == "b_N_s_per_m"


def test_a_set_up_says_what_is_known():
    errors = {"k_N_per_m": 2e3, "b_N_s_per_m": 5.0}
    extras = {name: Extras(x) for name, x in errors.items()}
    extras |= {"mu_s": Extras(0.0141), "pusher.stroke_mm": Extras(0.1)}
    known = Known.of(Setup(RIG, 0.02, extras))
    assert known.errors == errors and known.mu_s.scatter == 0.02
    assert known.mu_s.mean == pytest.approx((0.141, 0.1), rel=0.01)
    same = plan(Setup(RIG, 0.02, extras), 1e-4)
    assert same.next == plan(known, 1e-4).next


def test_an_extended_rig_is_planned_with_as_it_is():
    """Hertz's contact: its displacement by the library's other integrator is the target."""
    from difffric import simulate
    from difffric.rig import extended
    from difffric.simulation import RungeKutta

    rig = extended(RIG, {"contact_hardening": {"exponent": 1.2}})
    step = plan(Known(rig, ONE_PUSH, speeds=space_speeds(0.02, 0.02)), from_um(200.0)).next
    seen = simulate(rig, step.velocity, stroke=step.stroke, integrator=RungeKutta()).observables
    plain = simulate(RIG, step.velocity, stroke=step.stroke).observables
    assert abs(float(seen.displacement) - from_um(200.0)) < WITHIN
    assert abs(float(plain.displacement) - from_um(200.0)) > 2 * WITHIN


@settings(max_examples=40, deadline=None)
@given(
    a=st.floats(-20e-6, 20e-6), b=st.floats(-60e-6, 60e-6), sigma=st.floats(0.0, 3e-6),
    curve=st.floats(0.0, 2.0),
)  # fmt: skip
def test_the_probability_of_a_landing_is_its_integral(a, b, sigma, curve):
    u = _SHARES - 0.5
    landing = a + b * (u + curve * u**3)
    random = np.random.default_rng(0)
    share = (np.arange(200_000) + 0.5) / 200_000
    x = np.interp(share, _SHARES, landing) + sigma * random.standard_normal(200_000)
    seen = np.mean(np.abs(x) <= WITHIN)
    assert float(find_probability(landing, np.array(sigma), WITHIN)) == pytest.approx(
        seen, abs=6e-3
    )


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (0.0, "expected a distance > 0, got 0 um"),
        (math.nan, "expected a distance > 0, got nan um"),
        (0.03, "30 mm is out of reach: the rails allow 20 mm"),
    ],
)
def test_a_target_out_of_reach_is_one_clear_line(target, words):
    with pytest.raises(InputError, match=words):
        plan(RIG, target)


def test_a_jump_that_no_push_can_make_smaller_is_one_clear_line():
    """At 500 mm/min a part with mu_s = 0.375 breaks away by more than 7 um."""
    rig = parameters.with_values(RIG, {"mu_s": 0.375})
    known = Known(rig, Belief.normal(0.375, 0.0, 0.0), speeds=space_speeds(*[from_mm_min(500)] * 2))
    with pytest.raises(
        InputError, match="500 and 500 mm/min no push that can be followed ends 7 um"
    ):
        plan(known, from_um(7.0))


def test_an_empty_range_of_speeds_is_one_clear_line():
    with pytest.raises(InputError, match="expected 0 < lowest <= highest, got 3000 to 600 mm/min"):
        space_speeds(0.05, 0.01)


def test_targets_at_once_are_those_one_by_one():
    known = KNOWN
    both = find_options(known, np.array([3e-5, 7e-4]), 1e-7)
    one = find_options(known, np.array([7e-4]), 1e-7)
    np.testing.assert_allclose(both.stroke[1], one.stroke[0], rtol=1e-9)
    np.testing.assert_allclose(both.probability[1], one.probability[0], atol=1e-6)
