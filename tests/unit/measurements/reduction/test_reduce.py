"""F_p and d from noisy recordings: unbiased, with errors that hold, and reasons for what is not."""

from __future__ import annotations

import functools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter
from statsmodels.stats.diagnostic import acorr_ljungbox
from statsmodels.tsa.stattools import acf

from difffric.errors import InputError
from difffric.measurements.noise import (
    Noise,
    count_still,
    estimate_noise,
    estimate_quiet_noise,
    make_whitening,
    pool_noise,
)
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.measurements.reduction.local_polynomials import (
    Stretch,
    best_window,
    fit_window,
    powers,
)
from difffric.measurements.reduction.reduce import (
    NEVER_RESTS,
    RESTS_IN_CONTACT,
    WITHOUT_CONTACT,
    reduce_push,
    reduce_recordings,
)
from studies.reduction import summary, survey
from tests.reference import ode

PRACTICE = Path(__file__).parents[5] / "shared" / "data" / "practice"
RIG = {"m": 18.9, "mu_s": 0.138, "ratio": 0.75, "k_v": 8.9, "k": 8.48e5, "b": 1672.0}
LEVEL_N, LEVEL_M = 0.5, 3e-7
phis = st.floats(-0.8, 0.95)


@functools.cache
def trace(v_mm_min, rate=1e4, stroke_s=0.0352, **changes):
    """(noiseless force, position, first time, F_p, d): 20 ms of quiet, 30 ms of rest."""
    v, quiet = v_mm_min / 6e4, int(0.02 * rate)
    t = (np.arange(int((stroke_s + 0.25) * rate)) + 0.5) / rate
    push = ode.push(**(RIG | changes), v=v, stroke=stroke_s * v, times=t)
    moving = np.flatnonzero(np.abs(push.position - push.position[-1]) > 1e-12)[-1]
    n = moving + int(0.03 * rate)
    force, position = (np.r_[np.zeros(quiet), y[:n]] for y in (push.force, push.position))
    return force, position, (0.5 - quiet) / rate, push.peak_force, push.sliding_distance


def ar1(rng, n, phi):
    """Stationary AR(1) noise of unit variance."""
    steps = rng.standard_normal(n) * np.sqrt(1 - phi**2)
    return lfilter([1], [1, -phi], steps, zi=[phi * rng.standard_normal()])[0]


def record(v_mm_min, seed=0, phi=0.0, scale=1.0, rate=1e4, **changes) -> Recording:
    force, position, start, *_ = trace(v_mm_min, rate, **changes)
    rng = np.random.default_rng(seed)
    noisy = [
        y + scale * level * ar1(rng, len(y), phi)
        for y, level in ((force, LEVEL_N), (position, LEVEL_M))
    ]
    channels = [Channel.of(y, 1 / rate, start, unit) for y, unit in zip(noisy, "Nm", strict=True)]
    return Recording(v_mm_min / 6e4, *channels, name=f"push {seed}")


def cut(channel: Channel, t_0=-np.inf, t_1=np.inf) -> Channel:
    """The channel from t_0 to t_1 alone."""
    t, y = channel.between(t_0, t_1)
    return Channel.of(y, channel.dt, t[0], channel.unit)


# ---- noise


def correlations(index, phi):
    lag = np.abs(np.subtract.outer(index, index))
    return np.sign(phi) ** lag * abs(phi) ** lag


@given(phis, st.sets(st.integers(0, 40), min_size=2))
def test_whitening_is_exact_across_gaps(phi, kept):
    """W R W' = I for the covariance R of any choice of samples."""
    index = np.array(sorted(kept))
    w = make_whitening(index, Noise(2.0, phi))(np.eye(len(index)))
    covariance = w @ (4.0 * correlations(index, phi)) @ w.T
    np.testing.assert_allclose(covariance, np.eye(len(index)), atol=1e-9)


def test_whitening_takes_each_series_for_itself():
    noise, r = Noise(0.3, 0.7), np.arange(6.0) + 1
    both = make_whitening([4, 5, 7, 0, 1, 2], noise)(r)
    parts = ([4, 5, 7], r[:3]), ([0, 1, 2], r[3:])
    alone = np.concatenate([make_whitening(index, noise)(part) for index, part in parts])
    np.testing.assert_allclose(both, alone)


