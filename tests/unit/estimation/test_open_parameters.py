"""Which parameters a covariance leaves open, in groups."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from difffric.estimation.open_parameters import list_undetermined


def groups(found):
    return [set(x["parameters"]) for x in found]


def test_a_viscous_friction_that_may_be_zero_is_determined_where_it_is_bounded():
    names = ("k_v_N_s_per_m", "mu_s")
    quarter = np.array([0.5, 1.0])  # k_v: 5 N s/m, in coordinates
    assert list_undetermined(names, names, np.diag([0.4**2, 0.01**2]), quarter) == []
    (found,) = list_undetermined(names, names, np.diag([0.6**2, 0.01**2]), quarter)
    assert found["parameters"] == ["k_v_N_s_per_m"]
    assert "flat" in found["reason"] and "6 N s/m" in found["reason"]


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000), open_=st.integers(1, 3), order=st.permutations(list(range(5))))
def test_open_directions_are_found_whatever_the_order(seed, open_, order):
    """Flat parameters stay single, one direction's members stand together."""
    rng = np.random.default_rng(seed)
    information = np.diag(rng.uniform(10, 1e4, 5))
    for j in range(open_ - 1):
        information[j, j] = 1e-4
    information[3:, 3:] = 1e4 * np.array([[1.0, -1.0], [-1.0, 1.0 + 1e-12]])
    covariance = np.linalg.inv(information)
    labels = np.array(["k_N_per_m", "b_N_s_per_m", "mass_kg", "mu_s", "mu_k_over_mu_s"])
    order = np.array(order)
    found = list_undetermined(
        labels[order], labels[order], covariance[np.ix_(order, order)], np.ones(5)
    )
    expected = [{x} for x in labels[: open_ - 1]] + [{"mu_s", "mu_k_over_mu_s"}]
    assert sorted(map(sorted, groups(found))) == sorted(map(sorted, expected))
    for entry in found:
        assert ("flat" in entry["reason"]) == (len(entry["parameters"]) == 1)
