"""What is left without an effect that has no derivative at its null is what its null leaves,
however a push jumps beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from difffric.diagnosis.background.columns.known_columns import collect_rows
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.estimation.ensembles import ensemble, ensemble_refits
from tests.unit.diagnosis.linear_rig import LinearModel, make_task, start

N, K, LAG, GAIN = 10, 1, 2, 3
BESIDE = 5e-4


@dataclass
class EdgyModel(LinearModel):
    """One push's derivative by the lag, right beside its null, foretells what never comes."""

    edge: int = 0
    steep: float = 1e6

    def answers(self, index, c, directions, keep_rows=False):
        found = super().answers(index, c, directions, True)
        rows = np.array(found.rows)
        wrong = np.broadcast_to(directions, (len(c), *np.shape(directions)[-2:]))[..., LAG]
        on_edge = (np.asarray(index) == self.edge) & (c[:, LAG] > 0)
        rows[..., :-1] -= self.steep * (on_edge[:, None] * wrong)[:, None, None, :]
        return type(found)(found.gram, found.residual, found.model, rows)


def make_rig(seed: int, steep: float):
    rng = np.random.default_rng(seed)
    slopes = rng.normal(size=(N, 2, 4)) * [30, 30, 2e3, 30]
    measured = 0.5 * rng.normal(size=(N, 2)) + 0.2 * slopes[:, :, GAIN]
    task = make_task(slopes, measured, ("k", "lag.x", "gain.x"), shared=(K,))
    model = EdgyModel(slopes, measured, ("k", "lag.x", "gain.x"), steep=steep)
    beside = np.array([0.0, 0.0, BESIDE, 0.0])
    ones = np.ones(2)
    small = SmallEffects(("lag", "gain"), (LAG, GAIN), ones, ones, np.zeros(4), beside)
    at = small.free(ensemble_refits.refit(task, start(task, 0.3), 5))
    at = ensemble_refits.refit(small.assume(task, 3.0), at, 10)
    c = at.c.copy()
    c[0, LAG] = 0.0
    at = ensemble.evaluate(task, ensemble_refits.replace(at, c=c, gram=None))
    return ensemble_refits.replace(task, model=model), task, at, small


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("steep", [0.0, 1e6])
def test_what_is_left_without_an_effect_is_what_its_null_leaves(seed, steep):
    task, smooth, at, small = make_rig(seed, steep)
    rows, _ = collect_rows(task, at, small, None)
    exact, _ = collect_rows(smooth, at, small, None)
    np.testing.assert_allclose(rows, exact, rtol=1e-6, atol=1e-6 * np.abs(exact).max())


def test_a_push_that_a_fit_leaves_without_friction_has_no_friction_to_change():
    """exp(own) underflows to nothing there: its column was 0 / 0, and ended the comparison."""
    task, _, at, small = make_rig(0, 0.0)
    own = at.own.copy()
    own[0, 3] = -1e4
    rows, friction = collect_rows(task, ensemble_refits.replace(at, own=own), small, None)
    assert np.isfinite(rows).all() and not friction[3].any() and friction[2].any()
