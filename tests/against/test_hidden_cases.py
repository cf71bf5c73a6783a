"""The generator of hidden effects: its pushes, files, noise and strengths, against other ways."""

from __future__ import annotations

import csv
import json
import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from nptdms import TdmsFile

from tests.hidden import (
    Case,
    draw,
    heldout,
    own_strength,
    random_case,
    record,
    scaling,
    signal,
    simulate,
    strength,
    table,
    write,
)
from tests.hidden.case import COMPONENTS, MM_MIN
from tests.hidden.noise import coloured, whitened
from tests.hidden.outsiders import TABLE as OUTSIDERS
from tests.reference import effects, traces
from tests.reference.effect_parameters import GRAVITY, NULLS

CLEAN = random_case(3)
SENSORS = ("force_sensor", "probe")
PLAIN = ("mass_kg", "mu_s", "mu_k_over_mu_s", "k_v_N_s_per_m", "k_N_per_m", "b_N_s_per_m")


def quick(case: Case, count: int = 1) -> Case:
    """Its fastest pushes alone: they are the shortest."""
    return replace(case, pushes=tuple(sorted(case.pushes, key=lambda p: -p.velocity)[:count]))


def test_the_same_seed_is_the_same_case():
    assert random_case(3) == CLEAN != random_case(4)
    assert random_case(5, "tilt") == random_case(5, "tilt")
    with pytest.raises(KeyError, match="no_such"):
        random_case(1, "no_such")


def test_without_noise_a_clean_case_is_the_exact_plain_model():
    for one in record(CLEAN, noisy=False):
        rig = {**CLEAN.rig, "mu_s": one.push.mu_s}
        m, mu_s, ratio, k_v, k, b = (rig[name] for name in PLAIN)
        course = traces.follow(m, mu_s, ratio, k_v, k, b, one.push.velocity, 2e-3)
        force, position, _ = course(one.times)
        np.testing.assert_allclose(one.force, force, atol=1e-7 * force.max())
        np.testing.assert_allclose(one.position, position, atol=1e-12)
        assert one.run.peak_force == pytest.approx(course.peak_force, rel=1e-9)
        assert set(np.round(one.run.jumps, 12)) == set(np.round(course.jumps, 12)) | {
            round(2e-3 / one.push.velocity, 12)
        }
        assert one.times[0] == pytest.approx(-0.01995)
        assert one.times[-1] > course.end + 0.029


def test_with_effects_it_is_the_reference():
    case = quick(random_case(6, ("pusher_lag", "static_dwell", "channel_skew", "force_gain")))
    (one,), (push,) = record(case, noisy=False), case.pushes
    rig = {**case.rig, "mu_s": push.mu_s, "velocity_m_per_s": push.velocity, "stroke_m": 2e-3}
    rig |= {f"{id}.{key}": x for id, keys in case.effects.items() for key, x in keys.items()}
    rig["static_dwell.rest_s"] = push.rest_before
    some = slice(0, None, 60)
    force, position = effects.traces(rig, one.times[some])
    np.testing.assert_allclose(one.force[some], force, atol=1e-7 * force.max())
    np.testing.assert_allclose(one.position[some], position, atol=1e-11)
    answer = effects.push(rig)
    assert one.run.peak_force == pytest.approx(answer.peak_force, rel=1e-8)
    assert one.run.sliding_distance == pytest.approx(answer.sliding_distance, rel=1e-8)


def fine(name: str, **values):
    """A push with one outsider, finely sampled: case, t, F, x, u."""
    case = quick(random_case(8, name, scatter=0.0))
    if values:
        case = case.with_effect(name, {**case.outsider[name], **values})
    rows, others = simulate.numbers(case)
    t = np.arange(0, 0.25, 2e-5)
    run = simulate.sensed(case, rows[0], others, t)
    return case, case.outsider[name], t, run.force, run.position, np.gradient(run.position, t)


def friction(name, at, u, x):
    """mu over mu_k of an outsider."""
    if name == "friction_rise":
        return 1 + at["share"] * np.tanh(u / at["speed"])
    if name == "friction_bump":
        return 1 + at["share"] * np.exp(-(((u - at["speed"]) / at["width"]) ** 2))
    if name == "friction_wave":
        return 1 + at["share"] * np.sin(2 * np.pi * u / at["speed"])
    return 1 + at["share"] * np.exp(-x / at["length"])


