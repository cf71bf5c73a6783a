"""Derivatives from differences are those of the model: exactly where it is linear."""

import numpy as np
import pytest

from difffric.estimation.following.differenced_model import DifferencedModel
from tests.unit.diagnosis.linear_rig import LinearModel

NAMES = ("k", "tilt.x", "force_gain.x")
N = 5


@pytest.mark.parametrize("exponential", [False, True])
def test_differences_are_the_derivatives(exponential):
    rng = np.random.default_rng(0)
    slopes, measured = rng.normal(size=(N, 2, 4)), rng.normal(size=(N, 2))
    model = LinearModel(slopes, measured, NAMES, exponential=exponential)
    index, c = rng.integers(0, N, 7), 0.1 * rng.normal(size=(7, 4))
    directions = rng.normal(size=(7, 3, 4))
    directions[:, 1] = 0.0  # a direction in which nothing moves
    exact = model.answers(index, c, directions, keep_rows=True)
    found = DifferencedModel(model).answers(index, c, directions, keep_rows=True)
    assert found.rows == pytest.approx(exact.rows, abs=1e-3 if exponential else 1e-9)
    assert found.gram == pytest.approx(exact.gram, abs=1e-2 if exponential else 1e-8)
    assert (found.rows[..., 1] == 0).all()
    assert (found.residual == exact.residual).all() and (found.model == exact.model).all()
    assert DifferencedModel(model).names == NAMES