@given(phis, st.integers(1, 12))
def test_noise_of_means_and_of_decimated_samples(phi, n):
    noise, ones = Noise(1.5, phi), np.ones(n) / n
    full = 1.5**2 * correlations(np.arange(2 * n), phi)
    variance, neighbours = ones @ full[:n, :n] @ ones, ones @ full[:n, n:] @ ones
    assert noise.effective(n) == pytest.approx(1.5**2 / variance)
    assert noise.average(n).level == pytest.approx(np.sqrt(variance))
    assert noise.average(n).correlation == pytest.approx(neighbours / variance, abs=1e-12)
    if phi >= 0:
        assert noise.at(n).correlation == pytest.approx(phi**n)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9])
def test_level_and_correlation_are_unbiased_in_short_stretches(phi):
    rng = np.random.default_rng(3)
    found = [estimate_noise(3.0 + 0.5 * ar1(rng, 200, phi) for _ in range(14)) for _ in range(100)]
    for values, truth in (
        (np.array([f.level**2 for f in found]), 0.25),
        (np.array([f.correlation for f in found]), phi),
    ):
        error = values.mean() - truth
        assert abs(error) < 4 * values.std() / np.sqrt(len(values)) + 0.005 * truth


def test_white_after_whitening_and_not_before():
    raw = ar1(np.random.default_rng(5), 3000, 0.6)
    white = make_whitening(np.arange(3000), Noise(1.0, 0.6))(raw)
    p_raw, p_white = (
        float(acorr_ljungbox(r, lags=[10])["lb_pvalue"].iloc[0]) for r in (raw, white)
    )
    z_raw, z_white = (float(acf(r, nlags=1)[1]) * np.sqrt(len(r)) for r in (raw, white))
    assert p_raw < 1e-9 and z_raw > 20
    assert p_white > 0.01 and abs(z_white) < 3


def test_no_noise_and_rounding():
    """A resting probe shows no noise; its resolution bounds it from below."""
    t = np.arange(400)
    position = np.round(np.where(t < 200, 0.0, 3.3e-8 * (t - 200)) / 2e-8) * 2e-8
    noise = estimate_quiet_noise(Channel.of(position, 1e-4, -0.02, "m"))
    assert noise.level == pytest.approx(2e-8 / np.sqrt(12), rel=1e-6)
    with pytest.raises(InputError, match="expected 16"):
        estimate_noise([np.zeros(4)])


def test_without_quiet_time_differences_say_the_level():
    moving = record(2500, seed=1)
    assert moving.force is not None
    noise = estimate_quiet_noise(cut(moving.force, 0.001))
    assert noise.n == 0 and noise.level == pytest.approx(LEVEL_N, rel=0.15)


def test_rest_is_found_to_the_sample_or_so():
    y = np.r_[-0.5 * np.linspace(10, 0, 100) ** 2, np.zeros(300)]
    y = y + 0.1 * np.random.default_rng(2).standard_normal(400)
    assert 290 <= count_still(y, Noise(0.1)) <= 330


# ---- F_p and d


@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_unbiased_with_errors_that_hold(phi):
    """Over speeds and noise: z is about standard normal, and 95 % intervals hold the truth."""
    force, distance, naive = [], [], []
    for v in (500, 800, 1500, 5000):
        _, _, _, F_p, d = trace(v)
        for seed in range(16):
            push = record(v, seed, phi)
            found = reduce_push(push, Noise(LEVEL_N, phi), Noise(LEVEL_M, phi))
            assert found.reason == "" and push.force is not None
            force.append((found.peak_force - F_p, found.peak_force_se))
            distance.append((found.sliding_distance - d, found.sliding_distance_se))
            naive.append(push.force.samples.max() - F_p)
    error, se = np.array(force).T
    if phi == 0.0:
        assert np.mean(naive) > 0.5  # what is corrected: the largest sample is too large
        assert abs(error.mean()) < 0.1
    for error, se in (np.array(force).T, np.array(distance).T):
        z = error / se
        assert abs(z.mean()) < 0.5
        assert 0.8 < np.sqrt(np.mean(z**2)) < 1.5
        assert 0.88 <= np.mean(np.abs(z) < 1.96) <= 0.99


