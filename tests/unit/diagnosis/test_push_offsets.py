"""What is off in each push by another amount is corrected: trigger, zero of the force, speed."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import difffric as df
from difffric.diagnosis import start as starting
from difffric.diagnosis.inferred import push_offsets
from difffric.diagnosis.inferred.push_offsets import (
    PushOffsets,
    _is_real,
    compare_zeros,
    describe_offsets,
    find_push_offsets,
)
from difffric.diagnosis.start import fit_plain_model, prepare_start, shift_by_offsets
from difffric.errors import InputError
from difffric.measurements.recordings import Channel
from difffric.progress import silent
from difffric.rig.setup_toml import read_setup
from tests.hidden import random_case, record, simulate, write
from tests.hidden.simulate import lateness
from tests.unit.diagnosis.analysis import Analysis

CLEAN = replace(random_case(7_711_000), jitter=5e-6)
SPEEDS = np.geomspace(0.008, 0.08, 14)
PHI = CLEAN.noise.force_phi
ZERO = CLEAN.noise.force * np.sqrt((1 + PHI) / (1 - PHI) / (CLEAN.before * CLEAN.rate))
"""Standard error [N] of a zero by the time before the push."""


@pytest.fixture(scope="module")
def begin(tmp_path_factory):
    """Case -> (its set-up, where its search starts, its plain fit)."""

    def begin(case):
        folder = tmp_path_factory.mktemp("case")
        data = df.load(write(case, folder))
        setup = read_setup(folder / "setup.toml")
        start = prepare_start(setup, data, silent)
        return setup, start, fit_plain_model(start.data.task, start.at, start.guess)

    return begin


@pytest.mark.parametrize(
    "jitter, zeros, speeds",
    [
        pytest.param(5e-6, 0, 0, marks=pytest.mark.slow),
        pytest.param(20e-6, 0, 0, marks=pytest.mark.slow),
        pytest.param(0, 1, 0, marks=pytest.mark.slow),
        pytest.param(0, 0, 2e-4, marks=pytest.mark.slow),
        (5e-6, 0.2, 2e-4),
    ],
)
def test_offsets_are_those_of_the_pushes_and_no_more_are_left(
    jitter, zeros, speeds, begin, monkeypatch
):
    case = replace(CLEAN, jitter=jitter)
    zero, faster = disturb(monkeypatch, zeros, speeds)
    setup, start, plain = begin(case)
    while (anew := shift_by_offsets(setup, start, plain, silent)) is not None:
        start = anew
        plain = fit_plain_model(start.data.task, start.at, start.guess)
    assert 0 < len(start.offsets) < 3 and find_push_offsets(start.data.task, plain) is None
    found = {
        name: np.sum([getattr(one, name) for one in start.offsets], axis=0)
        for name in ("late", "zero", "faster")
    }
    fast = np.array([push.velocity for push in case.pushes]) > 0.02
    np.testing.assert_allclose(found["late"][fast], lateness(case)[fast], atol=1e-6)
    slowest = 1e-5  # where force and position hardly change in time
    np.testing.assert_allclose(found["late"], lateness(case), atol=slowest)
    np.testing.assert_allclose(found["faster"], faster, atol=5e-5)
    # What all zeros are off by is the sensor's, and an effect of the catalogue.
    apart = found["zero"] - found["zero"].mean()
    np.testing.assert_allclose(apart, zero - zero.mean(), atol=5 * ZERO)
    said = " ".join(describe_offsets(start.offsets))
    for word, size in (("triggers", jitter), ("zero", zeros), ("speeds", speeds)):
        assert (word in said) == (size > 0)


def test_zeros_are_compared_without_any_model(begin, monkeypatch):
    case = replace(CLEAN, jitter=0.0)
    for same in (case, case.with_effect("force_offset", {"offset_N": 3.0})):
        assert compare_zeros(begin(same)[1].data.reduction) is None
    zero, _ = disturb(monkeypatch, 1.0, 0.0)
    found = compare_zeros(begin(case)[1].data.reduction)
    assert found is not None and not found.late.any() and not found.faster.any()
    np.testing.assert_allclose(found.zero, zero - zero.mean(), atol=5 * ZERO)


def disturb(monkeypatch, zeros, speeds):
    """The force of every push that is recorded from now on has a zero of its own [N], and its
    speed is off by a share of its own: (n,) each."""
    zero, faster = np.random.default_rng(5).standard_normal((2, len(CLEAN.pushes)))

    def wander(case):
        moved = zip(case.pushes, faster, strict=True)
        pushes = tuple(replace(push, velocity=push.velocity * (1 + by)) for push, by in moved)
        made = record(replace(case, pushes=pushes))
        return [
            replace(one, push=push, force=one.force + by)
            for one, push, by in zip(made, case.pushes, zero, strict=True)
        ]

    zero, faster = zeros * zero, speeds * faster
    monkeypatch.setattr(simulate, "record", wander)
    return zero, faster


@pytest.mark.parametrize(
    "hidden",
    [None, "soft_layer", "speed_sag", pytest.param("force_offset", marks=pytest.mark.slow)],
)
def test_no_offsets_where_pushes_are_not_off_at_random(hidden, begin):
    case = replace(CLEAN, jitter=0.0)
    case = case if hidden is None else random_case(1_000_007, hidden, 40.0)
    _, start, plain = begin(case)
    assert find_push_offsets(start.data.task, plain) is None
    assert describe_offsets(()) == ()


def test_two_offsets_that_do_the_same_are_not_told(monkeypatch):
    """They had ended a diagnosis with `Singular matrix`."""
    n, J, same = 3, np.arange(8.0), np.ones((3, 8))
    rows = np.stack([np.tile(J, (n, 1)), np.tile(J**2, (n, 1))], axis=-1)
    monkeypatch.setattr(push_offsets, "_ask", lambda *given: rows)
    monkeypatch.setattr(push_offsets, "_differentiate", lambda *given: same)
    task: Any = SimpleNamespace(n=n, shared=(), conditions=1, condition=np.zeros(n, int))
    at: Any = SimpleNamespace(scatter=np.array([0.1]), own=np.zeros((1, n)))
    assert push_offsets._fit_offsets(task, at, (0, 1)) is None


@given(
    st.lists(
        st.tuples(st.floats(-1e-3, 1e-3), st.floats(-5, 5), st.floats(-0.1, 0.1)),
        min_size=2,
        max_size=2,
    )
)
def test_moving_back_is_the_inverse_of_moving(offsets):
    channel = Channel.of(np.arange(5.0), 1e-4, -2e-3, "N")
    pushes = (
        df.Recording(0.05, force=channel, position=channel),
        df.Recording(0.01, position=channel),
    )
    by = np.array(offsets).T
    moved = PushOffsets(*by).take_from(df.Recordings(pushes))
    back = PushOffsets(-by[0], -by[1], 1 / (1 + by[2]) - 1).take_from(moved)
    for before, there, after, (late, zero, faster) in zip(
        pushes, moved, back, offsets, strict=True
    ):
        assert (before.force is None) == (there.force is None)
        assert there.velocity == pytest.approx(before.velocity * (1 + faster), rel=1e-14)
        assert after.velocity == pytest.approx(before.velocity, rel=1e-14)
        for name, off in (("force", zero), ("position", 0.0)):
            one, two, three = (getattr(push, name) for push in (before, there, after))
            if one is not None:
                assert two.start == pytest.approx(one.start - late, abs=1e-15)
                assert three.start == pytest.approx(one.start, abs=1e-15)
                np.testing.assert_allclose(two.samples, one.samples - off, atol=1e-14)
                np.testing.assert_allclose(three.samples, one.samples, atol=1e-14)


@given(st.integers(0, 1000), st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_what_goes_with_the_speed_is_no_offset(seed, powers):
    smooth = 1e-6 * np.log(SPEEDS)[:, None] ** np.arange(3) @ np.array(powers)
    errors = np.full(14, 1e-7)
    noise = np.random.default_rng(seed).standard_normal(14)
    assert not _is_real(smooth, errors, SPEEDS)
    assert not _is_real(1e-7 * noise, errors, SPEEDS)  # nothing but its error
    assert not _is_real(smooth + 1e-7 * noise, 2 * errors, SPEEDS)
    assert not _is_real(5e-6 + 1e-6 * noise, errors, SPEEDS)  # most of it is the same in all
    assert _is_real(5 * np.ptp(smooth) * noise + 1e-5 * noise, errors, SPEEDS)


def test_records_that_cannot_be_reduced_once_corrected_are_kept(monkeypatch):
    nothing: Any = None
    data = SimpleNamespace(
        reduction=SimpleNamespace(recordings=None), measured=SimpleNamespace(motion=None)
    )
    before: Any = SimpleNamespace(data=data, offsets=())
    offsets = SimpleNamespace(take_from=lambda recordings: recordings)

    def refuse(*given, **options):
        raise InputError("no push is left")

    monkeypatch.setattr(starting, "compare_zeros", lambda reduction: offsets)
    monkeypatch.setattr(starting, "prepare_start", refuse)
    assert shift_by_offsets(nothing, before, nothing, silent) is None


def test_a_rig_with_nothing_but_jitter_is_adequate(tmp_path):
    found = Analysis(CLEAN, tmp_path, matters=0.005).found
    assert found.verdict == "adequate" and not found.causes and found.remaining is None
    assert any("triggers are off by" in note for note in found.notes)
    np.testing.assert_allclose(found.mu_s, [push.mu_s for push in CLEAN.pushes], rtol=1e-3)


@pytest.mark.slow
def test_a_cause_is_named_where_triggers_are_off(tmp_path):
    case = random_case(7_705_000, "pusher_speed", change=0.03, jitter=5e-6)
    one = Analysis(case, tmp_path, matters=0.005)
    assert one.found.verdict == "named" and one.first == {"pusher_speed"}
    assert any("triggers are off by" in note for note in one.found.notes)
