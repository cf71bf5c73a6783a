"""What samples lose of a push: bounds, limits and rates of convergence."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

import difffric as df
from difffric.studies.sampling import (
    DSP,
    FPGA,
    SampledPush,
    Sampler,
    estimate_friction,
    mean_loss,
    sample_push,
)
from difffric.units import from_mm_min
from studies import sampling as study

SPEED = from_mm_min(3000.0)
SMOOTH = {"mass": 18.9, "mu_s": 0.141, "k": 8.0e5, "b": 1500.0}
JUMP = {**SMOOTH, "b": 6000.0}
PHASE = (np.arange(200) + 0.5) / 200
unit = st.floats(0.0, 1.0, exclude_max=True)


def rig_of(k_v=0.0, stroke=None, **numbers):
    return df.spring_damper_rig(**numbers, k_v=k_v, stroke=stroke)


@cache
def push_of(velocity=SPEED, b=1500.0, stroke=None, k_v=0.0):
    return df.simulate(rig_of(k_v, stroke, **{**SMOOTH, "b": b}), velocity)


def lost(push, rate, phase=PHASE):
    return float(push.peak_force) - sample_push(push, Sampler(rate), phase).peak_force


def short(push, rate):
    return float(push.sliding_distance) - sample_push(push, Sampler(rate), PHASE).sliding_distance


@settings(deadline=None, max_examples=60)
@given(
    speed=st.sampled_from([500.0, 1000.0, 3000.0, 5000.0]),
    b=st.sampled_from([1500.0, 6000.0]),
    rate=st.floats(300.0, 5e4),
    jitter=st.floats(0.0, 1e-3),
    held=st.floats(0.0, 0.5),
    phase=unit,
    seed=st.integers(0, 2**32 - 1),
)
def test_without_noise_no_sample_is_above_the_peak_and_no_release_is_early(
    speed, b, rate, jitter, held, phase, seed
):
    push = push_of(from_mm_min(speed), b)
    sampler = Sampler(rate, jitter, held, longest=2e-3)
    seen = sample_push(push, sampler, [phase], seed=seed)
    assert 0 <= seen.peak_force[0] <= float(push.peak_force) * (1 + 1e-12)
    if push.reason is None and seen.peak_force[0] > 0:
        assert -1e-12 <= seen.sliding_distance[0] <= float(push.sliding_distance) + 1e-12
    else:
        assert np.isnan(seen.sliding_distance[0])


@pytest.mark.parametrize("b", [1500.0, 6000.0], ids=["smooth", "jump"])
def test_errors_vanish_as_the_rate_grows(b):
    push = push_of(b=b)
    worst = [(lost(push, rate).max(), short(push, rate).max()) for rate in (1e3, 1e4, 1e5, 1e6)]
    assert (np.diff(worst, axis=0) < 0).all()
    assert worst[-1][0] < (1e-6 if b == 1500.0 else 0.06)
    assert worst[-1][1] < 2 * SPEED / 1e6


@pytest.mark.parametrize("speed", [500.0, 3000.0, 5000.0])
def test_a_smooth_peak_loses_its_curvature_over_24_rate_squared(speed):
    """Without viscosity f'' = -k u' at the peak, and u' = (F_p - mu_k F_N) / m."""
    push = push_of(from_mm_min(speed))
    rig = push.push.rig
    load = 0.75 * SMOOTH["mu_s"] * float(rig.F_N)
    curvature = SMOOTH["k"] * (float(push.peak_force) - load) / SMOOTH["mass"]
    for rate in (5e3, 1e4, 4e4):
        formula = curvature / (24 * rate**2)
        assert mean_loss(push, rate) == pytest.approx(formula, rel=1e-6)
        assert lost(push, rate).mean() == pytest.approx(formula, rel=2e-3)
        assert lost(push, rate).max() == pytest.approx(3 * formula, rel=2e-2)


def test_viscosity_bends_the_peak_as_well():
    push = push_of(k_v=200.0)
    assert lost(push, 2e4).mean() == pytest.approx(mean_loss(push, 2e4), rel=2e-3)


def test_a_peak_at_the_jump_loses_its_slope_over_2_rate():
    """f' = k v - b (b v - mu_k F_N) / m at t = 0+, where the force is b v."""
    push = push_of(b=JUMP["b"])
    b, load = JUMP["b"], 0.75 * JUMP["mu_s"] * float(push.push.rig.F_N)
    assert float(push.peak_force) == pytest.approx(b * SPEED, rel=1e-12)
    slope = JUMP["k"] * SPEED - b * (b * SPEED - load) / JUMP["mass"]
    assert slope < 0
    for rate in (2e4, 2e5):
        assert mean_loss(push, rate) == pytest.approx(-slope / (2 * rate), rel=1e-6)
        assert lost(push, rate).mean() == pytest.approx(-slope / (2 * rate), rel=5e-3)


