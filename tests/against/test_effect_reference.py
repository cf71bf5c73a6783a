"""The reference simulator of pushes with effects, in plain Python, against what is known of it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.reference import effect_cases, effects, exact, ode
from tests.reference.effect_derivatives import derivatives
from tests.reference.effect_parameters import BASE, EFFECTS, GRAVITY, TABLE, own, vector

CASES = effect_cases.load()
PLAIN = json.loads((Path(__file__).parents[1] / "reference" / "cases.json").read_text())["cases"]
ARGUMENTS = dict(zip(("m", "mu_s", "ratio", "k_v", "k", "b", "v", "stroke"), BASE, strict=True))
RIG = {"m": 14.0, "mu_s": 0.16, "ratio": 0.75, "k_v": 12.0, "k": 6e5, "b": 900.0, "v": 0.03}
RIG |= {"stroke": 1.2e-3}


def push(effect=None, **rig):
    return effects.push({ARGUMENTS[name]: x for name, x in rig.items()} | (effect or {}))


def same(answer, plain, *, force=1e-12, distance=1e-11):
    assert (answer.regime, answer.contacts) == (plain.regime, plain.contacts)
    assert answer.peak_force == pytest.approx(float(plain.peak_force), rel=force)
    if plain.sliding_distance is None:
        assert answer.sliding_distance is None
    else:
        assert answer.sliding_distance == pytest.approx(float(plain.sliding_distance), rel=distance)


@pytest.mark.parametrize("group", [*EFFECTS, "all"])
def test_the_stored_answer_is_the_reference_s(group):
    with_d = [c for c in CASES if c.group == group and c.sliding_distance is not None]
    case = min(with_d, key=lambda case: case.steps)
    answer = effects.push(case.rig)
    assert (answer.regime, answer.contacts) == (case.regime, case.contacts)
    assert answer.sticks == case.sticks
    assert answer.peak_force == pytest.approx(case.peak_force, rel=1e-11)
    assert answer.sliding_distance == pytest.approx(case.sliding_distance, rel=1e-10)


def test_every_group_has_its_effect_its_derivatives_and_enough_distances():
    for group in (*EFFECTS, "all"):
        cases = [c for c in CASES if c.group == group]
        assert np.mean([c.sliding_distance is not None for c in cases]) >= 0.5
        for case in cases:
            parameters = set(case.d_peak_force)
            assert set(BASE) - {"stroke_m"} <= parameters
            assert group == "all" or set(own(group)) <= parameters
            assert (case.sliding_distance is None) == (not case.d_sliding_distance)


@pytest.mark.parametrize("regime", ["pushed_to_rest", "released_by_rebound", "released_at_stop"])
def test_without_effects_it_is_the_plain_model(regime):
    cases = [c for c in PLAIN if c["regime"] == regime and c["stroke_m"] and not c.get("near_edge")]
    for case in sorted(cases, key=lambda c: c["segments"])[::60][:3]:
        answer = effects.push({name: case[name] for name in BASE})
        assert (answer.regime, answer.contacts) == (case["regime"], case["contacts"])
        assert answer.peak_force == pytest.approx(case["F_p_N"], rel=1e-12)
        if case["d_m"] is None:
            assert (answer.sliding_distance, answer.reason) == (None, "rests in contact")
        else:
            assert answer.sliding_distance == pytest.approx(case["d_m"], rel=1e-11)


def test_effects_that_are_another_plain_push():
    a, weight = 0.02, RIG["m"] * GRAVITY
    static, kinetic = (mu * math.cos(a) + math.sin(a) for mu in (0.16, 0.12))
    dwell = 1 + 0.03 * math.log1p(100)
    for effect, changed in (
        ({"tilt.alpha_rad": a}, {"mu_s": static, "ratio": kinetic / static}),
        ({"normal_force.extra_N": 0.2 * weight}, {"mu_s": 0.16 * 1.2}),
        ({"friction_drift.drift": 0.2, "friction_drift.place": 0.5}, {"mu_s": 0.16 * 1.1}),
        ({"pusher_speed.factor": 1.1}, {"v": 0.033}),
        ({"initial_gap.gap_m": 2e-4}, {"stroke": 1e-3}),
        ({"pusher_duration.duration_s": 0.03}, {"stroke": 0.9e-3}),
        (
            {"pusher_duration.duration_s": 0.03, "pusher_speed.factor": 1.1},
            {"v": 0.033, "stroke": 0.99e-3},
        ),
        ({"pusher_duration.duration_s": 0.05}, {}),  # the stroke is over before
        (
            {"static_dwell.amplitude": 0.03, "static_dwell.rest_s": 100.0},
            {"mu_s": 0.16 * dwell, "ratio": 0.75 / dwell},
        ),
    ):
        same(push(effect, **RIG), exact.push(**(RIG | changed), arithmetic=exact.FLOAT))


@pytest.mark.parametrize("alpha", [0.0, 0.01])
def test_a_gap_only_delays_a_part_on_bristles(alpha):
    bristles = {"presliding.sigma_0_N_per_m": 1e7, "presliding.sigma_1_N_s_per_m": 3e3}
    bristles |= {"tilt.alpha_rad": alpha}
    away = push(bristles | {"initial_gap.gap_m": 2e-4}, **RIG)
    same(away, push(bristles, **(RIG | {"stroke": 1e-3})))
    assert away.sliding_distance is not None


def test_with_an_infinite_stroke_the_duration_alone_stops_the_tip():
    slow = RIG | {"v": 0.012, "b": 200.0}
    timed = push({"pusher_duration.duration_s": 0.2}, **(slow | {"stroke": None}))
    same(timed, exact.push(**(slow | {"stroke": 2.4e-3}), arithmetic=exact.FLOAT))
    assert timed.contacts > 1
    short = push({"pusher_duration.duration_s": 1e-3}, **(RIG | {"v": 0.01, "stroke": None}))
    assert (short.regime, short.reason) == ("no_motion", "rests in contact")
    assert short.peak_force == pytest.approx(6e5 * 1e-5 + 900 * 0.01, rel=1e-13)


def test_a_latch_takes_the_first_fall_of_the_force():
    rig = {ARGUMENTS[name]: x for name, x in (RIG | {"v": 0.012, "b": 200.0}).items()}
    plain, times = effects.push(rig), np.linspace(0, 0.3, 30001)
    force, x = effects.traces(rig, times)
    assert plain.contacts > 2
    distances = []
    for level in (1.0, 5.0, 15.0, 1e6):
        latched = effects.push(rig | {"release_latch.threshold_N": level})
        assert (latched.peak_force, latched.contacts) == (plain.peak_force, plain.contacts)
        distances.append(latched.sliding_distance)
        falls = np.flatnonzero((force[:-1] >= level) & (force[1:] < level))
        if len(falls):
            i = falls[0]
            share = (force[i] - level) / (force[i] - force[i + 1])
            left = x[i] + share * (x[i + 1] - x[i])
            assert latched.sliding_distance == pytest.approx(x[-1] - left, abs=1e-8)
    assert 2 * plain.sliding_distance < distances[0] < distances[1] < distances[2]
    assert distances[3] == plain.sliding_distance


def test_sensors_only_change_the_readings():
    plain = ode.push(**RIG)
    read = push({"force_gain.factor": 1.1, "force_offset.offset_N": -2.0}, **RIG)
    assert read.peak_force == pytest.approx(1.1 * plain.peak_force - 2, rel=1e-11)
    assert push({"force_saturation.level_N": 20.0}, **RIG).peak_force == 20
    scaled = push({"probe_scale.factor": 1.03}, **RIG)
    assert scaled.sliding_distance == pytest.approx(1.03 * plain.sliding_distance, rel=1e-10)


@pytest.mark.parametrize("n", [1.05, 1.5])
def test_hardening_keeps_energy(n):
    """Without damping, w^2 / 2 m and the potential of spring and friction together stay the same
    in the tip's frame: that gives the deepest compression and the speed of release."""
    m, k, v, z_r = 14.0, 6e5, 0.03, 1e-4
    static = 0.16 * m * GRAVITY
    kinetic = 0.75 * static

    def potential(z):
        return k * z_r**2 / (n + 1) * (z / z_r) ** (n + 1) - kinetic * z

    slip = z_r * (static / (k * z_r)) ** (1 / n)
    energy = m * v**2 / 2 + potential(slip)
    deepest = brentq(lambda z: potential(z) - energy, slip, 1e-2, xtol=1e-18, rtol=1e-15)
    released = v + math.sqrt(2 * energy / m)
    answer = push(
        {"contact_hardening.exponent": n}, m=m, mu_s=0.16, ratio=0.75, k_v=0.0, k=k, b=0.0, v=v
    )
    assert answer.peak_force == pytest.approx(k * z_r * (deepest / z_r) ** n, rel=1e-12)
    assert answer.sliding_distance == pytest.approx(m * released**2 / 2 / kinetic, rel=1e-11)


