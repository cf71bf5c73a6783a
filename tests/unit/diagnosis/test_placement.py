"""Where shapes are placed: where all answers are linear in their sizes, the fit begins at its
end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from difffric.diagnosis.background import placement
from difffric.diagnosis.background.columns.shape_columns import Shape, ShapeColumns
from difffric.diagnosis.background.evidence import Evidence
from difffric.diagnosis.background.joint_fit import WIDE
from difffric.diagnosis.background.shape_pursuit import pursue_shapes
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.estimation.ensembles import ensemble, ensemble_refits
from tests.unit.diagnosis.linear_rig import make_task, start

N, EFFECTS = 12, ("tilt", "force_gain", "probe_scale")
PATCH, SATURATION = "friction_patch.amplitude", "force_saturation.level_N"
NAMES = ("k", *(f"{effect}.x" for effect in EFFECTS), PATCH, "friction_patch.start_m", SATURATION)
SMALL, SIZE, LEVEL = (2, 3, 4), 5, 7
"""The numbers of the coordinates of small effects, of the patch's amplitude, of the level."""


def draw(seed: int, patch: float, level: float):
    """A rig with a patch of this amplitude and a saturation of this level, whose slopes resemble
    those of all other parameters: placed alone, a shape leaves what these have to give back."""
    rng = np.random.default_rng(seed)
    slopes = rng.normal(size=(N, 2, 1 + len(NAMES))) * 30
    slopes[:, :, 0] = 100 + rng.normal(size=(N, 2))
    slopes[:, :, SIZE] += 2 * slopes[:, :, 1] + slopes[:, :, 2]
    slopes[:, :, SIZE + 1] = 0.0  # where it begins is given
    sizes = np.zeros(len(NAMES))
    sizes[[0, 1, SIZE - 1, LEVEL - 1]] = 0.5, 0.1, patch, level
    mu_s = np.exp(0.05 * rng.normal(size=N))
    measured = slopes[:, :, 0] * mu_s[:, None] + slopes[:, :, 1:] @ sizes
    task = make_task(slopes, measured + 0.5 * rng.normal(size=(N, 2)), NAMES, shared=(1,))
    task.model.exponential = True  # type: ignore
    return task, slopes


def weigh(task, slopes, at, placed: tuple[str, ...] = ()) -> Evidence:
    """The comparison where a fit stands; the derivatives of small effects, and the shapes'
    columns."""
    shapes, rows = [], []
    for effect, i in (("friction_patch", SIZE), ("force_saturation", LEVEL)):
        there = effect in placed
        usual = 0.9 if effect == "friction_patch" else 1.0  # a level's size is its shape
        shapes.append(Shape(effect, ({i: 0.0 if there else 1.0},), 1.0, usual, placed=there))
        rows.append(-slopes[:, :, i] * (at.c[0, i] if there else 1.0))
    columns = ShapeColumns(
        tuple(shapes), ((0,), (1,)), np.stack(rows, axis=2), np.full(2, 0.1), np.full(2, 2.0)
    )
    K = 1 + len(NAMES)
    ones = np.ones(len(EFFECTS))
    small = SmallEffects(EFFECTS, SMALL, 0.3 * ones, 5 * ones, np.zeros(K), np.zeros(K))
    return Evidence(task, at, small, columns)


def fit_small(task, small) -> ensemble.Fits:
    """The fit with all small effects and no shape."""
    return ensemble_refits.refit(small.assume(task, WIDE), small.free(start(task, 0.05)), 20)


