"""A start offset of a push stays within what its recording holds."""

from __future__ import annotations

import numpy as np
import pytest

import difffric as df
from difffric.measurements.recordings import Channel, Recording, Recordings
from tests.reference import traces

SPEED, STROKE, DT = 0.05, 2e-3, 1e-4
RIG = {"mass": 18.9, "k": 8.0e5, "b": 1500.0, "k_v": 5.0, "mu_k_over_mu_s": 0.75}


def record(true_start, begin, seed=0):
    """A push whose pusher started at `true_start` [s], recorded since `begin` [s]."""
    course = traces.follow(18.9, 0.141, 0.75, 5.0, 8e5, 1500.0, SPEED, STROKE)
    t = np.arange(begin, course.end + true_start + 0.03, DT) + DT / 3
    force, x, _ = course(t - true_start)
    rng = np.random.default_rng(seed)
    read = (
        Channel.of(y + noise * rng.standard_normal(len(t)), DT, t[0], unit)
        for y, noise, unit in ((force, 0.5, "N"), (x, 3e-7, "m"))
    )
    return Recording(SPEED, *read, stroke=STROKE, mass=18.9, name=f"push {seed + 1}")


def fit(k, *recordings):
    """A fit of mu_s with free starts, the stiffness [N/m] held."""
    rig = df.spring_damper_rig(**{**RIG, "k": k}, mu_s=0.14, stroke=STROKE)
    return df.fit(
        rig, Recordings(recordings), free=["mu_s"], free_start=True, several_starts=False
    )  # fmt: skip


def test_a_start_is_held_where_the_recording_begins_and_told():
    """A contact half as stiff would have had to be pushed for longer than was recorded."""
    pushes = record(0.0, -0.02), record(0.0, -5e-4, 1)
    found = fit(8e5 / 2, *pushes)
    assert found.start[0] < -1e-3  # as far as its recording allows
    assert found.start[1] == pytest.approx(-5e-4, abs=2 * DT)
    (note,) = (x for x in found.notes if "start offset" in x)
    assert "at the bound of what the recording holds (push 2 -0.000" in note


def test_starts_within_the_recordings_are_found():
    found = fit(8e5, record(0.0, -0.02), record(0.003, -0.02, 1))
    assert found.start == pytest.approx([0.0, 0.003], abs=1e-6)
    assert not any("start offset" in x for x in found.notes)
