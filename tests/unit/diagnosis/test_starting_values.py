"""Where each effect is looked for: every effect of the catalogue has sizes to start from, and the
tables that decide how it is looked for agree with the catalogue and with each other."""

import numpy as np
import pytest

from difffric.diagnosis.shape_scan import SHAPED
from difffric.diagnosis.starting_values import SMOOTH_AT_NULL, list_starting_values
from difffric.rig.catalogue import CATALOGUE, KEYS, RATIO, numbers_of
from difffric.rig.scales import Scales

SCALES = Scales(
    mass=19.0,
    mu_s=0.14,
    fastest=0.1,
    slowest=0.01,
    peak=60.0,
    reach=6e-3,
    travel=5e-3,
    compression=1e-4,
    ways=np.array([5e-3, 6e-3]),
    tips=np.array([5e-3, 5e-3]),
)


@pytest.mark.parametrize("effect", [*CATALOGUE, RATIO])
def test_an_effect_starts_from_values_of_all_its_numbers_off_its_null(effect):
    starts = list_starting_values(effect, SCALES)
    assert starts and all(tuple(one) == numbers_of(effect) for one in starts)
    assert all(np.isfinite(list(one.values())).all() for one in starts)
    if effect != RATIO:
        assert all(any(x != KEYS[name][1].null for name, x in one.items()) for one in starts)


@pytest.mark.parametrize("effect", ["pusher_duration", "release_latch"])
def test_sizes_with_an_edge_in_each_push_are_close_together_where_asked(effect):
    coarse, close = (
        np.sort([x for one in list_starting_values(effect, SCALES, closely) for x in one.values()])
        for closely in (False, True)
    )
    assert np.allclose(close[[0, -1]], coarse[[0, -1]])
    assert np.diff(np.log(close)).max() < 0.5 * np.diff(np.log(coarse)).max()


def test_the_tables_name_effects_of_the_catalogue_and_none_twice():
    assert set(CATALOGUE) | {RATIO} >= SMOOTH_AT_NULL | set(SHAPED)
    assert not SMOOTH_AT_NULL & set(SHAPED)
    for effect, keys in SHAPED.items():
        assert {f"{effect}.{key}" for key in keys if key} <= set(numbers_of(effect))
