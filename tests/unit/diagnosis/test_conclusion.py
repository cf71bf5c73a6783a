"""Which effects a cause is confused with, and how probable it is among them."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from difffric.diagnosis import conclusion
from difffric.diagnosis.conclusion import ALIKE, NamedCause
from difffric.diagnosis.exploration import CandidateCause
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import Fits
from tests.unit.diagnosis.linear_rig import make_task, start

NO_FITS = Fits(((),), *(np.zeros((1, 1)) for _ in range(3)), np.ones(1), np.ones((1, 2)))


def candidate(effect, penalised_drop):
    return CandidateCause(effect, NO_FITS, penalised_drop, 0.0, 1e-6, penalised_drop)


def test_a_cause_is_confused_with_what_explains_nearly_as_much():
    best, near = candidate("tilt", 50.0), candidate("friction_ratio", 50.0 - 0.9 * ALIKE)
    far = candidate("force_gain", 50.0 - 1.1 * ALIKE)
    assert NamedCause(best, (best, near, far), NO_FITS).alike == ("friction_ratio",)


def test_two_that_explain_the_same_are_as_probable_and_odds_are_20_at_the_limit():
    """One that stands alone may still be the wrong one, as a search may have missed the right."""
    best, same = candidate("tilt", 50.0), candidate("friction_ratio", 50.0)
    alone = NamedCause(best, (best,), NO_FITS).probability
    assert 0.95 < alone < 0.99
    assert NamedCause(best, (best, same), NO_FITS).probability == pytest.approx(alone / 2)
    limit = candidate("force_gain", 50.0 - ALIKE)
    assert NamedCause(best, (best, limit), NO_FITS).probability == pytest.approx(alone * 20 / 21)


@pytest.mark.parametrize(("left", "told"), [(1.0, False), (1.9, False), (2.5, True)])
def test_what_all_pushes_leave_is_told_where_those_that_are_hardly_foreseen_hide_it(
    monkeypatch, left, told
):
    rng = np.random.default_rng(0)
    task = make_task(rng.normal(size=(400, 2, 2)), np.zeros((400, 2)), ("k",), shared=(1,))
    at = ensemble.evaluate(task, start(task, 0.3))
    at = replace(at, residual=at.residual + rng.normal(size=at.residual.shape))
    size = np.sqrt(left * (task.counts.sum() - 402) / (at.residual**2).sum())
    at = replace(at, residual=size * at.residual)
    validation = SimpleNamespace(measure_floor_p_value=lambda fits: 0.5)
    monkeypatch.setattr(conclusion, "describe_remaining", lambda misfit: "a phase")
    found: Any = SimpleNamespace(data=SimpleNamespace(task=task), validation=validation)
    # A table's pushes each have a mu_s of their own, which may take up half of all numbers.
    remaining = conclusion._tell_remaining(found, at, 1.9, [], arrived=True)
    assert (remaining is not None) == told
    assert remaining is None or remaining.p_value < 1e-3