@pytest.mark.parametrize(
    ("v", "rate", "changes"),
    [
        (2500, 2e5, {}),
        (500, 2e5, {}),  # d of 3.5 µm
        (2500, 1e4, {"b": 6000.0}),  # the damper's step at t = 0 is the peak
        (2500, 1e4, {"stroke_s": 0.004}),  # the pusher stops before the peak
        (2500, 1e4, {"stroke_s": 0.010}),  # and on the rebound
        (800, 1e4, {"b": 9000.0}),  # the force falls only after the pusher's stop
    ],
)
def test_every_kind_of_peak_and_release(v, rate, changes):
    _, _, _, F_p, d = trace(v, rate, **changes)
    found = [
        reduce_push(record(v, seed, rate=rate, **changes), Noise(LEVEL_N), Noise(LEVEL_M))
        for seed in range(6)
    ]
    force = np.array([(f.peak_force - F_p) / f.peak_force_se for f in found])
    distance = np.array([(f.sliding_distance - d) / f.sliding_distance_se for f in found])
    for z in (force, distance):
        assert abs(np.median(z)) < 1.2 and np.mean(np.abs(z) < 3) >= 0.75
    assert np.median([f.sliding_distance_se for f in found]) < 2e-6


@pytest.mark.parametrize("v", [500, 1000, 2500, 5000])
@pytest.mark.parametrize("rate", [1e4, 2e5])
def test_exact_without_noise(v, rate):
    _, _, _, F_p, d = trace(v, rate)
    found = reduce_push(record(v, scale=0.0, rate=rate))
    assert found.peak_force == pytest.approx(F_p, abs=2e-3)
    assert found.sliding_distance == pytest.approx(d, abs=2e-8)


def test_what_a_fit_starts_from():
    """Release speed and deceleration agree with d = u^2 / (2 a); contacts and stops are seen."""
    fast, slow = reduce_push(record(2500, 1)), reduce_push(record(500, 1))
    braking = fast.release_velocity**2 / (2 * fast.deceleration)
    assert braking == pytest.approx(fast.sliding_distance, rel=0.03)
    assert fast.onsets == pytest.approx((0.0,), abs=1e-4) and fast.jumps == ()
    assert len(slow.onsets) == 2 and slow.jumps == pytest.approx((0.0352,), abs=1e-4)
    assert fast.partings == () and slow.onsets[0] < slow.partings[0] < slow.onsets[1]


def test_zeros_of_the_sensors():
    """The position's zero is arbitrary; the force's is part of what the sensor reads."""
    push = record(1500, 4)
    assert push.force is not None and push.position is not None
    moved = replace(
        push,
        force=Channel.of(push.force.samples + 2.0, 1e-4, push.force.start, "N"),
        position=Channel.of(push.position.samples - 0.3, 1e-4, push.position.start, "m"),
    )
    noise = Noise(LEVEL_N), Noise(LEVEL_M)
    here, there = reduce_push(push, *noise), reduce_push(moved, *noise)
    assert there.peak_force == pytest.approx(here.peak_force + 2.0, abs=1e-6)
    assert there.sliding_distance == pytest.approx(here.sliding_distance, abs=1e-9)
    assert there.force_level == pytest.approx(here.force_level + 2.0)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1e4, 2e5])