@pytest.mark.parametrize(
    "name", ["friction_rise", "friction_bump", "friction_wave", "friction_decay"]
)
def test_friction_outside_the_catalogue_takes_the_work_of_the_contact(name):
    case, at, _, force, x, u = fine(name)
    weight = 0.75 * case.pushes[0].mu_s * case.rig["mass_kg"] * GRAVITY
    resist = friction(name, at, u, x) * weight + case.rig["k_v_N_s_per_m"] * u
    taken = np.trapezoid(np.where(u > 0, resist, 0.0), x)
    assert np.trapezoid(force, x) == pytest.approx(taken, rel=2e-4)
    assert abs(np.trapezoid(np.where(u > 0, weight, 0.0), x) / taken - 1) > 2e-3


def unevenness(name, at, now, y):
    """What the tip's speed is multiplied with."""
    if name == "speed_sag":
        return 1 - at["share"] * y / at["length"]
    if name == "speed_dip":
        return 1 - at["share"] * math.exp(-(((y - at["at"]) / at["width"]) ** 2))
    if name == "speed_ring":
        fading = at["share"] * math.exp(-now / at["tau"])
        return 1 + fading * math.sin(2 * math.pi * at["frequency"] * now)
    return 1.0


def tip(name, at, t, v):
    """The tip's travel and speed up to the stop, in steps of t."""
    y, speed = 0.0, []
    for now in t:
        speed.append(v * unevenness(name, at, now, y))
        y += speed[-1] * (t[1] - t[0])
    speed = np.array(speed)
    return np.concatenate([[0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(t))]), speed


@pytest.mark.parametrize(
    "name", ["soft_layer", "softening", "hysteresis", "speed_sag", "speed_dip", "speed_ring"]
)
def test_contact_and_pusher_outside_the_catalogue_obey_their_laws(name):
    case, at, t, force, x, u = fine(name)
    k, b, v = case.rig["k_N_per_m"], case.rig["b_N_s_per_m"], case.pushes[0].velocity
    t, force, x, u = (a[: np.argmax(force[1:] <= 0)] for a in (t, force, x, u))
    y, speed = tip(name, at, t, v)
    z, w = y - x, speed - u
    spring = k * z
    if name == "soft_layer":
        slope = 1 - at["share"] / (1 + np.exp((z - at["depth"]) / (0.1 * at["depth"])))
        spring = k * np.concatenate([[0], np.cumsum((slope[1:] + slope[:-1]) / 2 * np.diff(z))])
    if name == "softening":
        spring *= ((1 + z / 1e-5) / (1 + 1e-4 / 1e-5)) ** -at["share"]
    if name == "hysteresis":
        spring *= 1 + at["per_speed"] * w
    expected = spring + b * np.maximum(w, 0)
    middle = slice(5, -5)
    assert np.abs(force - expected)[middle].max() < 5e-3 * force.max()
    assert (
        np.abs(force - k * (v * t - x) - b * np.maximum(v - u, 0))[middle].max()
        > 0.01 * force.max()
    )


def test_outsiders_have_components_and_vanish_with_their_size():
    assert {one.component for one in OUTSIDERS.values()} == set(COMPONENTS.values())
    plain = record(quick(CLEAN), noisy=False)[0]
    for name in OUTSIDERS:
        drawn = draw.values(CLEAN, name, np.random.default_rng(1))
        case = quick(CLEAN.with_effect(name, drawn))
        assert case.components == (OUTSIDERS[name].component,)
        assert np.abs(simulate.numbers(case)[1]).max() > 0 or case.components[0] in SENSORS
        one = record(case.scaled(name, 1e-8), noisy=False)[0]
        n = min(len(one.times), len(plain.times))
        np.testing.assert_allclose(one.position[:n], plain.position[:n], atol=1e-10)
        smooth = signal._kept(one.times, case.rate, one.run)
        np.testing.assert_allclose(one.force[smooth], plain.force[smooth], atol=1e-3)


