"""When a curve of no particular form stands for causes of the catalogue."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from difffric.diagnosis import location
from difffric.diagnosis.background.curve_comparison import CurveComparison, limit_curves
from difffric.diagnosis.location import choose_form, locate_first_among
from difffric.rig.free_form import FORMS


def compare(causes, alone, both, count=1, share=0.0) -> CurveComparison:
    """One form against some causes; log probabilities."""
    return CurveComparison(causes, {"spring": alone}, {"spring": both}, count=count, share=share)


@pytest.mark.parametrize(
    ("causes", "alone", "both"),
    [(0.0, 2.0, 2.0), (100.0, 100.0, 100.0), (100.0, 60.0, 140.0), (100.0, 110.0, 190.0)],
)
def test_causes_stand_where_no_curve_does_without_them(causes, alone, both):
    assert not compare(causes, alone, both).is_outside


@pytest.mark.parametrize(
    ("causes", "alone", "both"),
    [(0.0, 50.0, 50.0), (-5.0, 50.0, 45.0), (100.0, 110.0, 110.0), (287.0, 450.0, 457.0)],
)
def test_a_curve_stands_for_causes_that_add_little_to_it(causes, alone, both):
    assert compare(causes, alone, both).is_outside


def test_many_causes_imitate_what_a_curve_does():
    assert compare(100.0, 60.0, 140.0, count=3).is_outside
    assert not compare(100.0, 40.0, 140.0, count=3).is_outside


def test_beside_a_background_causes_that_add_much_to_a_curve_stand():
    # A small shape at a wrong place asks for a curve beside true causes, too.
    assert not compare(100.0, 60.0, 140.0, count=3, share=0.2).is_outside
    assert compare(100.0, 60.0, 110.0, count=3, share=0.2).is_outside


def test_where_far_more_than_noise_is_left_causes_that_add_to_a_curve_do_not_stand():
    # A friction that goes up and down with the speed, told as a patch and a waviness: 46 times the
    # noise was left of held-out pushes.
    far = CurveComparison(213.7, {"friction_speed": 615.4}, {"friction_speed": 817.6}, 2, left=228)
    assert far.is_outside and not replace(far, left=3.0).is_outside
    assert not replace(far, curves={"friction_speed": 210.0}).is_outside


def test_no_rig_has_five_causes_and_nothing_small_besides():
    assert compare(100.0, 0.0, 100.0, count=5).is_outside
    assert not compare(100.0, 0.0, 100.0, count=5, share=0.2).is_outside


@pytest.mark.parametrize(("adds", "outside"), [(-8.0, False), (500.0, True)])
def test_a_curve_alone_explains_no_more_than_beside_the_causes(adds, outside):
    # A patch at 68 times the noise: 6.6e7 by linear answers, 3.87e7 by its fit, which leaves noise.
    causes, alone = 3.87e7, {"spring": 4.97e7}
    both = {"spring": causes + adds}
    assert compare(causes, alone["spring"], both["spring"]).is_outside
    limited = CurveComparison(causes, limit_curves(alone, both), both, count=1)
    assert limited.is_outside == outside


def test_curves_are_fitted_where_one_explains_more_than_the_causes_by_itself_or_beside_them():
    assert compare(100.0, 60.0, 110.0).may_be_needed
    assert compare(100.0, 110.0, 90.0).may_be_needed
    assert not compare(100.0, 99.0, 102.0).may_be_needed
    assert not CurveComparison(-5.0, {"spring": -4.0}, {}).may_be_needed


def test_the_form_that_explains_most_by_itself_or_beside_the_causes_comes_first():
    alone = {"spring": 1.0, "travel": 3.0, "force": 2.0}
    assert CurveComparison(0.0, alone, {}).rank_forms() == ["travel", "force", "spring"]
    both = {"spring": 9.0, "travel": 3.0, "force": 4.0}
    assert CurveComparison(3.0, alone, both).rank_forms() == ["spring", "force", "travel"]


def test_a_form_that_may_imitate_another_is_held_against_the_next():
    """A loss follows a little of whatever changes fast, and is told where it explains most."""
    assert FORMS["loss"].least > 0 and not FORMS["travel"].least
    assert CurveComparison(0.0, {"spring": 1.0, "travel": 3.0}, {}).leading == ("travel",)
    leading = CurveComparison(0.0, {"spring": 1.0, "loss": 3.0, "travel": 2.0}, {}).leading
    assert leading == ("loss", "travel")


@pytest.mark.parametrize(
    ("shares", "told"),
    [((0.9, 0.85), "loss"), ((0.5, 0.45), "spring")],
)
def test_a_loss_that_leaves_much_gives_way_to_another_form(shares, told):
    names, worths = ["loss", "spring"], 1000 * np.array(shares)
    assert names[choose_form(names, np.array(shares), worths)] == told


def test_a_loss_that_leaves_much_is_told_where_it_is_all_there_is():
    assert choose_form(["loss"], np.array([0.3]), np.array([300.0])) == 0


@pytest.mark.parametrize(("share", "told"), [(0.5, "spring"), (0.999, "travel")])
def test_all_forms_are_looked_at_where_the_leading_one_leaves_far_more_than_noise(
    monkeypatch, share, told
):
    """A spring that softens was located in the pusher, whose curve led by linear answers."""

    def locate(task, plain, scales, excess, among=tuple(FORMS)):
        form = among[0] if len(among) == 1 else "spring"
        return SimpleNamespace(form=form, explained={form: share})

    monkeypatch.setattr(location, "locate", locate)
    task: Any = SimpleNamespace(counts=np.array([[100]]))
    nothing: Any = None
    found = locate_first_among(("travel",), task, nothing, nothing, excess=10_000.0)
    assert found.form == told