@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_coverage_over_speeds(rate, phi):
    """The figures of docs/reduction.md: 100 draws of noise a speed."""
    inside = []
    for v in (500, 800, 1000, 1500, 2500, 4000, 5000):
        _, _, _, F_p, d = trace(v, rate)
        noise, rows = (Noise(LEVEL_N, phi), Noise(LEVEL_M, phi)), []
        for seed in range(100):
            f = reduce_push(record(v, seed, phi, rate=rate), *noise)
            rows.append((f.peak_force - F_p, f.peak_force_se))
            rows[-1] += (f.sliding_distance - d, f.sliding_distance_se)
        F, F_se, x, x_se = np.array(rows).T
        z = np.stack([F / F_se, x / x_se])
        inside.append(np.mean(np.abs(z) < 1.96, axis=1))
        print(
            f"{rate:6.0f} Hz  phi {phi}  {v} mm/min  F_p: bias {F.mean():+.3f} sd {F.std():.3f} "
            f"se {np.median(F_se):.3f} N, inside {inside[-1][0]:.2f} "
            f" d: bias {1e6 * x.mean():+.3f} sd {1e6 * x.std():.3f} "
            f"se {1e6 * np.median(x_se):.3f} um, inside {inside[-1][1]:.2f}"
        )
        if phi == 0.0:
            assert abs(F.mean()) < 0.1
    assert (np.mean(inside, axis=0) >= 0.9).all() and (np.mean(inside, axis=0) <= 0.99).all()


@pytest.mark.parametrize("phi", [0.0, 0.7])
@pytest.mark.parametrize("centre", [0.0, 11.2, 30.0])
def test_the_best_of_all_windows(phi, centre):
    """The fast choice of a window is that of fitting each of them."""
    rng, sides = np.random.default_rng(7), {"left": [3, 5, 8, 11], "right": [3, 6, 9, 20]}
    t = np.arange(40.0)
    y = 50 + 0.02 * (t - 11) ** 2 + 0.01 * np.maximum(t - 17, 0) ** 3 + 0.3 * ar1(rng, 40, phi)
    stretch, i = Stretch(t, y, 1.0, Noise(0.3, phi)), int(np.searchsorted(t, centre))
    fits = [
        fit_window(stretch, max(i - a, 0), min(i + b, 40), centre, 10.0, powers(2), _cubic)
        for a in sides["left"]
        for b in sides["right"]
        if i >= a or i == 0
    ]
    best = max(fits, key=lambda fit: (fit.passed, -fit.se(1)))
    sides = {"left": [a for a in sides["left"] if a <= i] or [0], "right": sides["right"]}
    sides["right"] = [b for b in sides["right"] if i + b <= 40]
    keep = (best.lo, best.hi)  # as found, not shortened
    found = best_window(stretch, centre, 10.0, powers(2), _cubic, **sides, least=3, of=1, keep=keep)
    assert found is not None and best.passed > 0
    assert (found.lo, found.hi) == (best.lo, best.hi)
    np.testing.assert_array_equal(found.coefficients, best.coefficients)


def _cubic(s, first, last):
    return np.stack([s**3, np.maximum(s - 0.3 * last, 0)], axis=-1)


# ---- random rigs: short, late and last contacts, releases at the pusher's stop


def holds(rows, least=0.85, most=1.2, wrong=0.01):
    """z about standard normal, almost none beyond 4, and d where there is one, and only there."""
    for name in ("z_force", "z_distance"):
        z = np.array([getattr(row, name) for row in rows])
        print(summary(name, z))
        z = z[np.isfinite(z)]
        assert np.mean(np.abs(z) > 4) < wrong
        assert least < z.std() < most and abs(z.mean()) < 0.3
    exists = np.isfinite([row.push.sliding_distance for row in rows])
    given = np.isfinite([row.found.sliding_distance for row in rows])
    assert np.mean(exists != given) < wrong


def test_random_rigs():
    holds(list(survey([2, 7, 8, 15, 19, 23])))  # d was off by up to 350 errors there


def test_a_stop_that_nobody_told():
    """Without the stroke, the pusher's stop is seen in the force alone."""
    holds(list(survey([8, 19, 23], told=np.nan)), most=1.3, wrong=0.03)


def test_a_stop_that_is_told_wrong():
    holds(list(survey([8, 19, 23], told=0.97)), most=1.3, wrong=0.03)


