"""Where a push leaves the part, against an independent solution; the stroke as its inverse."""

from __future__ import annotations

import math

import jax
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from difffric import observe, simulate, spring_damper_rig
from difffric.centering.landing import find_landings, find_strokes
from difffric.rig import extended, parameters
from difffric.simulation import RungeKutta
from difffric.units import from_mm_min, from_um
from tests.reference import traces

RIG = spring_damper_rig(mass=18.9, mu_s=0.141, mu_k_over_mu_s=0.75, k_v=5.0, k=8e5, b=1500.0)

BY = ("mu_s", "k_N_per_m", "b_N_s_per_m")
"""always the same, so that one program is compiled"""

speeds = st.floats(500.0, 5000.0).map(from_mm_min)
strokes = st.floats(math.log(5.0), math.log(5000.0)).map(lambda x: from_um(math.exp(x)))
frictions = st.floats(0.05, 0.4)
contacts = st.tuples(
    st.floats(1e5, 3e6), st.floats(0.0, 4000.0), st.floats(0.5, 1.0), st.floats(0.0, 60.0)
)


def reference(v, stroke, mu_s, k=8e5, b=1500.0, ratio=0.75, k_v=5.0, m=18.9):
    """(displacement [m], duration [s]) by the tests' own code; None: more contacts than are
    followed, or a rest that only comes for t to infinity."""
    try:
        course = traces.follow(m, mu_s, ratio, k_v, k, b, v, stroke)
    except ValueError:
        return None
    last = course.answer.states[-1]
    return (last.x, course.end) if math.isfinite(course.end) else None


@settings(max_examples=150, deadline=None)
@given(v=speeds, stroke=strokes, mu_s=frictions, contact=contacts)
# Undamped, the part stops just where the pusher catches it again, or its speed just touches zero.
@example(v=500 / 6e4, stroke=4.034287934927351e-4, mu_s=0.25, contact=(656203.0, 0.0, 0.5, 0.0))
@example(v=500 / 6e4, stroke=4.034287934927351e-4, mu_s=0.25, contact=(659392.0, 0.0, 1.0, 0.0))
@example(
    v=500 / 6e4,
    stroke=1.0966331584284584e-3,
    mu_s=0.08352508085798377,
    contact=(405196.0, 0.0, 0.5, 0.0),
)
def test_displacement_is_the_independent_one(v, stroke, mu_s, contact):
    k, b, ratio, k_v = contact
    rig = spring_damper_rig(mass=18.9, mu_s=mu_s, mu_k_over_mu_s=ratio, k_v=k_v, k=k, b=b)
    expected = reference(v, stroke, mu_s, k, b, ratio, k_v)
    found = find_landings(rig, v, stroke, mu_s)
    if expected is None:
        assert np.isnan(found.displacement[0])
        return
    x, end = expected
    assert found.displacement[0] == pytest.approx(x, rel=1e-9, abs=1e-12)
    assert found.duration[0] == pytest.approx(max(end, stroke / v), rel=1e-9)


@settings(max_examples=60, deadline=None)
@given(v=speeds, stroke=strokes, mu_s=frictions)
def test_displacement_is_where_the_trajectory_ends(v, stroke, mu_s):
    push = simulate(RIG, v, stroke=stroke, mu_s=mu_s)
    seen = push.observables
    assert float(seen.displacement) == pytest.approx(
        float(push.position(seen.duration)), rel=1e-9, abs=1e-13
    )
    if not push.reason:
        assert float(seen.displacement) > float(seen.sliding_distance) * (1 - 1e-12)


@settings(max_examples=60, deadline=None)
@given(v=speeds, stroke=strokes, further=st.floats(1.0, 1.5), mu_s=frictions)
def test_a_longer_stroke_never_brings_the_part_less_far(v, stroke, further, mu_s):
    near, far = find_landings(RIG, v, [stroke, stroke * further], mu_s).displacement
    assert far >= near - 1e-15