def test_an_s_curve_takes_as_long_as_a_ramp():
    ramp = quick(random_case(9, "pusher_ramp"))
    ramp = ramp.with_effect("pusher_ramp", {"acceleration_m_per_s2": 5.0})
    straight, curved = (record(replace(ramp, s_curve=s), noisy=False)[0] for s in (False, True))
    assert straight.run.jumps[1] == pytest.approx(curved.run.jumps[1], rel=1e-12)  # the stop
    assert np.abs(straight.force - curved.force[: len(straight.force)]).max() > 1


def test_recordings_are_what_the_contract_says(tmp_path):
    case = replace(random_case(7, "stribeck", conditions=("DRY", "OILY")), jitter=3e-6)
    path = write(case, tmp_path)
    written = record(case)
    with TdmsFile.open(path) as file:
        assert len(file.groups()) == 14
        for group, push, one in zip(file.groups(), case.pushes, written, strict=True):
            said = group.properties
            assert said["velocity_mm_min"] == pytest.approx(push.velocity / MM_MIN)
            assert said["order"] == push.order
            assert said["condition"] == push.condition
            assert (said["mass_kg"], said["stroke_mm"]) == (case.rig["mass_kg"], 2.0)
            assert 1 <= said["rest_before_s"] <= 1000
            force, position = group["force"], group["position"]
            assert force.properties["unit_string"] == "N"
            assert position.properties["unit_string"] == "um"
            for channel in (force, position):
                assert channel.properties["wf_increment"] == 1e-4
                assert channel.properties["wf_start_offset"] == pytest.approx(-0.01995)
                assert channel.properties["wf_samples"] == len(channel)
            np.testing.assert_array_equal(force[:], one.force)
            np.testing.assert_allclose(position[:] * 1e-6, one.position, atol=1e-12)
    setup = tomllib.loads((tmp_path / "setup.toml").read_text())
    assert "effects" not in setup and setup["friction"]["mu_k_over_mu_s"] == 0.75
    contact, friction = setup["contact"], setup["friction"]
    assert 0.7 <= contact["k_N_per_m"] / case.rig["k_N_per_m"] <= 1.3
    assert 0.7 <= contact["b_N_s_per_m"] / case.rig["b_N_s_per_m"] <= 1.3
    assert 0.5 <= friction["k_v_N_s_per_m"] / case.rig["k_v_N_s_per_m"] <= 1.5
    assert setup["force_sensor"]["noise_N"] == case.noise.force
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["effects"] == case.effects


def test_tables_are_what_the_contract_says(tmp_path):
    case = random_case(7, "friction_drift", kind="table", stroke=None)
    with write(case, tmp_path).open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 14 and "stroke_mm" not in rows[0]
    read = simulate.readings(case)
    for row, (F_p, d) in zip(rows, read, strict=True):
        assert abs(float(row["peak_force_N"]) - F_p) < 5 * float(row["peak_force_se_N"])
        se = float(row["sliding_distance_se_um"])
        assert abs(float(row["sliding_distance_um"]) - d * 1e6) < 5 * se
    contact = [{**row, "d": row["sliding_distance_um"]} for row in table(case)]
    assert all(row["d"] is None or row["d"] > 0 for row in contact)


def test_held_out_pushes_are_of_the_same_rig():
    case = random_case(7, "stribeck")
    other = heldout(case, 5)
    assert (other.rig, other.effects, other.noise) == (case.rig, case.effects, case.noise)
    assert len(other.pushes) == 5 and other.seed != case.seed
    assert not {p.mu_s for p in other.pushes} & {p.mu_s for p in case.pushes}
    assert [p.order for p in other.pushes] == list(range(5))


@pytest.mark.parametrize("phi", [0.0, 0.8])
def test_whitened_noise_is_white_and_of_the_right_level(phi):
    n = 40_000
    rng = np.random.default_rng(1)
    noise = coloured(n, 0.4, phi, rng)
    assert noise.std() == pytest.approx(0.4, rel=0.03)
    kept = rng.random(n) < 0.8
    white = whitened(noise, 0.4, phi, kept)
    assert len(white) == kept.sum()
    assert np.mean(white**2) == pytest.approx(1, abs=4 * math.sqrt(2 / len(white)))
    for lag in (1, 2, 5):
        assert abs(np.mean(white[lag:] * white[:-lag])) < 4 / math.sqrt(len(white))


