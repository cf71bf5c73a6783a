"""How fits of an ensemble move, and when they rest."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from difffric.estimation.ensembles import ensemble, ensemble_refits, friction_scan
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.following.push_answer import AnswerRows
from tests.unit.diagnosis.linear_rig import LinearModel, make_task, start


class _JumpingModel:
    """Two pushes whose residual falls linearly with the second coordinate, and jumps to a high
    level before it is zero: no step beyond the jump is better, however short."""

    coordinates = SimpleNamespace(names=("mu_s", "x"), bounds=lambda name: (-np.inf, np.inf))
    edge = 0.9
    directions = 8

    def __init__(self):
        self.calls = 0

    def answers(self, index, c, directions):
        self.calls += 1
        J = -np.broadcast_to(directions, (len(c), *directions.shape[-2:]))[:, :, 1]
        r = np.where(c[:, 1] < self.edge, 1.0 - c[:, 1], 50.0)
        A = np.concatenate([J, r[:, None]], axis=1)
        gram = np.zeros((len(c), 2, A.shape[1], A.shape[1]))
        gram[:, 0] = A[:, :, None] * A[:, None, :]
        return SimpleNamespace(gram=gram, residual=np.zeros((len(c), 2, 1)), model=None)


def _start(model: _JumpingModel, x: float) -> tuple[EnsembleTask, Fits]:
    task = EnsembleTask(
        model,  # type: ignore[arg-type]
        shared=(1,),
        condition=np.zeros(2, int),
        mu_free=False,
        estimate_scatter=False,
    )
    nothing = np.zeros((1, 2))
    at = Fits(((),), np.array([[0.0, x]]), np.zeros((1, 1)), nothing, np.ones(1), np.ones((1, 2)))
    return task, ensemble.evaluate(task, at)


def test_a_fit_rests_where_the_model_jumps_and_a_step_promises_nothing():
    model = _JumpingModel()
    task, at = _start(model, 0.85)
    model.calls = 0
    fits = ensemble_refits.refit(task, at, 40, tol=0.05)
    assert fits.c[0, 1] == 0.85
    assert model.calls <= 2


def test_a_fit_that_is_promised_more_goes_on_in_shorter_steps():
    model = _JumpingModel()
    task, at = _start(model, 0.0)
    fits = ensemble_refits.refit(task, at, 40, tol=0.05)
    assert 0.5 < fits.c[0, 1] < model.edge


class _Caught(LinearModel):
    """The first push answers by much more, and in another way, where its log mu_s is beyond an
    edge."""

    beyond = (14.0, -2.0)
    """what its two answers have there in addition"""

    def find_edge(self, c):
        """Return the log mu_s (N,) of the edge at coordinates c (N, K)."""
        return np.zeros(len(c))

    def answers(self, index, c, directions, keep_rows=False):
        answer = super().answers(index, c, directions, True)
        far = (np.asarray(index) == 0) & (c[:, 0] > self.find_edge(c))
        rows = answer.rows.copy()
        rows[:, :, 0, -1] += np.where(far[:, None], self.beyond, 0.0)
        return AnswerRows(rows, answer.model).compare(keep_rows)


@pytest.mark.parametrize("seed", range(3))
def test_a_push_in_the_wrong_valley_beside_a_jump_is_taken_to_the_other_one(seed):
    rng = np.random.default_rng(seed)
    slopes = np.full((8, 2, 1), 1000.0)
    measured = rng.normal(size=(8, 2))
    measured[0] -= 2.0  # its own valley is just before the jump
    task = make_task(slopes, measured, ())
    task = replace(task, model=_Caught(slopes, measured, ()))
    at = replace(start(task, 0.01), own=0.004 * (np.arange(8) == 0)[None])
    stuck = ensemble_refits.refit(task, at, 10)
    found = ensemble_refits.refit_past_jumps(task, at, 10)
    assert stuck.own[0, 0] + stuck.mu[0, 0] > 0 > found.own[0, 0] + found.mu[0, 0]
    assert ensemble.sum_squares(task, found)[0] < ensemble.sum_squares(task, stuck)[0] - 100
    again = friction_scan.rescan_outlying_pushes(task, found)
    assert again is found  # where none stands out nothing is touched


class _HardlyCaught(_Caught):
    """The same, with another valley that fits no worse than chance allows."""

    beyond = (2.5, -0.5)


def test_a_push_that_hardly_tells_its_mu_s_is_taken_to_the_better_of_two_valleys():
    slopes = np.full((8, 2, 1), 1000.0)
    measured = np.linspace(-10, 10, 8)[:, None] + [1.0, -1.0]
    measured[0] = -0.5  # just before the jump
    task = make_task(slopes, measured, ())
    task = replace(task, model=_HardlyCaught(slopes, measured, ()))
    at = replace(start(task, 0.01), own=0.0005 * (np.arange(8) == 0)[None])
    stuck = ensemble_refits.refit(task, at, 10)
    assert friction_scan.rescan_outlying_pushes(task, stuck) is stuck
    found = ensemble_refits.refit_past_jumps(task, at, 10)
    assert stuck.own[0, 0] + stuck.mu[0, 0] > 0 > found.own[0, 0] + found.mu[0, 0]
    assert ensemble.sum_squares(task, found)[0] < ensemble.sum_squares(task, stuck)[0] - 3
    assert friction_scan.rescan_loose_pushes(task, found) is found


class _CaughtFarAway(_Caught):
    """Another valley with a worse fit, many standard errors of the push's own mu_s away."""

    beyond = (61.5, 58.5)

    def find_edge(self, c):
        return np.full(len(c), 0.03)