def test_a_peak_that_ends_in_a_jump_loses_its_slope_over_2_rate():
    push = push_of(stroke=2e-4)  # the pusher stops while the force still grows
    assert push.regime == "released_at_stop"
    for rate in (2e4, 2e5):
        assert lost(push, rate).mean() == pytest.approx(mean_loss(push, rate), rel=2e-2)


@pytest.mark.parametrize(("b", "order"), [(1500.0, 2), (6000.0, 1)], ids=["smooth", "jump"])
def test_order_of_convergence(b, order):
    loss = [lost(push_of(b=b), rate).mean() for rate in (1e4, 2e4, 4e4)]
    np.testing.assert_allclose(np.log2(np.divide(loss[:-1], loss[1:])), order, atol=0.02)


@pytest.mark.parametrize("speed", [1000.0, 5000.0])
def test_the_release_is_seen_half_an_interval_late(speed):
    push = push_of(from_mm_min(speed))
    release = float(push.segments.t[-2])
    assert float(push.force(release - 1e-9)) > 0 == float(push.force(release + 1e-9))
    for rate in (1e4, 1e5):
        mean = float(push.speed(release)) / (2 * rate)
        assert short(push, rate).mean() == pytest.approx(mean, rel=1e-2)


def test_a_threshold_is_where_the_force_falls_through_it():
    push, level = push_of(), 20.0
    release = float(push.segments.t[-2])
    crossed = brentq(lambda t: float(push.force(t)) - level, 0.5 * release, release - 1e-9)
    d = float(push.position(push.stop_time)) - float(push.position(crossed))
    seen = sample_push(push, Sampler(1e6), PHASE, threshold=level).sliding_distance
    assert (seen <= d + 1e-12).all()
    assert seen.min() > d - 2 * SPEED / 1e6


@settings(deadline=None, max_examples=30)
@given(rate=st.floats(300.0, 2e5), phase=unit, seed=st.integers(0, 99), longest=unit)
def test_without_jitter_and_hold_ups_samples_are_regular(rate, phase, seed, longest):
    times = Sampler(rate, longest=longest).times([phase], 0.01, np.random.default_rng(seed))
    np.testing.assert_array_equal(times[0], (np.arange(times.shape[1]) + phase) / rate)
    assert times[0, -1] > 0.01


def test_a_regular_sampler_reads_the_force_at_its_instants():
    push = push_of()
    for phase in (0.0, 0.3, 0.99):
        seen = sample_push(push, Sampler(2e3, longest=1e-3), [phase], seed=3)
        t = (np.arange(40) + phase) / 2e3
        force = np.asarray(push.force(t))
        assert seen.peak_force[0] == pytest.approx(force.max(), rel=1e-14)
        first = t[np.flatnonzero(force > 0)[-1] + 1]
        d = float(push.position(push.stop_time)) - float(push.position(first))
        assert seen.sliding_distance[0] == pytest.approx(d, rel=1e-12)


