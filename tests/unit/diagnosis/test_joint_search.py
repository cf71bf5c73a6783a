"""How the joint fit is searched, where all answers are linear: what the data do not tell goes to
its null, and a cause that was moved far stands only where it is the more probable."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from difffric.diagnosis.background import joint_search
from difffric.diagnosis.background import search as background_search
from difffric.diagnosis.background.cause_sets import find_set
from difffric.diagnosis.background.joint_fit import WIDE, measure_left
from difffric.diagnosis.background.joint_search import JointSearch
from difffric.diagnosis.background.placement import hold_at_null
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.diagnosis.data import move_unseen
from difffric.estimation.ensembles import ensemble, ensemble_refits
from tests.unit.diagnosis.linear_rig import make_task, start

N, EFFECTS = 12, ("tilt", "force_gain", "static_dwell")
TILT, GAIN, DWELL = 2, 3, 4
WAYS = ("add", "place", "move", "drop", "begin", "enlarge", "replace", "rescan")
"""What the names of the joint search's changes begin with."""


def make_joint(
    seed: int, tilt: float, gain: float, unseen: float, told: float = 30.0
) -> JointSearch:
    """The joint fit of a rig with a tilt and a gain, and a dwell that no number shows and that
    stands somewhere; `told` is how much a tilt of 1 changes, in units of the noise."""
    rng = np.random.default_rng(seed)
    slopes = 30 * rng.normal(size=(N, 2, 5))
    slopes[:, :, DWELL] = 0.0
    slopes[:, :, TILT] *= told / 30
    measured = tilt * slopes[:, :, TILT] + gain * slopes[:, :, GAIN]
    measured = measured + 0.5 * rng.normal(size=(N, 2))
    names = ("k", *(f"{effect}.x" for effect in EFFECTS))
    task = make_task(slopes, measured, names, shared=(1,))
    ones = np.ones(3)
    small = SmallEffects(EFFECTS, (TILT, GAIN, DWELL), 0.1 * ones, ones, np.zeros(5), np.zeros(5))
    plain = ensemble_refits.refit(task, start(task, 0.3), 10)
    at = small.free(plain)
    c = at.c.copy()
    c[0, DWELL] = unseen
    data: Any = SimpleNamespace(task=task)
    joint = ensemble_refits.refit(small.assume(task, WIDE), replace(at, c=c), 10)
    c = joint.c.copy()
    c[0, DWELL] = unseen  # wherever it is, nothing tells
    joint = ensemble.evaluate(small.assume(task, WIDE), replace(joint, c=c, gram=None))
    return JointSearch(data, (), False, small, plain, joint)


@pytest.mark.parametrize("seed", range(3))
def test_what_the_data_do_not_tell_is_brought_to_its_null(seed):
    search = make_joint(seed, tilt=0.005, gain=0.0, unseen=4.0)
    before = measure_left(search.data.task, search.joint)
    assert search.draw_near()
    assert abs(search.joint.c[0, DWELL]) < 1e-3
    assert measure_left(search.data.task, search.joint) * 2 * N < before * 2 * N + 10


@pytest.mark.parametrize("seed", range(3))
def test_what_the_data_tell_stays_where_it_is(seed):
    search = make_joint(seed, tilt=1.5, gain=0.0, unseen=4.0)
    search.draw_near()
    assert search.joint.c[0, TILT] == pytest.approx(1.5, abs=0.05)
    # What they tell less surely would cost the fit too much.
    search = make_joint(seed, tilt=1.5, gain=0.0, unseen=4.0, told=3.0)
    before = search.joint
    assert not search.draw_near() and search.joint is before


def end_with(search: JointSearch, effect: str, c: dict[int, float]):
    """The search as it would be where a fit had moved coordinates to `c` and named an effect."""
    at = search.joint.c.copy()
    at[0, list(c)] = list(c.values())
    joint = replace(search.joint, c=at, gram=None)
    joint = ensemble.evaluate(search.small.assume(search.data.task, WIDE), joint)
    moved = replace(search, joint=joint)
    evidence = moved.weigh()
    one = find_set(evidence, {effect})
    assert one is not None
    return background_search._end(moved, evidence, [one], None)


@pytest.mark.parametrize("seed", range(3))
def test_a_cause_that_was_moved_far_gives_way_to_what_is_more_probable(seed):
    search = make_joint(seed, tilt=0.0, gain=1.5, unseen=0.0)
    evidence = search.weigh()
    first = background_search._end(search, evidence, [find_set(evidence, ())], None)  # type: ignore
    wrong = end_with(search, "tilt", {TILT: 2.0, GAIN: 0.0})
    found = background_search._compare_moved(search, first, wrong)
    assert found.best.effects == {"force_gain"}
    assert found.joint.c[0, GAIN] == pytest.approx(1.5, abs=0.05)
    assert abs(found.joint.c[0, TILT]) < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_a_cause_that_is_right_stands_however_far_it_was_moved(seed):
    search = make_joint(seed, tilt=1.5, gain=0.0, unseen=0.0)
    right = end_with(search, "tilt", {})
    before = end_with(search, "tilt", {TILT: 0.0})
    assert background_search._compare_moved(search, before, right) is right
    assert background_search._compare_moved(search, right, right) is right