def test_a_push_in_a_far_valley_is_taken_to_the_one_that_costs_less_within_the_scatter():
    slopes = np.full((8, 2, 1), 1000.0)
    measured = np.linspace(-20, 20, 8)[:, None] + [0.3, -0.3]
    measured[0] = 0.2
    task = make_task(slopes, measured, ())
    task = replace(task, model=_CaughtFarAway(slopes, measured, ()))
    at = replace(start(task, 0.03), own=0.06 * (np.arange(8) == 0)[None])
    stuck = ensemble_refits.refit(task, at, 10)
    assert stuck.own[0, 0] > 0.05
    assert friction_scan.rescan_outlying_pushes(task, stuck).own[0, 0] > 0.05
    found = ensemble_refits.refit(task, friction_scan.rescan_costly_pushes(task, stuck), 10)
    assert abs(found.own[0, 0] + found.mu[0, 0]) < 1e-3
    assert friction_scan.rescan_costly_pushes(task, found) is found


class _CaughtLater(_Caught):
    """The same, with an edge that is lower where the other coordinate is large."""

    def find_edge(self, c):
        return np.where(c[:, 1] < 0.4, 0.001, -0.003)


@pytest.mark.parametrize("seed", range(3))
def test_a_push_that_a_jump_keeps_from_following_does_not_stop_a_step(seed):
    rng = np.random.default_rng(seed)
    slopes = np.stack([np.full((8, 2), 1000.0), np.full((8, 2), [0.0, 4.0])], axis=2)
    slopes[0, :, 1] = 0.0  # the first push tells nothing of the coordinate
    measured = rng.normal(size=(8, 2)) + slopes[:, :, 1] * 0.8  # it is 0.8
    measured[0] = -2.0
    task = make_task(slopes, measured, ("x",), shared=(1,))
    plain = ensemble_refits.refit(task, start(task, 0.01), 10)
    jumping = replace(task, model=_CaughtLater(slopes, measured, ("x",)))
    found = ensemble_refits.refit(jumping, start(task, 0.01), 10)
    np.testing.assert_allclose(found.c[0, 1], plain.c[0, 1], atol=0.01)


@pytest.mark.parametrize(
    ("nearest", "rival", "hopeful"),
    [(0.0, np.inf, [True, False]), (1.0, 1.0, [False, False]), (1.0, np.inf, [True, True])],
)
def test_a_fit_has_hope_unless_it_leaves_far_more_than_one_that_leaves_noise(
    nearest, rival, hopeful
):
    task = make_task(np.full((4, 2, 1), 1000.0), np.zeros((4, 2)), ())
    near, far = (replace(start(task, 1e-6), mu=np.array([[x]])) for x in (nearest, 2.0))
    both = ensemble.evaluate(task, ensemble.join(near, far))
    assert ensemble_refits.find_hopeful(task, both, rival).tolist() == hopeful


@pytest.mark.parametrize("seed", range(3))
def test_without_an_effect_a_fit_is_as_if_that_had_never_been_free(seed):
    rng = np.random.default_rng(seed)
    slopes = 100 * rng.normal(size=(8, 2, 4))
    task = make_task(slopes, rng.normal(size=(8, 2)), ("x", "y", "z"), shared=(1,))
    plain = ensemble_refits.refit(task, start(task, 0.01), 10)
    bare = {"gram": None, "residual": None, "damping": None}
    with_both = ensemble_refits.refit(task, replace(plain, extra=((2, 3),), **bare), 10)
    never = ensemble_refits.refit(task, replace(plain, extra=((3,),), **bare), 10)
    found = ensemble_refits.refit_without(task, with_both, plain, [[2]], 10)
    assert found.extra == ((3,),) and found.c[0, 2] == plain.c[0, 2]
    np.testing.assert_allclose(
        *(ensemble.criterion(task, one) for one in (found, never)), rtol=0, atol=0.05
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_that_is_far_worse_without_an_effect_is_not_followed_to_its_end(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    slopes = 100 * rng.normal(size=(8, 2, 4))
    measured = 3 * slopes[:, :, 2] + rng.normal(size=(8, 2))
    task = make_task(slopes, measured, ("x", "y", "z"), shared=(1,))
    task.model.directions = 1  # as of many parameters: one call does not differentiate by all
    plain = ensemble_refits.refit(task, start(task, 0.01), 10)
    bare = {"gram": None, "residual": None, "damping": None}
    whole = ensemble_refits.refit(task, replace(plain, extra=((2, 3),), **bare), 20)
    least = float(ensemble.profile_cost(task, whole)[0])
    asked, answers = [], task.model.answers

    def count(index, c, directions, *more):
        asked.append(len(index) * np.shape(directions)[-2])
        return answers(index, c, directions, *more)

    monkeypatch.setattr(task.model, "answers", count)
    soon = ensemble_refits.refit_without(task, whole, plain, [[2]], 20, 100.0)
    few = sum(asked)
    late = ensemble_refits.refit_without(task, whole, plain, [[2]], 20)
    assert few < sum(asked) - few, "fewer derivatives are asked for"
    assert soon.extra == late.extra == ((3,),) and soon.c[0, 2] == plain.c[0, 2]
    cost = [float(ensemble.profile_cost(task, one)[0]) for one in (soon, late)]
    assert least + 100.0 < cost[1] <= cost[0]
