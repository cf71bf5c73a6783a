"""Why a push has no best mean is told apart: no noise known, or none that counts."""

import numpy as np

from difffric.identification import combination


def test_each_missing_mean_has_its_own_reason():
    regular = [[2.0, 0.0], [0.0, 1.0]]
    unknown = [[np.nan, 0.0], [0.0, 1.0]]
    singular = [[1.0, 1.0], [1.0, 1.0]]
    both = np.ones(3, bool)
    best, apart = combination._weigh_best(np.array([regular, unknown, singular]), both)
    np.testing.assert_allclose(best[0], [1 / 3, 2 / 3])
    assert np.isnan(best[1:]).all()
    told = combination._explain(both, np.array([True, False, False]), best, apart)
    assert told == [
        (combination._NO_RANGE,),
        (combination._NO_NOISE,),
        (combination._NO_OWN_NOISE,),
    ]


def test_one_estimate_alone_needs_no_reason():
    alone = np.zeros(1, bool)
    best, apart = combination._weigh_best(np.full((1, 2, 2), np.nan), alone)
    assert combination._explain(alone, alone, best, apart) == [()]