@pytest.mark.parametrize("seed", range(3))
def test_a_cause_that_was_held_at_its_null_is_fitted_again(seed):
    search = make_joint(seed, tilt=1.5, gain=0.0, unseen=0.0)
    at = search.joint
    held = search.small.free(replace(at, c=np.zeros_like(at.c)))
    start = search.small.start.copy()
    start[TILT] = 1e-6
    search.small = replace(search.small, start=start)
    search.joint = ensemble.evaluate(search.data.task, hold_at_null(search.small, held))
    assert TILT not in search.joint.extra[0]
    evidence = search.weigh()
    one = find_set(evidence, {"tilt"})
    assert one is not None
    search.free(evidence, one.items, [0.9])  # a size that is not the best: the fit finds that
    assert TILT in search.joint.extra[0]
    assert search.joint.c[0, TILT] == pytest.approx(1.5, abs=0.05)


def test_fits_that_leave_far_more_after_their_first_steps_are_not_followed(monkeypatch):
    def count_followed(tilt, gain):
        search, followed = make_joint(0, tilt, gain, unseen=0.0), []
        keep = joint_search.follow_leaders
        monkeypatch.setattr(
            joint_search, "follow_leaders", lambda *a: followed.append(1) or keep(*a)
        )
        search._begin_with_any(search._forget_small())
        monkeypatch.undo()
        return len(followed)

    assert count_followed(1.5, 0.0) == 1  # one effect leaves noise
    assert count_followed(1.5, 1.5) == 0  # it takes both


@pytest.mark.parametrize(("lost", "turns", "anew"), [(0.01, 3, True), (0.1, 20, False)])
def test_changes_that_hardly_help_far_off_give_way_to_a_new_beginning(
    monkeypatch, lost, turns, anew
):
    """Shapes are placed as long as each leaves far less; three changes that do not are enough."""
    search, called = make_joint(0, 0.0, 0.0, unseen=0.0), []
    left = [100.0]

    def answer(name, helps):
        def change(evidence):
            called.append(name)
            left[0] *= 1 - lost if helps else 1.0
            return helps

        return change

    ways = [name for name in vars(JointSearch) if name.partition("_")[0] in WAYS]
    for name in ways:
        monkeypatch.setattr(search, name, answer(name, name == "place_shapes"))
    monkeypatch.setattr(joint_search, "measure_left", lambda task, at: left[0])
    monkeypatch.setattr(search, "weigh", lambda: SimpleNamespace(excess=left[0]))
    search.arrive()
    assert called.count("place_shapes") == turns
    assert ("begin_with_one" in called) == anew


def test_no_cause_is_held_back_where_two_searches_are_compared():
    """A tilt of 15 times its unit costs 25 of chi-square where it scatters by 3 of them: as a cause
    it costs next to nothing."""
    search = make_joint(0, tilt=1.5, gain=0.0, unseen=0.0)
    tilted = end_with(search, "tilt", {TILT: 1.5})
    none = replace(tilted, sets=(find_set(tilted.evidence, ()),))
    rate = background_search.rate_search
    assert rate(none) - rate(tilted) == pytest.approx(25.0, abs=0.5)


def test_what_cuts_pushes_short_is_never_taken_out_to_place_shapes_anew(monkeypatch):
    search, taken = make_joint(0, tilt=0.0, gain=0.0, unseen=0.0), []

    def take_out(effects):
        taken.extend(effects)
        return search.joint, ()

    monkeypatch.setattr(search, "_take_out", take_out)
    monkeypatch.setattr(search, "_place_beside", lambda *at: None)
    monkeypatch.setattr(search.grid, "weigh", lambda *at: None)
    small = ["pusher_duration", "friction_patch"]
    evidence: Any = SimpleNamespace(list_small_shapes=lambda least: small)
    assert not search.place_shapes_anew(evidence)
    assert taken == ["friction_patch"]


def test_pushes_that_a_fit_did_not_see_move_as_those_did_that_it_saw():
    task = make_task(np.ones((4, 2, 1)), np.zeros((4, 2)), ())
    before = replace(start(task, 0.01), own=np.array([[0.0, 0.1, 0.2, 0.3]]))
    after = replace(before, mu=np.array([[1.0]]), own=np.array([[0.2, 0.3, 0.2, 0.3]]))
    moved = move_unseen(task, after, before, np.array([0, 1]))
    total = (moved.mu + moved.own)[0]
    np.testing.assert_allclose(total, [1.2, 1.3, 0.2 + 1.2, 0.3 + 1.2])
