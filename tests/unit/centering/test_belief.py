"""What is known of mu_s: Bayes' rule on a grid, against Kalman's filter in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from difffric import InputError
from difffric.centering import Belief

shares = np.array([0.025, 0.16, 0.5, 0.84, 0.975])
deviates = np.array([-1.959964, -0.994458, 0.0, 0.994458, 1.959964])
relative = st.floats(0.008, 0.1)


@settings(max_examples=50, deadline=None)
@given(
    mean=st.floats(0.05, 0.4), error=relative, scatter=relative, drift=st.floats(0.0, 0.03),
    seen=st.lists(st.tuples(st.floats(-2.0, 2.0), relative), min_size=1, max_size=5),
)  # fmt: skip
def test_normal_beliefs_are_kalmans(mean, error, scatter, drift, seen):
    belief = Belief.normal(mean, error, scatter, drift)
    m, P = math.log(mean), error**2
    for off, se in seen:
        own = m + off * math.hypot(math.sqrt(P), scatter)
        belief = belief.update_with_value(math.exp(own), se)
        P += drift**2
        K = P / (P + scatter**2 + se**2)
        m, P = m + K * (own - m), (1 - K) * P
    found, spread = belief.mean
    # A grid of steps of 0.26 % rounds what is narrow.
    assert math.log(found) == pytest.approx(m, abs=3e-4)
    assert spread == pytest.approx(math.sqrt(P), rel=0.02)
    ahead = math.sqrt(P + scatter**2 + drift**2)
    np.testing.assert_allclose(
        np.log(belief.quantiles(shares)), m + deviates * ahead, atol=0.02 * ahead + 3e-4
    )


@settings(max_examples=30, deadline=None)
@given(lower=st.floats(0.02, 0.3), width=st.floats(0.05, 0.5))
def test_a_uniform_belief_has_uniform_quantiles(lower, width):
    upper = lower + width
    belief = Belief.uniform(lower, upper, scatter=0.0)
    expected = lower + shares * (upper - lower)
    np.testing.assert_allclose(belief.quantiles(shares), expected, rtol=3e-3)
    assert belief.weight.sum() == pytest.approx(1.0)


def test_what_was_held_impossible_begins_anew_from_the_push():
    belief = Belief.uniform(0.1, 0.12, 0.01).update_with_value(0.4, 0.001)
    assert belief.mean[0] == pytest.approx(0.4, rel=0.01)


def test_an_expected_push_narrows_as_a_push_does():
    belief = Belief.normal(0.141, 0.05, 0.015)
    assert belief.foresee().mean[1] == pytest.approx(
        belief.update_with_value(0.141, 0.0).mean[1], rel=0.03
    )


@pytest.mark.parametrize("bounds", [(0.3, 0.1), (0.0, 0.2), (0.1, 5.0), (0.1, math.nan)])
def test_an_empty_range_is_refused(bounds):
    with pytest.raises(InputError, match=r"range of mu_s: expected 0\.01 <= lower < upper <= 2"):
        Belief.uniform(*bounds, 0.01)


def test_a_normal_likelihood_tells_what_a_normal_push_does():
    belief = Belief.normal(0.141, 0.04, 0.015, 0.002)
    log = np.linspace(math.log(0.05), math.log(0.4), 4000)
    likelihood = np.exp(-0.5 * ((log - math.log(0.15)) / 0.02) ** 2)
    told, seen = (
        belief.update_with_likelihood(log, likelihood),
        belief.update_with_value(0.15, 0.02),
    )
    np.testing.assert_allclose(told.mean, seen.mean, rtol=2e-3)
