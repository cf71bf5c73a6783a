"""Two calibrations that several tests of error bars share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import difffric as df
from tests.reference import data as reference
from tests.unit.calibration.designs import TRUTH, calibrate, make_setup


@pytest.fixture(scope="session")
def exact():
    """Nearly exact data of one mu_s: the model is linear over the error bars."""
    truth, rng = replace(TRUTH, scatter=0.0), np.random.default_rng(3)
    pushes = reference.make_pushes(truth, rng)
    columns = reference.measure(pushes, rng, force_se=2e-3, distance_se=2e-9)
    known = make_setup(truth, 0.0)
    return known, df.Pushes(**columns), calibrate(known, df.Pushes(**columns))


@pytest.fixture(scope="session")
def coarse():
    """Noisy data with a scatter of 1.6 %."""
    rng = np.random.default_rng(5)
    pushes = reference.make_pushes(TRUTH, rng, 14)
    columns = reference.measure(pushes, rng, force_se=2.0, distance_se=1e-6)
    known = make_setup(TRUTH, TRUTH.scatter)
    return known, df.Pushes(**columns), calibrate(known, df.Pushes(**columns))