@settings(deadline=None, max_examples=40)
@given(
    rate=st.floats(300.0, 5e4),
    jitter=st.floats(0.0, 1e-3),
    held=st.floats(0.0, 0.8),
    longest=st.floats(1e-5, 5e-3),
    seed=st.integers(0, 2**32 - 1),
)
def test_every_run_has_a_sample_beyond_the_end(rate, jitter, held, longest, seed):
    sampler = Sampler(rate, jitter, held, longest)
    times = sampler.times(PHASE[::20], 0.01, np.random.default_rng(seed))
    there = np.where(np.isfinite(times), times, -np.inf)
    assert (there.max(axis=1) > 0.01).all()
    for run in times:
        assert (np.diff(run[np.isfinite(run)]) >= 0).all()


def test_hold_ups_delay_the_share_of_samples_that_they_should():
    rate, held, longest = 1e4, 0.2, 3e-3
    random = np.random.default_rng(0)
    times = Sampler(rate, held=held, longest=longest).times(PHASE, 2.0, random)
    due = Sampler(rate).times(PHASE, 2.0, random)
    due = due[:, int(0.1 * rate) :]
    times = times[:, -due.shape[1] :]
    assert (times >= due - 1e-15).all()
    late = times > due + 1e-12
    assert late.mean() == pytest.approx(held, abs=0.003)
    missing = ~np.isfinite(times)
    # Each hold-up leaves one sample late, and those that come too late for it are missing.
    assert 0 < (late & ~missing).mean() < missing.mean() < held


def test_noise_makes_the_largest_sample_too_high_and_the_more_the_faster():
    push = push_of()
    excess = []
    for rate in (2e3, 2e4, 2e5):
        seen = sample_push(push, Sampler(rate), PHASE, noise=0.5, threshold=2.5)
        excess.append(float(seen.peak_force.mean() - push.peak_force))
    assert excess == sorted(excess)
    assert excess[-1] > 2 * 0.5


def test_mu_s_comes_back_from_exact_readings_and_from_none():
    push = push_of(k_v=5.0)
    rig = push.push.rig
    F_p, d = float(push.peak_force), float(push.sliding_distance)
    found = estimate_friction(rig, SPEED, SampledPush(np.array([F_p, 1.0]), np.array([d, np.nan])))
    for mu_s in found:
        assert mu_s[0] == pytest.approx(SMOOTH["mu_s"], rel=1e-9)
        assert np.isnan(mu_s[1])
    by_force, by_distance = estimate_friction(rig, SPEED, sample_push(push, FPGA, PHASE))
    assert np.abs(by_force / SMOOTH["mu_s"] - 1).max() < 1e-5
    assert np.abs(by_distance / SMOOTH["mu_s"] - 1).max() < 3e-4


def test_a_part_that_is_never_released_has_a_peak_and_no_distance():
    push = push_of(from_mm_min(500.0), b=6000.0)
    assert push.reason and push.reason.startswith("never released")
    seen = sample_push(push, DSP, PHASE)
    assert np.isnan(seen.sliding_distance).all()
    assert (seen.peak_force > 0).all()


def test_what_cannot_be_sampled_is_refused():
    with pytest.raises(df.InputError, match=r"rate: .*jitter: .*held: .*longest: "):
        Sampler(0.0, -1.0, 1.0, 0.0)


def test_the_study_writes_its_page_and_figure(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(study, "RATES", (2e3, 1e4))
    monkeypatch.setattr(study, "SPEEDS", (500, 3000, 5000))
    monkeypatch.setattr(study, "RUNS", 8)
    monkeypatch.setattr(study, "REDUCED", 2)
    monkeypatch.setattr(study, "calibrated_rig", study.rig_of_the_examples)
    page, image = tmp_path / "page.md", tmp_path / "image.png"
    page.write_text("before\n<!-- sampling:start -->\nold\n<!-- sampling:end -->\nafter\n")
    assert study.main(["--page", str(page), "--image", str(image)]) == 0
    text = page.read_text(encoding="utf-8")
    assert text.startswith("before") and text.endswith("after\n") and "old" not in text
    assert study.COMMAND in text
    assert capsys.readouterr().out.strip() in text
    assert image.stat().st_size > 10_000
