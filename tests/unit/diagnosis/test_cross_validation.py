"""Which pushes are held out together, and what is predicted of them."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from difffric.diagnosis import cross_validation
from difffric.diagnosis.cross_validation import CrossValidation, assign_folds
from difffric.estimation.ensembles import ensemble_refits, held_out
from difffric.estimation.ensembles.ensemble import Fits
from tests.unit.diagnosis.linear_rig import LinearModel, make_task, start


def test_pushes_of_one_speed_are_held_out_together_or_each_alone():
    velocity = np.array([0.05, 0.01, 0.05, 0.02])
    assert assign_folds(velocity, by_speed=True).tolist() == [2, 0, 2, 1]
    assert assign_folds(velocity, by_speed=False).tolist() == [0, 1, 2, 3]


def test_many_pushes_make_twenty_folds():
    folds = assign_folds(np.linspace(0.01, 0.1, 50), by_speed=False)
    assert set(folds.tolist()) == set(range(20))
    assert np.bincount(folds).max() == 3


def test_the_same_fits_are_predicted_from_once(monkeypatch):
    asked = []

    def predict(task, fits, folds):
        asked.append(fits)
        return SimpleNamespace(surprise=np.array([fits.c[0, 0]]))

    monkeypatch.setattr(cross_validation.held_out, "predict_held_out", predict)
    one, own, gram = np.ones((1, 2)), np.zeros((1, 3)), np.zeros((1, 3, 2, 2, 2))
    fits = [Fits(((),), np.full((1, 4), x), own, own, np.ones(1), one, gram) for x in (1.0, 2.0)]
    validation = CrossValidation(None, np.arange(3))  # type: ignore[arg-type]
    told = [validation.measure_surprise(x) for x in (*fits, *fits)]
    assert told == [1.0, 2.0, 1.0, 2.0] and len(asked) == 2
    assert not validation.is_better(fits[1], fits[0]) and len(asked) == 2


def draw_task(rng, scatter, shift=0.0):
    """Ten pushes of two numbers, three shared coordinates behind them, and a shift of every second
    number that none of them explains."""
    slopes = rng.standard_normal((10, 2, 3))
    own = scatter * rng.standard_normal(10)
    noise = rng.standard_normal((10, 2))
    measured = slopes[:, :, 0] * own[:, None] + noise
    measured[::2, 1] += shift
    return make_task(slopes, measured, ("k", "b"), (1, 2))


def test_what_noise_leaves_of_held_out_pushes_is_foreseen():
    folds, found = np.arange(10), []
    for k in range(300):
        task = replace(draw_task(np.random.default_rng([k, 1]), 2.0), estimate_scatter=False)
        at = ensemble_refits.refit(task, start(task, 2.0), 5)
        found.append(held_out.predict_held_out(task, at, folds))
    left = np.array([x.penalised.sum() for x in found])
    expected = np.array([x.expected.sum() for x in found])
    away = (left - expected) / np.sqrt([x.variance.sum() for x in found])
    assert np.mean(left) == pytest.approx(np.mean(expected), rel=0.05)
    assert 24 < np.mean(expected) < 60  # 20 numbers, and the error of the fits to the others
    assert np.std(away) == pytest.approx(1.0, abs=0.35)


def test_a_fit_that_has_not_arrived_is_not_at_the_floor():
    task = draw_task(np.random.default_rng(7), 0.01)
    validation = CrossValidation(task, np.arange(10))
    at = ensemble_refits.refit(task, start(task, 0.01), 5)
    assert validation.is_at_floor(at)
    bent = draw_task(np.random.default_rng(7), 0.01, shift=6.0)
    validation = CrossValidation(bent, np.arange(10))
    at = ensemble_refits.refit(replace(bent, estimate_scatter=False), start(bent, 0.01), 5)
    p_value = validation.measure_floor_p_value(at)
    assert not validation.is_at_floor(at) and p_value is not None and p_value < 1e-6


def test_without_a_known_noise_nothing_is_said_of_the_floor():
    task = replace(draw_task(np.random.default_rng(7), 0.01, 6.0), open_spread=(True, False))
    at = ensemble_refits.refit(task, start(task, 0.01), 5)
    validation = CrossValidation(task, np.arange(10))
    assert validation.measure_floor_p_value(at) is None and validation.is_at_floor(at)


@dataclass
class JumpingModel(LinearModel):
    """The same whose first push jumps by a thousand times its noise where its log mu_s is beyond an
    edge."""

    edge: float = np.inf

    def answers(self, index, c, directions, keep_rows=False):
        """As `ExtendedModel.answers`."""
        beyond = (np.asarray(index) == 0) & (c[:, 0] > self.edge)
        apart = beyond[:, None] * np.array([1050.0, -950.0])  # and no small step back
        here = replace(self, slopes=self.slopes[index], measured=self.measured[index] + apart)
        return LinearModel.answers(here, np.arange(len(c)), c, directions, keep_rows)


def test_a_held_out_push_beside_a_jump_is_looked_for_on_its_other_side():
    rng, folds = np.random.default_rng(3), np.arange(10)
    task = draw_task(rng, 0.01)
    sharp = task.model.slopes.copy()  # type: ignore[attr-defined]
    sharp[:, :, 0] = 1e4  # each push tells its own mu_s to a part in ten thousand
    own = 0.01 * rng.standard_normal(10)
    measured = 1e4 * own[:, None] + rng.standard_normal((10, 2))
    model = JumpingModel(sharp, measured, ("k", "b"), edge=own[0] + 0.001)
    task = replace(task, model=model)
    at = ensemble_refits.refit(task, start(task, 0.01), 5)
    moved = at.own.copy()
    moved[0, 0] += 0.005  # where a fit to the others may have led
    smooth = held_out.predict_held_out(replace(task, model=replace(model, edge=np.inf)), at, folds)
    found = held_out.predict_held_out(task, replace(at, own=moved), folds)
    assert found.squares[0] == pytest.approx(smooth.squares[0], rel=0.02)
