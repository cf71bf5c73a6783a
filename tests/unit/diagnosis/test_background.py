"""Causes beside a background of small effects: what the closed form says of sets of causes is what
the dense normal distribution says."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from difffric.diagnosis.background import cause_sets, evidence, naming, small_effects
from difffric.diagnosis.background import search as background_search
from difffric.diagnosis.background.columns.shape_columns import (
    Shape,
    ShapeColumns,
    compute_columns,
    join_columns,
    list_nearby,
)
from difffric.diagnosis.background.evidence import Evidence
from difffric.diagnosis.background.friction_estimate import average_over_sets, estimate_friction
from difffric.diagnosis.background.shape_pursuit import pursue_shapes
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.diagnosis.cross_validation import CrossValidation
from difffric.diagnosis.exploration import CandidateCause
from difffric.diagnosis.inferred.friction import compute_friction_errors, find_friction
from difffric.estimation.ensembles import ensemble, ensemble_refits
from tests.unit.diagnosis.linear_rig import LinearModel, make_task, start

N, EFFECTS = 12, ("tilt", "force_gain", "force_offset", "probe_scale", "initial_gap")
NAMES = tuple(f"{effect}.x" for effect in EFFECTS)


def draw(cause: float, background: float = 0.0, seed: int = 0):
    """A linear rig with one shared parameter, the effects' slopes, and the first effect's size."""
    rng = np.random.default_rng(seed)
    slopes = rng.normal(size=(N, 2, 2 + len(NAMES)))
    sizes = background * rng.normal(size=len(NAMES))
    sizes[0] = cause
    measured = slopes[:, :, 2:] @ sizes + 0.5 * rng.normal(size=(N, 2))
    return make_task(slopes, measured, ("k", *NAMES), shared=(1,)), slopes, measured


def weigh(task, background: bool = True) -> Evidence:
    """The comparison at the joint fit."""
    K = 2 + len(NAMES)
    ones = np.ones(len(NAMES))
    small = SmallEffects(
        EFFECTS, tuple(range(2, K)), 0.3 * ones, 5 * ones, np.zeros(K), np.zeros(K)
    )
    at = ensemble_refits.refit(small.assume(task, 3.0), small.free(start(task, 0.3)), 10)
    return Evidence(task, at, small, None, background)


def compute_cost(slopes, measured, scatter: float, share: float, causes: list[int]) -> float:
    """-2 log likelihood, but for a constant, by the dense covariance of all that was measured; the
    mean mu_s and k are flat, and the causes at their best."""
    V = np.eye(2 * N)
    for i in range(N):
        own = slopes[i, :, 0]
        V[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += scatter**2 * np.outer(own, own)
    A = slopes.reshape(2 * N, -1)
    for k in range(len(NAMES)):
        if k not in causes:
            V += (0.3 * share) ** 2 * np.outer(A[:, 2 + k], A[:, 2 + k])
    W = np.linalg.inv(V)
    X, y = A[:, :2], measured.ravel()
    columns = [0, 1, *(2 + k for k in causes)]
    prior = np.diag([0.0, 0.0, *(10.0**-2 for _ in causes)])  # a cause is of a size one may meet
    H = A[:, columns].T @ W @ A[:, columns] + prior
    h = A[:, columns].T @ W @ y
    left = y @ W @ y - h @ np.linalg.solve(H, h)
    return float(left + np.linalg.slogdet(V)[1] + np.linalg.slogdet(X.T @ W @ X)[1])


@pytest.mark.parametrize("causes", [[0], [3], [0, 2], [1, 2, 4]])
def test_sets_compare_as_the_dense_normal_distribution_says(causes):
    task, slopes, measured = draw(cause=1.0, background=0.1)
    found = weigh(task)
    assert found.excess == 1.0
    scatter = found.at.scatter[0] * evidence._SCATTERS
    shares, prior = np.append(0.0, evidence.SHARES), evidence._make_prior(True)

    def average(causes: list[int]) -> float:
        terms = [
            p - 0.5 * compute_cost(slopes, measured, s, share, causes)
            for s in scatter
            for share, p in zip(shares, prior, strict=True)
        ]
        return float(np.logaddexp.reduce(terms))

    assert found.compare([causes]).gain[0] == pytest.approx(average(causes) - average([]), abs=1e-5)


def test_a_cause_stands_out_and_is_alone_in_the_best_set():
    found = weigh(draw(cause=3.0, background=0.03)[0])
    best = cause_sets.search_sets(found, found.items)[0]
    assert best.effects == {"tilt"}
    assert found.compute_log_p_values(best.items, 0.0)[0] < np.log(1e-5)
    kept, p_values = naming.keep_significant(found, best, 1e-3)
    assert kept == best.items and p_values[0] < 1e-3


def test_a_cause_by_itself_is_judged_by_its_fit_where_linear_answers_do_not_see_it():
    task, _, _ = draw(cause=3.0)
    plain = ensemble_refits.refit(task, start(task, 0.3), 10)
    freed = replace(plain, extra=((2,),), gram=None, residual=None, damping=None)
    fitted = ensemble_refits.refit(task, freed, 10)
    blind = weigh(draw(cause=0.0)[0])
    best = cause_sets.CauseSet(tuple(blind.items[:1]), 0.0, (0.0,))
    search: Any = SimpleNamespace(evidence=blind, best=best, plain=plain, fitted=fitted)
    assert naming.keep_significant(blind, best, 1e-3) == ((), [])
    kept, (p_value,) = naming.choose_significant(task, search, 1e-3)
    assert kept == best.items and p_value < 1e-5
    search.fitted = plain  # which explains no more
    assert naming.choose_significant(task, search, 1e-3) == ((), [])


@pytest.mark.parametrize("seed", range(5))
def test_a_background_alone_has_no_cause(seed):
    found = weigh(draw(cause=0.0, background=0.15, seed=seed)[0])
    usual = found.compute_log_p_values(found.items[:1], least_share=0.7)
    assert usual[0] > np.log(1e-3)
    # A wider background never makes a cause surer.
    least = found.compute_log_p_values(found.items[:1], least_share=0.0)
    assert usual[0] >= least[0] - 1e-9
    assert least[0] >= found.compute_log_p_values(found.items[:1])[0] - 1e-9


class _JumpingRig(LinearModel):
    """The d of the first push jumps by a hundred times where the tilt is more than a little."""

    edge = 0.05

    def answers(self, index, c, directions, keep_rows=False):
        found = super().answers(index, c, directions, keep_rows)
        jumps = (np.asarray(index) == 0) & (c[:, 1] > self.edge)
        model = np.array(found.model)
        model[jumps, 1] *= 100.0
        return SimpleNamespace(model=model, residual=found.residual)


def test_a_push_on_an_edge_does_not_say_how_large_a_unit_is():
    rng = np.random.default_rng(0)
    slopes = np.concatenate(
        [np.ones((N, 2, 1)), rng.uniform(0.5, 1.5, size=(N, 2, 1)), np.zeros((N, 2, 1))], axis=2
    )
    names = ("tilt.alpha_rad", "force_gain.factor")
    units = []
    for model in (LinearModel, _JumpingRig):
        task = make_task(slopes, np.ones((N, 2)), names)
        task = replace(task, model=model(slopes, np.ones((N, 2)), names, exponential=True))
        at = start(task, 0.05)
        small = small_effects.choose_small_effects(task, at, ("tilt", "force_gain"))
        units.append(small.unit)
    assert units[1] == pytest.approx(units[0], rel=1e-9)
    assert units[0][0] == pytest.approx(
        small_effects.UNIT_CHANGE / np.sqrt((slopes[:, :, 1] ** 2).mean(axis=0)).max(), rel=1e-9
    )


class _SquareRig(LinearModel):
    """The last coordinate changes F_p and d by its square, as a low-pass does a smooth peak."""

    def answers(self, index, c, directions, keep_rows=False):
        found = super().answers(index, c, directions, keep_rows)
        return found._replace(model=found.model * (1 + 0.02 * c[:, -1:] ** 2))


def test_what_grows_by_its_square_matters_from_a_finite_size_on():
    slopes = np.ones((N, 2, 2)) * [1.0, 0.0]
    names = ("force_lowpass.tau_s",)
    task = make_task(slopes, np.ones((N, 2)), names)
    task = replace(task, model=_SquareRig(slopes, np.ones((N, 2)), names, exponential=True))
    small = small_effects.choose_small_effects(task, start(task, 0.05), ("force_lowpass",))
    assert small.usual == pytest.approx([np.sqrt(small_effects.UNIT_CHANGE / 0.02)], rel=1e-6)


def make_shapes(seed: int, number: int) -> ShapeColumns:
    """Columns of waves and patches at random, each the change of the residuals by amplitude 1."""
    rng = np.random.default_rng(seed)
    effects = ["friction_patch", "friction_waviness"] * (number // 2)
    shapes = tuple(
        Shape(effect, ({0: 1.0},), 0.02, 0.05, along=0, near=(0.5, 1.5)) for effect in effects
    )
    typical = np.full(number, 0.05)
    rows = rng.normal(size=(N, 2, number)) * 40
    return ShapeColumns(
        shapes, tuple((k,) for k in range(number)), rows, 0.01 + 0 * typical, typical
    )


def weigh_shapes(shapes: ShapeColumns, sizes: dict[int, float], seed: int) -> Evidence:
    """The comparison where small effects are fitted, of data with shapes of some sizes, by their
    numbers."""
    task, slopes, measured = draw(cause=0.0, background=0.05, seed=seed)
    measured = measured - sum(a * shapes.rows[:, :, k] for k, a in sizes.items())
    task = make_task(slopes, measured, ("k", *NAMES), shared=(1,))
    K, ones = 2 + len(NAMES), np.ones(len(NAMES))
    small = SmallEffects(
        EFFECTS, tuple(range(2, K)), 0.3 * ones, 5 * ones, np.zeros(K), np.zeros(K)
    )
    at = ensemble.evaluate(task, small.free(start(task, 0.3)))
    return Evidence(task, at, small, shapes)


@given(st.integers(0, 10**6), st.sampled_from([0, 2, 4]), st.sampled_from([1, 3, 5]))
def test_shapes_are_found_beside_small_effects(seed, patch, wave):
    """One of each effect is found, of its true size, and none that is not there."""
    sizes = {patch: 0.5, wave: -0.3}
    found = pursue_shapes(weigh_shapes(make_shapes(seed, 6), sizes, seed), 3)
    chosen = [item.columns[0] - len(NAMES) for item in found.items]
    assert set(chosen) == {patch, wave}
    assert found.sizes == pytest.approx([sizes[k] for k in chosen], abs=0.1)


@given(st.integers(0, 10**6))
def test_two_shapes_are_found_together_that_look_like_a_third_one(seed):
    """One of the first effect does nearly what two do together, of which one is its like."""
    shapes = make_shapes(seed, 6)
    rows = shapes.rows.copy()
    rows[:, :, 2] = rows[:, :, 0] + rows[:, :, 1] + 0.3 * rows[:, :, 2]
    evidence = weigh_shapes(replace(shapes, rows=rows), {0: 0.5, 1: 0.5}, seed)
    first, both = (
        {item.columns[0] - len(NAMES) for item in pursue_shapes(evidence, most).items}
        for most in (1, 2)
    )
    assert first == {2} and both == {0, 1}


def test_nearby_shapes_lie_between_the_neighbours_on_the_grid():
    one = make_shapes(0, 2).shapes[0]
    near = list_nearby([one])
    at = [shape.points[0][0] for shape in near]
    assert min(at) == 0.5 and max(at) == 1.5 and 1.0 in at
    assert list_nearby([replace(one, along=None)])[0].points == one.points


def test_what_adds_a_force_explains_as_much_wherever_the_joint_fit_stands():
    """mu_i N + F is the same for all pushes whatever F is: where F is less, mu_s is larger, and its
    relative scatter smaller. No fit gains by that, and no comparison may say so."""
    rng = np.random.default_rng(3)
    mu_s = np.exp(0.05 * rng.normal(size=N))
    slopes = np.ones((N, 2, 2)) * 1e3
    measured = slopes[:, :, 0] * mu_s[:, None] + rng.normal(size=(N, 2))
    task = make_task(slopes, measured, ("tilt.x",))
    task.model.exponential = True  # type: ignore
    small = SmallEffects(("tilt",), (1,), np.ones(1), np.ones(1), np.zeros(2), np.zeros(2))

    def gain(force: float) -> float:
        log = np.log(mu_s - force)
        at = start(task, float(np.std(log)))
        c, mu = np.array([[0.0, force]]), np.array([[log.mean()]])
        at = replace(at, c=c, mu=mu, own=(log - log.mean())[None], extra=((1,),))
        return float(Evidence(task, at, small, None, False).compare([[0]]).gain[0])

    assert gain(-0.8) == pytest.approx(gain(0.0), abs=0.5)


def test_errors_of_mu_s_are_those_of_the_dense_normal_distribution():
    task = draw(cause=1.0)[0]
    slopes = task.model.slopes
    scatter = 0.3
    small = SmallEffects(
        EFFECTS, tuple(range(2, 7)), np.full(5, 0.3), np.full(5, 5.0), np.zeros(7), np.zeros(7)
    )
    task = replace(small.assume(task, 1.0), estimate_scatter=False)
    at = ensemble_refits.refit(task, small.free(start(task, scatter)), 10)
    # All of them, and each push's own log mu_s, in one information matrix.
    J = np.zeros((2 * N, 7 + N))
    J[:, :7] = slopes.reshape(2 * N, 7)
    for i in range(N):
        J[2 * i : 2 * i + 2, 7 + i] = slopes[i, :, 0]
    prior = np.diag([0.0, 0.0, *[0.3**-2.0] * 5, *[scatter**-2.0] * N])
    C = np.linalg.inv(J.T @ J + prior)
    sums = np.zeros((N, 7 + N))
    sums[:, 0] = 1.0
    sums[np.arange(N), 7 + np.arange(N)] = 1.0
    squares = float((at.gram[0, ..., -1, -1]).sum())
    larger = max(squares / (2 * N - 7 - N), 1.0)
    errors = np.sqrt(np.diag(sums @ C @ sums.T) * larger)
    assert compute_friction_errors(task, at) == pytest.approx(errors, rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_what_cannot_be_told_from_mu_s_has_a_large_error_and_no_negative_variance(seed):
    """Rounding makes information matrices of such data indefinite."""
    task, slopes, measured = draw(cause=0.0, seed=seed)
    rng = np.random.default_rng(seed)
    slopes = slopes * 1e4
    for k in (2, 3, 4):
        slopes[:, :, k] = slopes[:, :, 0] * (1 + 1e-15 * rng.normal(size=(N, 2)))
    task = make_task(slopes, measured, ("k", *NAMES), shared=(1,))
    at = ensemble.evaluate(task, replace(start(task, 0.3), extra=((2, 3, 4, 5),)))
    variance = np.diagonal(ensemble.covariance(task, at)[0])
    assert (variance > 0).all()
    assert (compute_friction_errors(task, at) > 10.0).all()


@pytest.mark.parametrize("causes", [[], [0]])
def test_mu_s_averaged_over_a_background_is_as_the_dense_normal_distribution_says(causes):
    task, slopes, measured = draw(cause=1.0, background=0.2, seed=4)
    found = weigh(task)
    items = [found.items[k] for k in causes]
    J = np.zeros((2 * N, 7 + N))
    J[:, :7] = slopes.reshape(2 * N, 7)
    for i in range(N):
        J[2 * i : 2 * i + 2, 7 + i] = slopes[i, :, 0] / np.exp(found.at.own[0, i])
    # From the middle of the joint fit, where each push's mu_s is as much above it as is compared.
    start_at = np.concatenate([[found.at.mu[0, 0]], found.at.c[0, 1:]])
    level = np.exp(found.at.own[0])
    left = measured.ravel() - J[:, :7] @ start_at
    left -= np.repeat(found.at.own[0], 2) * slopes[:, :, 0].ravel()
    J[:, 0] = J[:, 7:].sum(axis=1)
    sums = np.zeros((N, 7 + N))
    sums[:, 0] = 1.0
    sums[np.arange(N), 7 + np.arange(N)] = 1.0
    means, variances, weights = [], [], []
    for scatter, share, weight in found.weigh_states(items):
        spread = np.array([10.0 if k in causes else 0.3 * max(share, 1e-9) for k in range(5)])
        prior = np.diag([0.0, 0.0, *spread**-2.0, *[scatter**-2.0] * N])
        about = np.concatenate([[0.0, 0.0], -found.at.c[0, 2:], 1 - level])
        C = np.linalg.inv(J.T @ J / found.excess + prior)
        at = C @ (J.T @ left / found.excess + prior @ about)
        now = sums @ at + level
        means.append(found.at.mu[0, 0] + np.log(now))
        variances.append(np.diag(sums @ C @ sums.T) / now**2)
        weights.append(weight)
    mean = np.array(weights) @ np.array(means)
    variance = np.array(weights) @ (np.array(variances) + (np.array(means) - mean) ** 2)
    estimate, error = estimate_friction(found, items)
    assert estimate == pytest.approx(mean, abs=2e-3 * np.sqrt(variance).min())
    assert error == pytest.approx(np.sqrt(variance), rel=2e-3)


def test_mu_s_without_a_cause_is_averaged_over_the_sets_of_causes_that_may_be_there():
    task, *_ = draw(cause=1.0, seed=4)
    found = weigh(task, background=False)
    plain = ensemble_refits.refit(task, start(task, 0.3), 10)
    none, tilt = (cause_sets.CauseSet(items, 0.0, ()) for items in ((), found.items[:1]))
    known = find_friction(task, plain), compute_friction_errors(task, plain)
    assert np.allclose(average_over_sets(found, plain, [none]), known, rtol=1e-12)
    far = replace(tilt, score=-20.0)  # what is improbable changes nothing
    assert np.allclose(average_over_sets(found, plain, [far, none]), known, rtol=1e-12)
    half, error = average_over_sets(found, plain, [tilt, none])
    with_tilt, sure = estimate_friction(found, tilt.items)
    without, unsure = estimate_friction(found, ())
    assert half - known[0] == pytest.approx(0.5 * (with_tilt - without), abs=1e-12)
    between = 0.25 * (with_tilt - without) ** 2
    wider = 0.5 * (sure**2 - unsure**2) + between
    assert error**2 - known[1] ** 2 == pytest.approx(np.maximum(wider, 0.0), abs=1e-12)


def make_search(
    seed: int, tilt: float = 3.0, misread: float = 0.0
) -> background_search.BackgroundSearch:
    """The search of a rig with a tilt, that of a set of causes at its end. Where a push is
    `misread`, a gain explains that, of which the others say, faintly, that it is far from there."""
    rng = np.random.default_rng(seed)
    slopes = rng.normal(size=(N, 2, 4))
    measured = tilt * slopes[:, :, 2] + 0.5 * rng.normal(size=(N, 2))
    if misread:
        slopes[1:, :, 3] *= 1e-3
        measured += slopes[:, :, 3] * np.where(np.arange(N) == 0, misread, -50.0 * misread)[:, None]
    task = make_task(slopes, measured, ("k", "tilt.alpha_rad", "force_gain.factor"), shared=(1,))
    ones = np.ones(2)
    small = SmallEffects(
        ("tilt", "force_gain"), (2, 3), 0.3 * ones, 5 * ones, np.zeros(4), np.zeros(4)
    )
    at = ensemble_refits.refit(small.assume(task, 3.0), small.free(start(task, 0.3)), 10)
    found = Evidence(task, at, small, None, background=False)
    sets = tuple(cause_sets.search_sets(found, found.items))
    data: Any = SimpleNamespace(task=task)
    plain = start(task, 0.3)
    return background_search.BackgroundSearch(
        data, small.effects, plain, at, small, found, sets, (), found, ()
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_decides_between_sets_that_linear_answers_hardly_tell_apart(seed):
    found = make_search(seed)
    task = found.data.task
    plain = ensemble_refits.refit(task, start(task, 0.3), 10)
    (right,) = (one for one in found.sets if one.effects == {"tilt"})
    (wrong,) = (one for one in found.sets if one.effects == {"force_gain"})
    misled = replace(found, sets=(replace(wrong, score=right.score + 1.0), right))
    assert naming.choose_by_fits(task, plain, misled, ()).best is right
    # Where they are told apart nothing is fitted.
    sure = replace(found, sets=(replace(wrong, score=right.score + 100.0), right))
    assert naming.choose_by_fits(task, plain, sure, ()) is sure
    # Unless a single one, by its fit, explains more than the best is said to.
    fit = naming.fit_causes(task, plain, replace(found, sets=(right,)), right.items)
    drop = float(np.subtract(*ensemble.criterion(task, ensemble.join(plain, fit))))
    seen = replace(found, sets=(replace(wrong, score=0.4 * drop), right))
    assert seen.best.score > right.score + 5
    single = CandidateCause("tilt", fit, drop, 2 * right.score, 0.0, drop - 2 * right.price)
    chosen = naming.choose_by_fits(task, plain, seen, [single])
    assert chosen.best is right and chosen.fitted is fit


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("tilt", [0.0, 6.0])
def test_a_cause_stays_where_one_beside_it_leads_held_out_pushes_astray(tilt, seed):
    found = make_search(seed, tilt, misread=10.0)
    validation = CrossValidation(found.data.task, np.arange(N))
    plain = ensemble_refits.refit(validation.task, found.plain, 10)
    both = cause_sets.weigh_set(found.evidence, found.evidence.items)
    found = replace(found, plain=plain, sets=(both, *found.sets))
    together = naming.fit_causes(validation.task, plain, found, both.items)
    assert validation.speaks_against(together, plain)
    at, causes = naming.choose_foreseen(validation, found, both.items, 1e-3)
    assert [item.effect for item in causes] == ["tilt"] * (tilt > 0)
    assert at.best.effects == {item.effect for item in causes}
    if at.fitted is not None:
        assert not validation.speaks_against(at.fitted, plain)
        assert at.fitted.c[0, 2] == pytest.approx(tilt, abs=0.7)


def test_the_set_that_was_fitted_is_found_where_the_comparison_stands():
    found = make_search(0)
    (single,) = (one for one in found.sets if one.effects == {"tilt"})
    fitted = cause_sets.find_set(found.evidence, {"tilt"})
    assert fitted is not None and fitted.score == pytest.approx(single.score, abs=1e-9)
    assert cause_sets.find_set(found.evidence, {"friction_patch"}) is None
    nothing = cause_sets.find_set(found.evidence, ())
    assert nothing is not None and nothing.score == 0.0


def test_no_shape_has_no_column():
    # All that have one may be in the joint fit already.
    task, _, _ = draw(cause=0.0)
    none = compute_columns(task, ensemble.evaluate(task, start(task, 0.3)), [])
    assert none.shapes == () and none.rows.shape[0] == N and none.rows.shape[-1] == 0
    assert join_columns(none.pick(["friction_patch"]), none).columns == ()


def test_columns_of_some_effects_are_theirs_in_their_order():
    columns = make_shapes(0, 6)
    some = columns.pick({"friction_patch"})
    kept = [k for k, shape in enumerate(columns.shapes) if shape.effect == "friction_patch"]
    assert [x.effect for x in some.shapes] == ["friction_patch"] * len(kept)
    for mine, k in zip(some.columns, kept, strict=True):
        np.testing.assert_array_equal(some.rows[..., mine], columns.rows[..., columns.columns[k]])
    assert join_columns(some, columns.pick({"friction_waviness"})).rows.shape == columns.rows.shape


def test_an_effect_at_its_reach_wants_to_be_larger():
    """It is held there as long as it counts as small, and nowhere once it is a cause."""
    task = draw(cause=30.0)[0]
    K = 2 + len(NAMES)
    ones = np.ones(len(NAMES))
    small = SmallEffects(EFFECTS, tuple(range(2, K)), 0.3 * ones, ones, np.zeros(K), np.zeros(K))
    at = small.free(start(task, 0.3))
    assert small.list_at_reach(at) == frozenset()
    held = ensemble_refits.refit(small.assume(task, 3.0), at, 20)
    assert 2 in small.list_at_reach(held) and held.c[0, 2] < 3.0
    free = ensemble_refits.refit(small.assume(task, 3.0, {2}), at, 20)
    assert free.c[0, 2] == pytest.approx(30.0, abs=1.0)
