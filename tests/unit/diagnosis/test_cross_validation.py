"""Which pushes are held out together."""

import numpy as np

from difffric.diagnosis.cross_validation import assign_folds


def test_pushes_of_one_speed_are_held_out_together_or_each_alone():
    velocity = np.array([0.05, 0.01, 0.05, 0.02])
    assert assign_folds(velocity, by_speed=True).tolist() == [2, 0, 2, 1]
    assert assign_folds(velocity, by_speed=False).tolist() == [0, 1, 2, 3]


def test_many_pushes_make_twenty_folds():
    folds = assign_folds(np.linspace(0.01, 0.1, 50), by_speed=False)
    assert set(folds.tolist()) == set(range(20))
    assert np.bincount(folds).max() == 3