@pytest.mark.parametrize("b_r", [60.0, 3000.0])
def test_a_damper_on_rebound_alone_lets_go_where_the_contact_would_pull(b_r):
    """Without any other damping: a free oscillation to the deepest compression, then a damped one
    about the same point, in closed form."""
    m, k, v, g = 14.0, 6e5, 0.03, GRAVITY
    rest, omega, c = 0.12 * m * g / k, math.sqrt(k / m), b_r / 2 / m
    deep = math.hypot(0.04 * m * g / k, v / omega)
    turn = math.sqrt(omega**2 - c**2)

    def z(t):
        return rest + deep * math.exp(-c * t) * (math.cos(turn * t) + c / turn * math.sin(turn * t))

    def w(t):
        return -deep * math.exp(-c * t) * omega**2 / turn * math.sin(turn * t)

    t = brentq(lambda t: k * z(t) + b_r * w(t), 0, math.pi / 2 / turn + 3e-3, xtol=1e-18)
    rig = {"m": m, "mu_s": 0.16, "ratio": 0.75, "k_v": 0.0, "k": k, "b": 0.0, "v": v}
    answer = push({"rebound_damping.b_N_s_per_m": b_r}, **rig)
    assert answer.peak_force == pytest.approx(k * (rest + deep), rel=1e-12)
    assert answer.sliding_distance == pytest.approx((v - w(t)) ** 2 / 2 / (0.12 * g), rel=1e-11)


