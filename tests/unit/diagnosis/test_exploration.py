"""Which effects lead, where what is linear at their nulls is right."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from difffric.diagnosis import shape_scan
from difffric.diagnosis.exploration import explore
from difffric.diagnosis.score_test import run_score_tests
from difffric.estimation.ensembles import ensemble, ensemble_refits
from difffric.rig.catalogue import numbers_of
from tests.unit.diagnosis.linear_rig import make_task, start

OTHERS = ("quadratic_drag", "rebound_damping", "pusher_lag", "channel_skew", "initial_gap")
UNSEEN = ("static_dwell", "probe_scale", "contact_hardening", "pusher_speed", "force_gain")
"""Effects that no push shows: all their sizes fit as well as none."""


def test_a_drift_leads_that_leaves_no_scatter_and_larger_squares():
    """Scatter takes a drift in, and leaves smaller squares than it: what scatter costs tells."""
    n, rng = 100, np.random.default_rng(1)  # of which squares are larger with the drift
    effects = ("friction_drift", *OTHERS, *UNSEEN)
    names = tuple(name for effect in effects for name in numbers_of(effect))
    share = np.linspace(0, 1, n)
    slopes = 1e4 * rng.standard_normal((n, 2, 1 + len(names)))
    slopes[:, :, 0] = [[100.0, 300.0]]
    slopes[:, :, -len(UNSEEN) :] = 0.0
    slopes[:, :, 1] = slopes[:, :, 0] * share[:, None]
    measured = slopes[:, :, 0] * 0.03 * share[:, None] + rng.standard_normal((n, 2))
    task = make_task(slopes, measured, names)
    base = ensemble_refits.refit(task, start(task, 0.05), 10)
    scores = run_score_tests(task, base, effects)
    scales = SimpleNamespace(mass=10.0, ways=np.ones(n))
    found = explore(task, base, effects, scales, scores, far=False)  # type: ignore
    assert found[0].effect == "friction_drift"
    assert found[0].p_value < 1e-6


def test_effects_lead_however_many_fits_others_have():
    """Six effects of which each has several fits explain more than the seventh has by its one: it
    is counted among the effects, and comes out behind them."""
    n, rng = 40, np.random.default_rng(2)
    blind = (*UNSEEN, "release_threshold")
    names = tuple(name for effect in (*blind, "tilt") for name in numbers_of(effect))
    measured = 5.0 * rng.standard_normal((n, 2))
    slopes = rng.standard_normal((n, 2, 1 + len(names)))
    slopes[:, :, 0] = 0.0  # mu_s shows in nothing
    slopes[:, :, 1:] += measured[:, :, None]
    slopes[:, :, -1] += 2.0 * rng.standard_normal((n, 2))
    task = make_task(slopes, measured, names)
    base = ensemble_refits.refit(task, start(task, 0.05), 10)
    scores = run_score_tests(task, base, ["tilt"])
    scales: Any = SimpleNamespace(mass=10.0, peak=100.0, ways=np.ones(n))
    found = explore(task, base, (*blind, "tilt"), scales, scores, far=False)
    assert {one.effect for one in found} == {*blind, "tilt"}
    assert found[-1].effect == "tilt"
    for one in found:
        x = slopes[:, :, 1 + names.index(numbers_of(one.effect)[0])].ravel()
        assert one.drop == pytest.approx((x @ measured.ravel()) ** 2 / (x @ x), rel=1e-3)


def test_a_table_is_looked_through_from_every_size_and_all_that_is_free_follows():
    """Where pushes' own mu_s have taken a strong effect in, and starts at all sizes are far from
    it, the effect leads, at its size, and leaves the pushes hardly any scatter."""
    n, rng = 30, np.random.default_rng(5)
    effects = ("force_gain", "probe_scale", "pusher_speed")
    names = ("k", *(name for effect in effects for name in numbers_of(effect)))
    slopes = 300.0 * rng.standard_normal((n, 2, 1 + len(names)))
    slopes[:, :, 0] = rng.uniform(500.0, 2000.0, (n, 2))
    measured = slopes @ [0.0, 0.1, 0.3, 0.0, 0.0] + rng.standard_normal((n, 2))
    task = make_task(slopes, measured, names, shared=(1,))
    base = ensemble_refits.refit(task, start(task, 0.05), 10)
    scales: Any = SimpleNamespace(mass=10.0, ways=np.ones(n))
    found = explore(task, base, effects, scales, {}, far=True)
    assert found[0].effect == "force_gain"
    at = found[0].fits
    assert at.c[0, names.index(numbers_of("force_gain")[0]) + 1] == pytest.approx(0.3, abs=3e-3)
    assert at.scatter[0] < 0.1 * base.scatter[0]


def test_shapes_start_from_the_rest_as_it_was_and_as_it_would_be_beside_them():
    """Where a patch and k answer alike and both explain, what the rest of the model is beside the
    patch is the joint optimum; of a table with a large misfit there are starts of both kinds."""
    n, rng = 20, np.random.default_rng(3)
    names = ("k", *numbers_of("friction_patch"))
    slopes = rng.standard_normal((n, 2, 1 + len(names)))
    patch = 1 + names.index("friction_patch.amplitude")
    place = 1 + names.index("friction_patch.start_m")
    slopes[:, :, 0] = slopes[:, :, place] = 0.0
    slopes[:, :, patch] += slopes[:, :, 1]
    measured = slopes[:, :, 1] + 0.3 * slopes[:, :, patch] + 0.1 * rng.standard_normal((n, 2))
    task: Any = make_task(slopes, measured, names, shared=(1,))
    base = start(task, 0.3)
    scales: Any = SimpleNamespace(ways=np.linspace(1e-3, 3e-3, n), first_place=1e-5)
    every = np.arange(n)
    optimum = np.linalg.lstsq(slopes[:, :, [1, patch]].reshape(-1, 2), measured.ravel())[0]
    both = shape_scan.scan_shapes(task, base, "friction_patch", scales, every, far=True)
    near = shape_scan.scan_shapes(task, base, "friction_patch", scales, every, far=False)
    m = near.m
    assert both.m == 2 * m
    np.testing.assert_array_equal(both.c[:m, 1], base.c[0, 1])
    for beside in (near.c, both.c[m:]):
        np.testing.assert_allclose(beside[:, [1, patch]], np.tile(optimum, (m, 1)), rtol=1e-6)
    task.model.recordings = True
    of_recordings = shape_scan.scan_shapes(task, base, "friction_patch", scales, every, far=True)
    np.testing.assert_array_equal(of_recordings.c[:, 1], base.c[0, 1])


@pytest.mark.parametrize("k", [-1.0, -0.2, 0.5])
def test_a_shape_explains_what_it_adds_to_a_fit_within_bounds(k):
    n, rng = 20, np.random.default_rng(4)
    slopes = rng.standard_normal((n, 2, 3))
    slopes[:, :, 0] = 0.0  # mu_s shows in nothing
    slopes[:, :, 2] += 0.7 * slopes[:, :, 1]
    measured = slopes @ [0.0, k, 0.4] + 0.1 * rng.standard_normal((n, 2))
    task: Any = make_task(slopes, measured, ("k", "patch"), shared=(1,))
    at = replace(start(task, 0.3), extra=((2,),))
    coordinates = task.model.coordinates
    coordinates.bounds = lambda name: (0.0 if name == "k" else -np.inf, np.inf)
    model: Any = SimpleNamespace(
        coordinates=coordinates, answers=task.model.answers, directions=8, recordings=False
    )
    task = replace(task, model=model)
    drop, step = shape_scan._predict_step(task, ensemble.evaluate(task, at), 1)
    A, b, low = slopes.reshape(-1, 3), measured.ravel(), [0.0, -np.inf]
    both, alone = lsq_linear(A[:, 1:], b, (low, np.inf)), lsq_linear(A[:, 1:2], b, (0.0, np.inf))
    assert drop[0] == pytest.approx(2 * (alone.cost - both.cost), rel=1e-6)
    assert step[0, 0] == pytest.approx(both.x[1], rel=1e-6)
