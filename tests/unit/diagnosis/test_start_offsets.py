"""A trigger that is off moves the samples of each push in time: they are moved back."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import difffric as df
from difffric.diagnosis.inferred.start_offsets import (
    _are_random,
    describe_offsets,
    find_start_offsets,
    shift_starts,
)
from difffric.diagnosis.start import fit_plain_model, prepare_start, shift_by_offsets
from difffric.measurements.recordings import Channel
from difffric.progress import silent
from difffric.rig.setup_toml import read_setup
from tests.hidden import random_case, write
from tests.hidden.simulate import lateness
from tests.unit.diagnosis.analysis import Analysis

CLEAN = replace(random_case(7_711_000), jitter=5e-6)
SPEEDS = np.geomspace(0.008, 0.08, 14)


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


@pytest.mark.parametrize("jitter", [5e-6, 20e-6])
def test_the_offsets_are_those_of_the_triggers_and_no_more_are_left(jitter, begin):
    case = replace(CLEAN, jitter=jitter)
    setup, start, plain = begin(case)
    offsets = find_start_offsets(start.data.task, plain)
    assert offsets is not None
    fast = np.array([push.velocity for push in case.pushes]) > 0.02
    np.testing.assert_allclose(offsets[fast], lateness(case)[fast], atol=1e-6)
    np.testing.assert_allclose(offsets, lateness(case), atol=5e-6)
    anew = shift_by_offsets(setup, start, plain, silent)
    assert anew is not None and anew.offsets == (pytest.approx(offsets),)
    again = fit_plain_model(anew.data.task, anew.at, anew.guess)
    assert find_start_offsets(anew.data.task, again) is None
    (said,) = describe_offsets(anew.offsets)
    assert f"{1e6 * np.sqrt(np.mean(offsets**2)):.3g} us" in said


@pytest.mark.parametrize("hidden", [None, "soft_layer", "friction_bump"])
def test_no_offsets_where_every_trigger_is_exact(hidden, begin):
    case = replace(CLEAN, jitter=0.0)
    case = case if hidden is None else random_case(1_000_001, hidden, 40.0)
    _, start, plain = begin(case)
    assert find_start_offsets(start.data.task, plain) is None
    assert describe_offsets(()) == ()


@given(st.lists(st.floats(-1e-3, 1e-3), min_size=2, max_size=2))
def test_shifting_back_is_the_inverse_of_shifting(offsets):
    channel = Channel.of(np.arange(5.0), 1e-4, -2e-3, "N")
    pushes = (
        df.Recording(0.05, force=channel, position=channel),
        df.Recording(0.01, position=channel),
    )
    shifted = shift_starts(df.Recordings(pushes), offsets)
    back = shift_starts(shifted, -np.array(offsets))
    for before, later, after, by in zip(pushes, shifted, back, offsets, strict=True):
        assert (before.force is None) == (later.force is None)
        for name in ("force", "position"):
            one = getattr(before, name)
            if one is not None:
                assert getattr(later, name).start == pytest.approx(one.start - by, abs=1e-15)
                assert getattr(after, name).start == pytest.approx(one.start, abs=1e-15)
                assert (getattr(later, name).samples == one.samples).all()


@given(st.integers(0, 1000), st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_what_goes_with_the_speed_is_not_random(seed, powers):
    smooth = 1e-6 * np.log(SPEEDS)[:, None] ** np.arange(3) @ np.array(powers)
    errors = np.full(14, 1e-7)
    noise = np.random.default_rng(seed).standard_normal(14)
    assert not _are_random(smooth, errors, SPEEDS)
    assert not _are_random(smooth + 1e-7 * noise, 2 * errors, SPEEDS)
    assert _are_random(5 * np.ptp(smooth) * noise + 1e-5 * noise, errors, SPEEDS)


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