def test_rests_in_contact_with_almost_no_force():
    rows = [row for row in survey([107]) if np.isnan(row.push.sliding_distance)]
    assert rows
    for row in rows:
        assert np.isnan(row.found.sliding_distance)
        assert row.found.reason.startswith(RESTS_IN_CONTACT)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rigs", "rate", "rho", "told", "most", "wrong"),
    [
        (100, 1e4, 0.0, 1.0, 1.2, 0.01),
        (20, 2e5, 0.0, 1.0, 1.25, 0.01),
        (60, 1e4, 0.0, np.nan, 1.5, 0.03),
        (60, 1e4, 0.9, 1.0, 2.5, 0.02),
    ],
)
def test_survey(rigs, rate, rho, told, most, wrong):
    """The survey of docs/reduction.md."""
    holds(list(survey(range(rigs), rate, rho, told)), most=most, wrong=wrong)


# ---- what is not to be had, and why


def test_rests_in_contact():
    found = reduce_push(record(500, mu_s=0.3))
    assert found.reason == RESTS_IN_CONTACT and np.isnan(found.sliding_distance)
    assert found.peak_force == pytest.approx(trace(500, mu_s=0.3)[3], abs=0.5)


def test_a_channel_missing():
    push = record(2500)
    blind, deaf = replace(push, position=None), replace(push, force=None)
    assert "no position" in reduce_push(blind).reason
    assert reduce_push(blind).peak_force == pytest.approx(trace(2500)[3], abs=0.5)
    assert "no force" in reduce_push(deaf).reason
    assert np.isfinite(reduce_push(deaf).rest_position)


def test_recording_that_starts_late():
    push = record(2500)
    assert push.force is not None and push.position is not None
    late = replace(push, force=cut(push.force, 0.002), position=cut(push.position, 0.002))
    found = reduce_push(late)
    assert "no quiet time" in found.reason
    assert found.peak_force == pytest.approx(trace(2500)[3], abs=0.8)
    assert found.sliding_distance == pytest.approx(trace(2500)[4], abs=6e-6)


def test_refused_by_name_or_skipped():
    good, other = record(2500, 1), record(2500, 2)
    assert other.force is not None and other.position is not None
    quiet = Channel.of(LEVEL_N * ar1(np.random.default_rng(0), 1000, 0.0), 1e-4, -0.02, "N")
    empty = replace(other, force=quiet, position=None, name="push 2")
    moving = replace(other, position=cut(other.position, t_1=0.04), name="push 3")
    recordings = Recordings((good, empty, moving), source="pushes.tdms")
    with pytest.raises(InputError) as refusal:
        reduce_recordings(recordings)
    message = str(refusal.value)
    assert message.startswith("pushes.tdms: ") and "\n" not in message
    assert f"push 2 {WITHOUT_CONTACT}" in message and f"push 3 {NEVER_RESTS}" in message
    kept = reduce_recordings(recordings, skip_bad=True)
    assert len(kept.pushes) == len(kept.recordings) == len(kept.details) == 1
    assert len(kept.pushes.skipped) == 2
    with pytest.raises(InputError, match="push 2"):
        reduce_recordings(recordings.select([1]), skip_bad=True)


def test_volts_are_refused():
    push = record(2500)
    assert push.force is not None
    with pytest.raises(InputError, match="force is in V, expected N"):
        reduce_push(replace(push, force=push.force.scale(0.01, "V")))


def test_samples_that_are_no_numbers_are_refused():
    push = record(2500)
    assert push.force is not None
    samples = push.force.samples.copy()
    samples[300] = np.nan
    broken = replace(push, force=Channel.of(samples, 1e-4, push.force.start, "N"))
    with pytest.raises(InputError, match=r"^push 0: a sample in N near t = 0\.01005 s"):
        reduce_push(broken)