def test_the_contact_works_as_much_as_friction_takes():
    """From rest to rest, with most laws at once: the integrals of both forces over x agree."""
    effect = {
        "stribeck.v_s_m_per_s": 0.02,
        "quadratic_drag.c_N_s2_per_m2": 300.0,
        "friction_waviness.amplitude": 0.2,
        "friction_waviness.wavelength_m": 1e-3,
        "friction_waviness.phase_rad": 1.0,
        "friction_patch.amplitude": 0.3,
        "friction_patch.start_m": 8e-4,
        "tilt.alpha_rad": 0.01,
        "normal_force.extra_N": 10.0,
        "contact_hardening.exponent": 1.3,
        "rebound_damping.b_N_s_per_m": 360.0,
        "pusher_lag.tau_s": 1e-3,
        "pusher_ripple.amplitude": 0.05,
        "pusher_ripple.period_m": 7e-4,
    }
    rig = {ARGUMENTS[name]: x for name, x in RIG.items()} | effect
    times = np.linspace(0, 0.12, 4001)
    force, x = effects.traces(rig, times)
    u = np.gradient(x, times)
    weight = 14.0 * GRAVITY
    load = (weight * math.cos(0.01) + 10) * (1 + 0.2 * np.sin(2 * np.pi * x / 1e-3 + 1))
    load *= np.where(x > 8e-4, 1.3, 1.0)
    mu = 0.12 + 0.04 * np.exp(-((u / 0.02) ** 2))
    resist = mu * load + 12 * u + 300 * u**2 + weight * math.sin(0.01)
    assert x[-1] == x[-2] > 1.2e-3
    taken = np.trapezoid(np.where(u > 0, resist, 0.0), x)
    assert np.trapezoid(force, x) == pytest.approx(taken, rel=1e-4)


def test_derivatives_are_those_of_the_exact_plain_model():
    clear = [c for c in PLAIN if (c["margin"] or 0) > 0.1 and c["b_N_s_per_m"] > 10]
    case = next(c for c in clear if c["regime"] == "released_by_rebound" and c["d_m"] > 1e-3)
    names = ["mu_s", "b_N_s_per_m"]
    slopes, errors = derivatives({name: case[name] for name in BASE}, names)
    for name in names:
        for i, key in enumerate(("peak_force_N", "sliding_distance_m")):
            exactly = case["derivatives"][key][name]
            assert slopes[name][i] == pytest.approx(exactly, rel=1e-8)
            assert errors[name][i] * case[name] <= 1e-9 * (case["F_p_N"], case["d_m"])[i]


def test_what_has_no_answer_says_why():
    stuck = push(**(RIG | {"b": 7000.0, "v": 0.01, "stroke": None}))
    assert (stuck.peak_force, stuck.reason) == (None, "never released")
    with pytest.raises(KeyError, match="mu_x"):
        vector({"mu_x": 1.0})
    assert set(TABLE) >= set(BASE)
