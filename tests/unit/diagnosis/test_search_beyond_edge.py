"""The search that is done again where a patch stands where pushes begin."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import difffric as df
from difffric.diagnosis.background import search
from difffric.diagnosis.data import DiagnosisData
from difffric.estimation.effect_coordinates import Coordinates
from difffric.estimation.ensembles.ensemble import EnsembleTask
from difffric.estimation.extended_model import ExtendedModel
from difffric.rig.catalogue import extended
from difffric.rig.scales import Scales

WAY, PATCH, PLACE = 2e-3, "friction_patch", "friction_patch.start_m"


def end_with_patch(place: float) -> Any:
    """Where a search of three pushes ended, with a patch from a place [m] on."""
    rig = extended(df.spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1500, k_v=5), {PATCH: {}})
    coordinates = Coordinates.of(rig)
    model: Any = ExtendedModel(coordinates, rig, pushes=None, kind="recordings")  # type: ignore
    task = EnsembleTask(model, (), np.zeros(3, int), counts=np.full((3, 2), 500))
    ways = np.array([3 * WAY, WAY, 2 * WAY])
    scales = Scales(18.9, 0.141, 0.1, 0.01, 50.0, WAY, WAY, 1e-4, ways, ways)
    c = np.zeros((1, len(coordinates.names)))
    (c[0, coordinates.index(PLACE)],) = coordinates.point({PLACE: place})
    return SimpleNamespace(
        data=DiagnosisData(task, scales, None, (PATCH,), {}, None),  # type: ignore[arg-type]
        joint=SimpleNamespace(c=c),
        shaped=(PATCH,),
        plain=None,
        effects=(PATCH,),
    )


@pytest.mark.parametrize(
    ("place", "prices", "asked", "counts"),
    [
        (1e-6, -5.0, True, True),
        (1e-6, 0.9, True, True),
        (1e-6, 1.1, True, False),
        (0.3 * WAY, -5.0, False, False),
    ],
)
def test_a_search_beyond_the_edge_counts_where_it_explains_as_much(
    monkeypatch, place, prices, asked, counts
):
    before, anew, given = end_with_patch(place), object(), []

    def search_again(data, *_):
        given.append(data)
        return anew

    price = before.data.task.price
    monkeypatch.setattr(search, "search_background", search_again)
    monkeypatch.setattr(search, "rate_search", lambda one: 7.0 + prices * price * (one is anew))
    found = search.search_beyond_edge(before, None)  # type: ignore[arg-type]
    assert (found is anew) == counts and (found is None) != counts
    assert bool(given) == asked
    for data in given:  # no patch is nearer than the first place, and the first search had no limit
        lowest, there = data.task.model.coordinates, before.data.task.model.coordinates
        (c,) = lowest.point({PLACE: data.scales.first_place})
        assert lowest.bounds(PLACE)[0] == pytest.approx(c, rel=1e-12)
        assert there.bounds(PLACE)[0] < c