def test_a_table_of_pushes():
    said = {"mass": 18.9, "stroke": 0.0015, "condition": "DRY", "mu_s_gauge": 0.14}
    pushes = [
        replace(record(v, i), order=float(i), rest_before=3.0, **said)
        for i, v in enumerate((800, 2500))
    ]
    reduction = reduce_recordings(Recordings(tuple(pushes), source="a.tdms"))
    table = reduction.pushes
    np.testing.assert_allclose(table.velocity * 6e4, [800, 2500])
    np.testing.assert_allclose(table.peak_force, [trace(v)[3] for v in (800, 2500)], atol=0.6)
    assert table.condition == ("DRY", "DRY") and list(table.order) == [0, 1]
    for name in ("mass", "stroke", "mu_s_gauge"):
        np.testing.assert_allclose(getattr(table, name), said[name])
    for name in ("peak_force_se", "sliding_distance_se", "release_velocity_se"):
        assert (getattr(table, name) > 0).all()


def test_a_long_recording_is_read_in_pieces():
    force, position, start, F_p, d = trace(2500, 2e5)
    rng, n, largest = np.random.default_rng(1), 3_000_000, []

    def channel(y, level, unit):
        def read(lo, hi):
            largest.append(hi - lo)
            i = np.clip(np.arange(lo, hi), 0, len(y) - 1)
            return y[i] + level * rng.standard_normal(hi - lo)

        return Channel(n, 5e-6, start, unit, read)

    push = Recording(2500 / 6e4, channel(force, LEVEL_N, "N"), channel(position, LEVEL_M, "m"))
    found = reduce_push(push)
    assert max(largest) <= 1 << 20
    assert found.peak_force == pytest.approx(F_p, abs=0.2)
    assert found.sliding_distance == pytest.approx(d, abs=2e-6)


# ---- practice data


def practice(name) -> tuple[Recordings, dict]:
    nptdms = pytest.importorskip("nptdms")
    if not (PRACTICE / name).is_dir():
        pytest.skip("no practice data")
    pushes = []
    for group in nptdms.TdmsFile.read(PRACTICE / name / "pushes.tdms").groups():
        p, channels = group.properties, {}
        for c in group.channels():
            unit, factor = {"N": ("N", 1.0), "um": ("m", 1e-6)}[c.properties["unit_string"]]
            dt, start = c.properties["wf_increment"], c.properties["wf_start_offset"]
            channels[c.name] = Channel.of(factor * c[:], dt, start, unit)
        pushes.append(Recording(p["velocity_mm_min"] / 6e4, **channels, name=group.name))
    truth = json.loads((PRACTICE / name / "truth.json").read_text())
    return Recordings(tuple(pushes), source=name), truth


@pytest.mark.parametrize("name", ["clean", "stribeck", "initial_gap_and_force_offset"])
def test_practice_data(name):
    recordings, truth = practice(name)
    offset = truth["effects"].get("force_offset.offset_N", 0.0)
    assert pool_noise(recordings, "force").level == pytest.approx(0.5, rel=0.05)
    reduction = reduce_recordings(recordings)
    table = reduction.pushes
    F_p = np.array([p["peak_contact_force_N"] for p in truth["pushes"]]) + offset
    d = np.array([p["sliding_distance_um"] for p in truth["pushes"]]) * 1e-6
    assert abs(np.mean(table.peak_force - F_p)) < 0.1
    for z in (
        (table.peak_force - F_p) / table.peak_force_se,
        (table.sliding_distance - d) / table.sliding_distance_se,
    ):
        assert abs(z.mean()) < 0.8 and 0.6 < np.sqrt(np.mean(z**2)) < 1.6
        assert np.abs(z).max() < 4
    contacts = [p["contacts"] for p in truth["pushes"]]
    assert [len(r.onsets) for r in reduction.details] == contacts


def test_a_slip_that_ends_stuck_comes_to_rest():
    """It slips 0.4 mm in 30 ms, half way to the end: a parabola through it does not end flat."""
    t, rng = np.arange(-0.5, 4.0, 2e-3), np.random.default_rng(3)
    x = 4e-4 * np.clip((t - 2) / 0.03, 0, 1) + LEVEL_M * rng.standard_normal(len(t))
    position = Channel.of(x, 2e-3, t[0], "m")
    found = reduce_push(Recording(2e-4, None, position))
    assert not found.problem and found.rest_time == pytest.approx(2.03, abs=0.01)
    assert found.rest_position == pytest.approx(4e-4, abs=1e-7)
