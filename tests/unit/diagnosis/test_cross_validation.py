"""Which pushes are held out together, and what is predicted of them."""

from types import SimpleNamespace

import numpy as np

from difffric.diagnosis import cross_validation
from difffric.diagnosis.cross_validation import CrossValidation, assign_folds
from difffric.estimation.ensemble import Fits


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

    monkeypatch.setattr(cross_validation.ensemble_refits, "predict_held_out", predict)
    one, own, gram = np.ones((1, 2)), np.zeros((1, 3)), np.zeros((1, 3, 2, 2, 2))
    fits = [Fits(((),), np.full((1, 4), x), own, own, np.ones(1), one, gram) for x in (1.0, 2.0)]
    validation = CrossValidation(None, np.arange(3))  # type: ignore[arg-type]
    told = [validation.measure_surprise(x) for x in (*fits, *fits)]
    assert told == [1.0, 2.0, 1.0, 2.0] and len(asked) == 2
    assert not validation.is_better(fits[1], fits[0]) and len(asked) == 2
