"""The table of parameters: a row each, and a rig's numbers read and put back by name."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import difffric as df
from difffric.errors import InputError
from difffric.estimation import coordinates
from difffric.rig import catalogue, parameters
from difffric.rig.parameters import PARAMETERS

RIG = df.spring_damper_rig(mass=12.0, mu_s=0.15, k=7e5, b=800.0, k_v=9.0, stroke=1.4e-3)
EVERY = catalogue.extended(catalogue.universal(RIG), {"presliding": {"sigma_0_N_per_m": 1e7}})


def same(one, other) -> bool:
    return jax.tree.structure(one) == jax.tree.structure(other) and all(
        np.array_equal(a, b)
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    )


def test_every_number_of_every_effect_has_a_row():
    assert set(catalogue.KEYS) < set(PARAMETERS)
    assert parameters.names(EVERY) == tuple(PARAMETERS)


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_row_agrees_with_itself(name):
    row = PARAMETERS[name]
    assert row.name == name and row.lower < row.upper
    assert row.step is None or row.step > 0
    # What a file may say, a fit may reach.
    inside = [x for x in (row.lower, row.upper) if np.isfinite(x)]
    typical = row.key.typical if row.key else 1.0
    assert all(row.lower <= x <= row.upper for x in [*inside, typical])
    value = row.to_law(row.to_law(0.25))
    assert value == 0.25


@pytest.mark.parametrize("name", [*PARAMETERS, coordinates.START])
def test_a_coordinate_leads_back_to_its_value(name):
    value = 0.7 * (coordinates.linear_step(name) or 1.0)
    c = coordinates.to_coordinate(name, value)
    assert coordinates.to_value(name, c) == pytest.approx(value, rel=1e-14)
    h = 1e-6
    slope = (coordinates.to_value(name, c + h) - coordinates.to_value(name, c - h)) / (2 * h)
    assert coordinates.slope(name, value) == pytest.approx(float(slope), rel=1e-6)
    assert coordinates.shift_value(name, value, h) == pytest.approx(
        float(coordinates.to_value(name, c + h)), rel=1e-14
    )


def test_an_unpacked_rig_is_packed_again():
    values, pack = parameters.unpack(EVERY)
    assert tuple(values) == parameters.names(EVERY)
    assert same(pack({}), EVERY)
    other = pack({"mu_s": 0.2, "tilt.alpha_rad": 0.01})
    assert same(other, parameters.with_values(EVERY, {"mu_s": 0.2, "tilt.alpha_rad": 0.01}))
    assert parameters.values(other)["mu_s"] == 0.2


def test_a_setter_sets_the_same_names_again_and_again():
    put = parameters.setter(RIG, ("mu_s", "mass_kg"))
    assert same(put(0.2, 3.0), parameters.with_values(RIG, {"mass_kg": 3.0, "mu_s": 0.2}))
    with pytest.raises(InputError, match="no such parameter: tilt"):
        parameters.setter(RIG, ("tilt.alpha_rad",))


def test_what_is_not_given_stays():
    assert same(parameters.override(RIG, {"mu_s": None}), RIG)
    other = parameters.override(RIG, {"mu_s": 0.3, "mass_kg": None}, 2e-3)
    assert (other.friction.mu_s, other.mass, other.pusher.stroke) == (0.3, 12.0, 2e-3)


def test_a_push_says_its_numbers_and_its_stroke():
    """A law that holds the inverse takes it as it is: its null is a number."""
    numbers = {"mu_s": 0.2, "pusher_ramp.acceleration_m_per_s2": 0.5, "friction_drift.share": 0.1}
    rig = parameters.with_push(EVERY, numbers, 2e-3)
    assert parameters.values(rig)["pusher_ramp.acceleration_m_per_s2"] == 2.0
    expected = parameters.with_values(
        EVERY,
        {"mu_s": 0.2, "pusher_ramp.acceleration_m_per_s2": 2.0, "friction_drift.share": 0.1},
    )
    assert same(rig, parameters.with_stroke(expected, 2e-3))
