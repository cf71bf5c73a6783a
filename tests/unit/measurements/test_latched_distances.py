"""What a latch at the first loss of contact would count more is told of a recording."""

from __future__ import annotations

import numpy as np
import pytest

from difffric.measurements.latched_distances import describe_latch
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.measurements.reduction.reduce import reduce_recordings
from tests.reference import data as reference

RIG = reference.Rig(m=18.9, mu_s=0.141, ratio=0.75, k_v=5.0, k=7e5, b=400.0, stroke=1e-3)
SLOW, FAST = 500 / 60e3, 3000 / 60e3


def record(v, seed=1, rate=20e3):
    """A recording of one push, and its positions at the first and the last loss of contact."""
    rng = np.random.default_rng(seed)
    push = reference.Push(RIG, v, RIG.mu_s, RIG.follow(v))
    seen = reference.record(push, rng, rate=rate)
    force, position = (
        Channel.of(y, seen.dt, seen.start, unit)
        for y, unit in ((seen.force, "N"), (seen.position, "m"))
    )
    t = np.arange(0.0, seen.time[-1], 1e-6)
    exact, x, _ = push.course(t)
    lost = x[1:][(exact[:-1] > 0) & (exact[1:] <= 0)]
    return Recording(v, force, position, stroke=RIG.stroke, name=f"push at {v:.4f}"), lost


@pytest.fixture(scope="module")
def slow():
    return record(SLOW)


def test_a_slow_push_is_pushed_on_after_the_latch(slow):
    """By what lies between the first and the last loss of contact; a contact's end is known to a
    fifteenth of its duration, over which this part goes some micrometres."""
    recording, lost = slow
    assert len(lost) > 1
    (found,) = reduce_recordings(Recordings([recording])).details
    more = found.latched_distance - found.sliding_distance
    assert more == pytest.approx(lost[-1] - lost[0], rel=0.01)


def test_the_note_names_the_push_and_how_much(slow):
    fast, once = record(FAST)
    assert len(once) == 1
    (note,) = describe_latch(reduce_recordings(Recordings([fast, slow[0]])))
    assert note.startswith("1 of 2 pushes") and slow[0].name in note
    assert describe_latch(reduce_recordings(Recordings([fast]))) == ()