def test_a_recording_has_the_noise_that_it_says():
    case = random_case(11, phi=0.6)
    left = []
    for noisy, clean in zip(record(case), record(case, noisy=False), strict=True):
        every = np.ones(len(noisy.times), bool)
        force = whitened(noisy.force - clean.force, case.noise.force, 0.6, every)
        position = noisy.position - clean.position
        quiet = position - np.mean(position)
        left += [np.mean(force**2), np.mean(quiet**2) / case.noise.position**2]
    assert np.mean(left[::2]) == pytest.approx(1, abs=0.03)
    assert np.mean(left[1::2]) == pytest.approx(1, abs=0.05)


def test_strength_is_zero_without_and_grows_with_the_size():
    assert strength(CLEAN) < 1e-6
    case = random_case(12, "friction_waviness", phi=0.5, n=6)
    at = signal.base(case)
    small = case.scaled("friction_waviness", 1e-3)
    one, two = (strength(small.scaled("friction_waviness", f), at) for f in (1, 2))
    assert two == pytest.approx(2 * one, rel=0.01)
    louder = scaling.with_noise(small, 2)
    assert strength(louder) == pytest.approx(one / 2, rel=0.02)


def test_what_another_plain_rig_does_as_well_has_no_strength():
    load = random_case(13, "normal_force", scatter=0.0, n=4)
    assert strength(load) < 0.05  # at one mass it is another mu_s
    assert strength(random_case(13, "normal_force", scatter=0.0, n=4, masses=(1.0, 1.5))) > 5


def test_strength_is_what_chi_square_drops_by():
    """From 400 noisy tables: -2 log likelihood of the best plain rig, less that of the best of the
    true kind, each with the scatter that suits it best, with all matrices written out."""
    case = random_case(14, "friction_drift", 5.0, kind="table", scatter=0.002, n=40)
    read, at = simulate.readings(case), signal.base(case)
    scale = np.array([case.noise.force, case.noise.position])
    shift = ((read - simulate.readings(case.plain())) / scale).ravel()
    slopes = np.concatenate([push / scale[:, None] for push in at.slopes])
    there = np.isfinite(shift) & np.isfinite(slopes).all(axis=1)
    own = np.zeros((80, 40))
    own[np.arange(80), np.arange(80) // 2] = slopes[:, -1]
    shift, slopes, own, n = shift[there], slopes[there], own[there], there.sum()
    rng = np.random.default_rng(2)
    noise = rng.standard_normal((n, 400)) + own @ (0.002 * rng.standard_normal((40, 400)))

    def least(y):
        found = []
        for scatter in np.geomspace(0.0005, 0.05, 60):
            root = np.linalg.cholesky(np.eye(n) + scatter**2 * own @ own.T)
            white, columns = np.linalg.solve(root, y), np.linalg.solve(root, slopes)
            left = white - columns @ np.linalg.lstsq(columns, white)[0]
            found.append(np.sum(left**2, axis=0) + 2 * np.log(np.diag(root)).sum())
        return np.min(found, axis=0)

    drop = np.mean(least(shift[:, None] + noise) - least(noise))
    assert math.sqrt(drop) == pytest.approx(strength(case), rel=0.1)


def test_a_wanted_strength_is_found():
    case = random_case(15, "initial_gap", 10.0, n=6)
    assert strength(case) == pytest.approx(10, rel=0.02)


def test_of_a_pair_each_is_as_visible_as_wanted_beside_the_other():
    case = random_case(16, ("pusher_ramp", "probe_scale"), 10.0, n=4)
    for name in case.hidden:
        assert own_strength(case, name)[1] == pytest.approx(10, rel=0.05)


def test_nuisances_change_next_to_nothing():
    case = random_case(17, "stribeck", change=0.03, nuisances=True, n=6)
    assert len(case.nuisances) > 18 and "stribeck" not in case.nuisances
    assert scaling.typical_change(replace(case, nuisances={})) == pytest.approx(0.03, rel=0.01)
    for name, values in case.nuisances.items():
        alone = case.plain().with_effect(name, values)
        assert scaling.largest_change(alone) <= 0.00202
    assert set(case.nuisances) <= set(NULLS)
