"""A recorded pusher is held against its command."""

from __future__ import annotations

import numpy as np
import pytest

import difffric as df
from difffric.measurements.pusher_tracking import describe_tracking, track_pusher
from difffric.measurements.recordings import Channel, Recording, Recordings
from tests.reference import traces

SPEED, STROKE, DT = 0.05, 2e-3, 1e-4
RIG = {"mass": 18.9, "k": 8.0e5, "b": 1500.0, "k_v": 5.0, "mu_k_over_mu_s": 0.75}


def record_tip(change, start=-0.02, stroke=STROKE, name="push 1", **more):
    """A recording whose tip is `change(t)` from its command, from a zero of its own."""
    t = np.arange(start, 0.1, DT) + DT / 3
    command = np.clip(SPEED * t, 0, STROKE)
    tip = Channel.of(command + change(t) + (0.7e-3 if start < 0 else 0), DT, t[0], "m")
    return Recording(SPEED, pusher=tip, stroke=stroke, name=name, **more)


@pytest.mark.parametrize("start", [-0.02, 0.0])
def test_a_tip_that_keeps_to_its_command_is_at_no_distance(start):
    found = track_pusher(record_tip(lambda t: 0.0 * t, start))
    assert found is not None
    assert found.largest < 1e-12 and found.speed_ratio == pytest.approx(1, abs=1e-9)


def test_a_slow_tip_has_its_speed_and_the_distance_that_it_comes_short():
    """2 % slow, it is at the commanded stop 2 % of the stroke behind, and stays there."""
    found = track_pusher(record_tip(lambda t: -0.02 * np.clip(SPEED * t, 0, STROKE)))
    assert found is not None
    assert found.speed_ratio == pytest.approx(0.98, abs=1e-6)
    assert found.largest == pytest.approx(0.02 * STROKE, rel=1e-6)
    assert 0.7 * found.largest < found.rms < found.largest
    silent = record_tip(lambda t: -0.02 * np.clip(SPEED * t, 0, STROKE), stroke=np.nan)
    assert track_pusher(silent, STROKE) == found  # the rig's stroke, where the recording says none


def test_a_ripple_has_its_amplitude_and_its_rms():
    found = track_pusher(record_tip(lambda t: 5e-6 * np.sin(2 * np.pi * t / 0.02) * (t > 0)))
    assert found is not None
    assert found.largest == pytest.approx(5e-6, rel=1e-2)
    assert found.rms == pytest.approx(5e-6 / np.sqrt(2), rel=2e-2)


def test_the_note_names_the_worst_push_and_both_figures():
    good = record_tip(lambda t: 0.0 * t)
    late = record_tip(lambda t: -3e-5 * (t > 0), name="push 2")
    (note,) = describe_tracking([good, late])
    assert "up to 30 µm (push 2) from its command, 21.2 µm in the rms" in note
    assert "at 1 times its speed" in note
    assert not describe_tracking([Recording(SPEED, force=good.pusher)])


@pytest.mark.parametrize("command", ["identify", pytest.param("fit", marks=pytest.mark.slow)])
def test_identify_and_fit_tell_it(command):
    course = traces.follow(18.9, 0.141, 0.75, 5.0, 8e5, 1500.0, SPEED, STROKE)
    t, rng = np.arange(-0.02, course.end + 0.03, DT) + DT / 3, np.random.default_rng(0)
    force, x, y = course(t)
    read = {
        which: Channel.of(value + noise * rng.standard_normal(len(t)), DT, t[0], unit)
        for which, value, noise, unit in (
            ("force", force, 0.5, "N"),
            ("position", x, 3e-7, "m"),
            ("pusher", 0.97 * y, 1e-7, "m"),
        )
    }
    recordings = Recordings((Recording(SPEED, **read, stroke=STROKE, mass=18.9),))
    rig = df.spring_damper_rig(**RIG, mu_s=0.14, stroke=STROKE)
    if command == "identify":
        notes = df.identify(rig, recordings).notes
    else:
        notes = df.fit(rig, recordings, free=["k_N_per_m"], several_starts=False).notes
    assert any("pusher was up to 60" in note and "0.97 times" in note for note in notes)