@settings(deadline=None)
@given(st.integers(0, 10**6), st.floats(0.5, 3.0))
def test_a_fit_with_a_shape_begins_where_it_ends(seed, patch):
    task, slopes = draw(seed, patch, level=0.0)
    small = weigh(task, slopes, ensemble.evaluate(task, start(task, 0.05))).small
    at = fit_small(task, small)
    evidence = weigh(task, slopes, at)
    (item,) = [x for x in evidence.items if x.effect == "friction_patch"]
    wide = small.assume(task, WIDE)
    begun = placement.predict_start(evidence, [item])
    ended = ensemble_refits.refit(wide, replace(begun, gram=None, residual=None), 20)
    alone = placement.place_shapes(task, at, [item], [patch])
    costs = [
        float(ensemble.criterion(wide, ensemble.evaluate(wide, x))[0])
        for x in (begun, ended, alone)
    ]
    assert begun.c[0, SIZE] == pytest.approx(ended.c[0, SIZE], abs=0.05)
    assert begun.extra[0][-2:] == (SIZE, SIZE + 1)
    # What the scatter's estimate is worth is not in the prediction.
    assert costs[0] - costs[1] < 0.02 * (costs[2] - costs[1])


@settings(deadline=None)
@given(st.integers(0, 10**6))
def test_a_shape_that_is_placed_counts_in_the_search_for_the_next(seed):
    """A saturation that is there takes up what it explains: the patch is found, of its size, and
    the saturation is neither proposed again nor moved."""
    task, slopes = draw(seed, patch=1.0, level=2.0)
    small = weigh(task, slopes, ensemble.evaluate(task, start(task, 0.05))).small
    at = fit_small(task, small)
    c = at.c.copy()
    c[0, LEVEL] = 2.0
    at = ensemble.evaluate(
        small.assume(task, WIDE), replace(at, c=c, extra=((*at.extra[0], LEVEL),), gram=None)
    )
    evidence = weigh(task, slopes, at, placed=("force_saturation",))
    assert [item.effect for item in evidence.list_placed()] == ["force_saturation"]
    found = pursue_shapes(evidence, 3)
    assert [item.effect for item in found.items] == ["friction_patch"]
    begun = placement.predict_start(evidence, found.items)
    assert begun.c[0, LEVEL] == 2.0
    assert begun.c[0, SIZE] == pytest.approx(1.0, abs=0.1)


MANY = ("tilt", "force_gain", "force_offset", "probe_scale", "pusher_speed", "pusher_lag", "drag")


@pytest.mark.parametrize("hidden", range(len(MANY)))
def test_fits_begin_with_the_effects_whose_step_promises_most(hidden):
    rng = np.random.default_rng(hidden)
    names = ("k", *(f"{effect}.x" for effect in MANY))
    index = tuple(range(2, 2 + len(MANY)))
    slopes = rng.normal(size=(N, 2, 1 + len(names))) * 30
    measured = slopes[:, :, index[hidden]] + 0.5 * rng.normal(size=(N, 2))
    task = make_task(slopes, measured, names, shared=(1,))
    K, ones = 1 + len(names), np.ones(len(MANY))
    small = SmallEffects(MANY, index, 0.3 * ones, 5 * ones, np.zeros(K), np.zeros(K))
    chosen, starts = placement.begin_with_each(task, start(task, 0.05), small)
    assert chosen[0] == index[hidden] and len(chosen) == len(starts) < len(MANY)
    assert [one.extra for one in starts] == [((i,),) for i in chosen]
    assert all(not one.c[0, index].any() for one in starts)


def test_effects_without_a_derivative_are_held_at_their_nulls_but_for_those_that_are_free():
    task, slopes = draw(0, patch=0.0, level=0.0)
    small = weigh(task, slopes, ensemble.evaluate(task, start(task, 0.05))).small
    held, free = SMALL[:2]
    beside = small.start.copy()
    beside[[held, free]] = 0.1
    small = replace(small, start=beside)
    at = small.free(start(task, 0.05))
    assert (at.c[0, [held, free]] == 0.1).all()
    found = placement.hold_at_null(small, at, (free,))
    assert found.c[0, held] == small.null[held] and found.c[0, free] == 0.1
    assert set(at.extra[0]) - set(found.extra[0]) == {held}
