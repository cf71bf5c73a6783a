"""Bristles beside small effects: where they are looked for, and that they are found."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from difffric.diagnosis.background import bristles
from difffric.diagnosis.background.joint_search import MOST_EXCESS
from tests.hidden import random_case, with_nuisances
from tests.unit.diagnosis.analysis import Analysis
from tests.unit.diagnosis.linear_rig import make_task, start

WAY = 2e-3


def make_end(place: float, *effects: str, excess: float = 1.0) -> Any:
    """Where a search ended: with a patch from `place` on, and `effects` as its best set."""
    coordinates = SimpleNamespace(values=lambda c, names: np.array([place]))
    task = SimpleNamespace(model=SimpleNamespace(coordinates=coordinates))
    data = SimpleNamespace(task=task, scales=SimpleNamespace(first_place=0.04 * WAY))
    return SimpleNamespace(
        data=data,
        joint=SimpleNamespace(c=np.zeros((1, 1))),
        shaped=("friction_patch",),
        best=SimpleNamespace(effects=frozenset(effects)),
        evidence=SimpleNamespace(excess=excess),
    )


def test_a_patch_from_where_a_push_begins_looks_like_bristles():
    assert bristles.looks_like_bristles(make_end(1e-6, "friction_patch", "tilt"))
    assert not bristles.looks_like_bristles(make_end(0.2 * WAY, "friction_patch"))
    assert not bristles.looks_like_bristles(make_end(1e-6, "tilt"))
    assert bristles.looks_like_bristles(make_end(0.2 * WAY, excess=1.01 * MOST_EXCESS))


def test_the_median_of_the_pushes_goes_into_their_mean():
    rng = np.random.default_rng(0)
    slopes = rng.normal(size=(6, 2, 2))
    task = make_task(slopes, rng.normal(size=(6, 2)), ("k",), shared=())
    at = replace(start(task, 0.3), own=rng.normal(size=(1, 6)))
    some = np.array([0, 2, 3])
    moved = bristles._recentre(at, some)
    total = moved.mu[:, task.condition] + moved.own
    np.testing.assert_allclose(total[:, some], (at.mu[:, task.condition] + at.own)[:, some])
    assert np.median(moved.own[:, some]) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "change"), [(1_300_001, 0.03), (1_400_001, 0.01)])
def test_bristles_are_named_beside_a_background(seed, change, tmp_path):
    """Without bristles in the joint fit they are taken for a patch of 0.9 from the start on, or
    for nothing; and a tilt that is dropped again leaves the mean of mu_s, too."""
    case = random_case(seed, "presliding", change=change)
    case = with_nuisances(case, np.random.default_rng([seed, 5]), share=0.0035)
    one = Analysis(case, tmp_path, 0.005)
    assert [cause.id for cause in one.found.causes] == ["presliding"]
    value, _ = one.found.causes[0].parameters["sigma_0_N_per_m"]
    assert value == pytest.approx(case.effects["presliding"]["sigma_0_N_per_m"], rel=0.05)
    had = np.array([push.mu_s for push in sorted(one.case.pushes, key=lambda push: push.order)])
    assert np.sqrt(np.mean((np.array(one.found.mu_s) / had - 1) ** 2)) < 0.01