@settings(max_examples=80, deadline=None)
@given(v=speeds, target=strokes, mu_s=frictions)
def test_the_stroke_to_a_target_ends_there(v, target, mu_s):
    """By the tests' own code, which does not know how the stroke was found. Where there is none,
    the part breaks away with a jump, and the target lies within it."""
    stroke = float(find_strokes(RIG, v, target, mu_s, target + 1e-3, by=BY).stroke[0])

    def x(stroke):
        return reference(v, stroke, mu_s)[0]

    if np.isfinite(stroke):
        assert x(stroke) == pytest.approx(target, abs=2e-9)
        return
    short, far = 0.0, target + 1e-3
    for _ in range(60):
        middle = 0.5 * (short + far)
        short, far = (middle, far) if x(middle) < target else (short, middle)
    assert x(short) == 0 and x(far) > target + 1e-9


def test_derivatives_are_the_independent_ones():
    """Central differences of the independent solution, away from where regimes change."""
    names = ("mu_s", "k", "b")
    values = {"mu_s": 0.141, "k": 8e5, "b": 1500.0}
    random = np.random.default_rng(3)
    smooth = 0
    for _ in range(40):
        v, target = from_mm_min(random.uniform(500, 5000)), from_um(random.uniform(5, 3000))
        found = find_strokes(RIG, v, target, 0.141, target + 1e-3, by=BY)
        S = float(found.stroke[0])
        slopes = [float(found.by_stroke[0]), *(float(found.by[name][0]) for name in BY)]
        for name, ours in zip(("stroke", *names), slopes, strict=True):
            at = values | {"stroke": S}

            def x(step, v=v, name=name, at=at):
                return reference(v, **(at | {name: at[name] * (1 + step)}))[0] / at[name]

            h = 2e-6
            right, left = (x(h) - x(0.0)) / h, (x(0.0) - x(-h)) / h
            if abs(right - left) > 1e-3 * (abs(right) + abs(left)):
                continue  # a kink, or too curved for this step
            smooth += 1
            assert ours == pytest.approx((x(h) - x(-h)) / (2 * h), rel=2e-5, abs=1e-6 * abs(S))
    assert smooth > 100


def test_a_target_beyond_the_longest_stroke_has_none():
    assert np.isnan(find_strokes(RIG, 0.05, 1.0, 0.141, 1e-3, by=BY).stroke[0])


def test_both_ways_to_integrate_agree():
    for v, stroke in ((0.0085, 4e-4), (0.03, 1e-4), (0.08, 2e-3)):
        rig = parameters.with_stroke(RIG, stroke)
        one, other = observe(rig, v), observe(rig, v, RungeKutta())
        assert float(one.displacement) == pytest.approx(float(other.displacement), rel=1e-8)
        assert float(one.duration) == pytest.approx(float(other.duration), rel=1e-8)


def test_an_effect_at_its_null_lands_where_the_plain_rig_does():
    rig = extended(RIG, {"contact_hardening": {}})
    plain, same = (find_landings(r, 0.03, [2e-4, 1e-3], 0.141).displacement for r in (RIG, rig))
    np.testing.assert_allclose(same, plain, rtol=1e-8)


def test_the_probe_does_not_move_the_part():
    """The displacement is the rig's: what the probe reads of it is another thing."""
    rig = extended(RIG, {"probe_scale": {"factor": 1.1}})
    plain, same = (find_landings(r, 0.03, 1e-3, 0.141).displacement for r in (RIG, rig))
    np.testing.assert_allclose(same, plain, rtol=1e-8)


def test_displacement_can_be_differentiated_twice():
    def x(stroke):
        return observe(parameters.with_stroke(RIG, stroke), 0.05).displacement

    h = 1e-8
    slope = jax.jacfwd(x)
    second = float(jax.jacfwd(slope)(3e-4))
    assert second == pytest.approx(
        (float(slope(3e-4 + h)) - float(slope(3e-4 - h))) / 2 / h, rel=1e-4
    )
