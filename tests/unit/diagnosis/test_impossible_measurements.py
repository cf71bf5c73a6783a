"""Distances that no contact gives: a rebound without loss stays below them."""

import numpy as np
import pytest

import difffric as df
from difffric.diagnosis.impossible_measurements import compute_lossless_bound
from difffric.units import GRAVITY


def test_a_part_thrown_at_twice_the_speed_stops_at_the_bound():
    velocity, mu_k = 0.05, 0.1
    bound = compute_lossless_bound(np.array([velocity]), mu_k)[0]
    assert bound == pytest.approx((2 * velocity) ** 2 / (2 * mu_k * GRAVITY))


@pytest.mark.parametrize("velocity", [0.02, 0.08])
def test_a_contact_without_damping_stays_below_the_bound_and_comes_close(velocity):
    rig = df.spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=0.0)
    push = df.simulate(rig, velocity=velocity)
    bound = compute_lossless_bound(np.array([velocity]), 0.75 * 0.141)[0]
    assert 0.5 * bound < push.sliding_distance < bound
