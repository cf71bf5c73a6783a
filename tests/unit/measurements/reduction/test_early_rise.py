"""A force that rises before t = 0 is told as what it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from difffric.errors import InputError
from difffric.measurements.recordings import Channel, Recordings
from difffric.measurements.reduction.early_rise import find_early_rise
from difffric.measurements.reduction.reduce import WITHOUT_CONTACT, reduce_push, reduce_recordings
from tests.unit.measurements.reduction.test_reduce import ar1, cut, record


def make_force(begin, phi=0.0, height=5.4, seed=0):
    """A force of 100 Hz that rises along a line from `begin` to 2 s after it, its noise 0.01 N."""
    t = np.arange(-5.0, 5.0, 0.01)
    force = height * np.clip((t - begin) / 2, 0, 1) * (t < begin + 2)
    noise = 0.01 * ar1(np.random.default_rng(seed), len(t), phi)
    return Channel.of(force + noise, 0.01, t[0], "N")


@pytest.mark.parametrize("phi", [0.0, 0.9])
@pytest.mark.parametrize("begin", [-4.0, -2.5])
def test_what_rises_before_the_start_is_found_with_its_height_and_time(begin, phi):
    found = find_early_rise(make_force(begin, phi))
    assert found is not None
    assert found.height == pytest.approx(5.4, rel=0.02)
    assert found.begin == pytest.approx(begin, abs=0.35)


def test_a_push_before_its_time_is_no_push_without_contact():
    push = replace(record(2500), force=make_force(-3.0), position=None)
    assert "rises by 5.4" in reduce_push(push).problem
    with pytest.raises(InputError) as refusal:
        reduce_recordings(Recordings((push,)))
    assert WITHOUT_CONTACT not in str(refusal.value)
    assert "before t = 0" in str(refusal.value)


def test_a_force_that_is_high_from_the_first_sample_on_is_no_push_without_contact():
    """The push began 6 ms before t = 0, the recording 1.5 ms before, about its peak."""
    push = record(2500)
    assert push.force is not None
    push = replace(push, force=replace(push.force, start=push.force.start - 6e-3), position=None)
    late = replace(push, force=cut(push.force, -1.5e-3))
    problem = reduce_push(late).problem
    assert "N before t = 0, from -0.0015" in problem and WITHOUT_CONTACT not in problem


@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_noise_does_not_rise(phi):
    """Of a force that is all noise, and of ordinary pushes."""
    for seed in range(100):
        force = make_force(-3.0, phi, 0.0, seed)
        assert not find_early_rise(force) and not find_early_rise(force, above_rest=True)
    for seed in range(5):
        force = record(2500, seed, phi, scale=3.0).force
        assert force is not None and find_early_rise(force) is None


def test_a_push_that_begins_a_little_early_says_so():
    """Of 15 ms of quiet 5 remain: the force is read, with a reason."""
    push = record(2500)
    assert push.force is not None and push.position is not None
    early = replace(
        push,
        force=replace(push.force, start=push.force.start - 5e-3),
        position=replace(push.position, start=push.position.start - 5e-3),
    )
    assert "before t = 0, from -0.00" in reduce_push(early).reason
