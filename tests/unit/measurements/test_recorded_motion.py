"""A recorded tip's motion is smoothed, and its error is what the samples leave of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from difffric.errors import InputError
from difffric.measurements.recorded_motion import (
    MODES,
    PIECES,
    SmoothedMotion,
    describe_motion,
    smooth_motion,
    take_recorded_motion,
)
from difffric.measurements.recordings import Channel, Recording, Recordings
from tests.hidden.case import Case, Push
from tests.hidden.tip import follow_tip

SPEED, STROKE, NOISE, RATE = 0.05, 2e-3, 3e-7, 10e3
RAMP = {"pusher_ramp": {"acceleration_m_per_s2": 5.0}}
RIPPLE = {"pusher_ripple": {"amplitude": 0.02, "period_m": 1e-3, "phase_rad": 0.3}}
RIG = {"mass_kg": 18.9}


def record_tip(effects, noise=NOISE, scale=1.0, end=0.1, start=-0.02, seed=0):
    """(recording, times, exact travel) of a tip with these effects."""
    push = Push(SPEED, 0.14, 0, 0.0)
    case = Case(0, "recordings", RIG, {"A": 0.14}, 0.0, [push], effects=effects, stroke=STROKE)
    t = np.arange(start, end, 1 / RATE) + 0.5 / RATE
    y = follow_tip(case, push, t)
    read = scale * (y + 0.4e-3 + noise * np.random.default_rng(seed).standard_normal(len(t)))
    tip = Channel.of(read, 1 / RATE, t[0], "m")
    return Recording(SPEED, pusher=tip, name="push 1"), t, y


def travel_at(motion: SmoothedMotion, t):
    """(y, V) of a smoothed motion at the times t [s], its polynomials integrated one by one."""
    law = motion.law
    n = int(np.isfinite(law.corners).sum())
    ends = np.append(law.corners[1:n], law.end)
    powers = np.arange(1, 4)
    steps = (law.rates[:n] * (ends - law.corners[:n])[:, None] ** powers / powers).sum(axis=1)
    before = np.concatenate([[0.0], np.cumsum(steps)])
    piece = np.clip(np.searchsorted(law.corners[:n], t, side="right") - 1, 0, n - 1)
    s = np.clip(t, 0, law.end) - law.corners[piece]
    c = law.rates[piece]
    y = before[piece] + (c * s[:, None] ** powers / powers).sum(axis=1)
    return y, c[:, 0] + s * (c[:, 1] + s * c[:, 2])


def test_a_tip_that_keeps_its_speed_and_has_no_noise_is_that_to_round_off():
    recording, t, y = record_tip({}, noise=0.0)
    motion = smooth_motion(recording)
    assert motion.end == pytest.approx(STROKE / SPEED, abs=1e-9)
    assert motion.travel == pytest.approx(STROKE, rel=1e-9)
    found, V = travel_at(motion, t)
    np.testing.assert_allclose(found, y, atol=1e-10)
    np.testing.assert_allclose(V[(t > 0) & (t < motion.end)], SPEED, rtol=1e-6)


@pytest.mark.parametrize("effects", [{}, RAMP, RIPPLE, RAMP | RIPPLE])
def test_the_motion_is_as_near_as_its_variance_says(effects):
    """Root mean squares of y's and V's errors over twelve recordings: as told, to a third."""
    errors, told = [], []
    for seed in range(12):
        recording, t, y = record_tip(effects, seed=seed)
        motion = smooth_motion(recording)
        inside = (t > 0) & (t < motion.end)
        fine = t[inside]
        found, V = travel_at(motion, fine)
        true_V = np.gradient(y, t)[inside]
        smooth = slice(3, -3)  # a difference of samples is no speed beside a corner
        errors.append([np.mean((found - y[inside]) ** 2), np.mean((V - true_V)[smooth] ** 2)])
        told.append(motion.variance[:2])
    ratio = np.sqrt(np.mean(errors, axis=0) / np.mean(told, axis=0))
    assert (ratio > 0.65).all() and (ratio < 1.35).all()


def test_a_ramp_s_end_is_found_and_the_tip_stops_where_it_did():
    recording, t, y = record_tip(RAMP)
    motion = smooth_motion(recording)
    assert min(abs(kink - SPEED / 5.0) for kink in motion.kinks) < 3e-4
    stop = t[np.argmax(y >= STROKE)]
    assert motion.end == pytest.approx(stop, abs=2 / RATE)
    assert motion.travel == pytest.approx(STROKE, abs=NOISE)


def test_every_motion_has_one_shape_and_a_bandwidth():
    """So that one program follows them all. A ripple needs more of a band than a steady speed."""
    bands = []
    for effects in ({}, RIPPLE):
        motion = smooth_motion(record_tip(effects)[0])
        assert motion.law.corners.shape == (PIECES + 1,) and np.isinf(motion.law.corners[-1])
        assert motion.law.rates.shape == (PIECES + 1, 3)
        assert motion.modes.rates.shape == (MODES, PIECES + 1, 3)
        bands.append(motion.bandwidth)
    assert 0.5 * 3 / motion.end < bands[0] < bands[1] < 0.5 * MODES / motion.end


def test_a_recording_is_then_of_the_travel_and_the_mean_speed_of_its_tip():
    (push,) = take_recorded_motion(Recordings((record_tip(RAMP)[0],)))
    assert push.stroke == push.motion.travel
    assert push.stroke / push.velocity == pytest.approx(push.motion.end)
    (note,) = describe_motion([push])
    assert (
        "driven by the recorded pusher" in note and " Hz" in note and "µm of noise a sample" in note
    )


WITHOUT = record_tip({})[0]
assert WITHOUT.pusher is not None
BAD = np.array(WITHOUT.pusher.samples)
BAD[300] = np.nan


@pytest.mark.parametrize(
    ("recording", "words"),
    [
        (replace(WITHOUT, pusher=None), "no channel pusher"),
        (replace(WITHOUT, pusher=Channel.of(BAD, 1 / RATE, -0.02, "m")), "no numbers"),
        (record_tip({}, end=0.02)[0], "still moves where its recording ends"),
        (record_tip({}, end=0.001)[0], "samples before t = 0"),
        (record_tip({}, start=0.0)[0], "0 samples before t = 0"),
        (record_tip({}, scale=1e3)[0], "is the channel's unit right?"),
        (record_tip({}, scale=-1.0)[0], "does not move forwards"),
    ],
)
def test_a_pusher_that_says_no_motion_is_told_in_one_line(recording, words):
    good = record_tip({})[0]
    data = Recordings((good, replace(recording, name="push 2")), "pushes.tdms")
    with pytest.raises(InputError, match="push 2") as refused:
        take_recorded_motion(data)
    assert words in str(refused.value) and "\n" not in str(refused.value)
    kept = take_recorded_motion(data, skip_bad=True)
    assert len(kept) == 1 and words in kept.skipped[0]
