"""Coordinates of an ensemble's fits: between which values they keep a number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import difffric as df
from difffric.estimation.effect_coordinates import Coordinates
from difffric.rig.catalogue import extended

PLACE = "friction_patch.start_m"


def make_coordinates() -> Coordinates:
    rig = df.spring_damper_rig(mass=18.9, mu_s=0.141, k=8.0e5, b=1500.0, k_v=5.0)
    return Coordinates.of(extended(rig, {"friction_patch": {}, "pusher_lag": {}}))


@given(st.floats(1e-6, 1e-2))
def test_no_number_is_lower_than_the_data_let_it_be(lowest):
    free = make_coordinates()
    held = replace(free, lowest=((PLACE, lowest),))
    for coordinates in (held, held.with_forms(), held.without("pusher_lag")):
        c = np.zeros(len(coordinates.names))
        c[coordinates.index(PLACE)], high = coordinates.bounds(PLACE)
        assert coordinates.values(c, [PLACE])[0] == pytest.approx(lowest, rel=1e-9)
        assert high == free.bounds(PLACE)[1]
        others = {name for name in free.names if name in coordinates.names} - {PLACE}
        assert all(coordinates.bounds(name) == free.bounds(name) for name in others)
