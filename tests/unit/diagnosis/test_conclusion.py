"""Which effects a cause is confused with, and how probable it is among them."""

import numpy as np
import pytest

from difffric.diagnosis.conclusion import ALIKE, NamedCause
from difffric.diagnosis.exploration import CandidateCause
from difffric.estimation.ensembles.ensemble import Fits

NO_FITS = Fits(((),), *(np.zeros((1, 1)) for _ in range(3)), np.ones(1), np.ones((1, 2)))


def candidate(effect, penalised_drop):
    return CandidateCause(effect, NO_FITS, penalised_drop, 0.0, 1e-6, penalised_drop)


def test_a_cause_is_confused_with_what_explains_nearly_as_much():
    best, near = candidate("tilt", 50.0), candidate("friction_ratio", 50.0 - 0.9 * ALIKE)
    far = candidate("force_gain", 50.0 - 1.1 * ALIKE)
    assert NamedCause(best, (best, near, far), NO_FITS).alike == ("friction_ratio",)


def test_two_that_explain_the_same_are_as_probable_and_odds_are_20_at_the_limit():
    best, same = candidate("tilt", 50.0), candidate("friction_ratio", 50.0)
    assert NamedCause(best, (best,), NO_FITS).probability == pytest.approx(1.0)
    assert NamedCause(best, (best, same), NO_FITS).probability == pytest.approx(0.5)
    limit = candidate("force_gain", 50.0 - ALIKE)
    assert NamedCause(best, (best, limit), NO_FITS).probability == pytest.approx(20 / 21)
