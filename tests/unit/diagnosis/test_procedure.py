"""Hidden effects in recordings: data from a simulator that shares no code with the library, from
rough set-ups. What is named, its size, and what it gains on pushes that nobody has fitted.
`test_procedure_tables` has what is found in tables."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import difffric as df
from difffric.diagnosis import location, procedure
from difffric.diagnosis.alternatives import find_alternatives
from difffric.diagnosis.combinations import cause_rounds
from difffric.diagnosis.exploration import CandidateCause
from difffric.diagnosis.inferred import changes
from difffric.diagnosis.inferred.changes import Changes, ReadingChanges
from difffric.diagnosis.inferred.friction import find_friction
from difffric.diagnosis.misfit import PHASES
from difffric.rig.setup import Setup
from difffric.rig.setup_toml import read_setup
from tests.hidden import friction_of, random_case, write
from tests.unit.diagnosis.analysis import Analysis

# One effect at least of each component, sizes at which it is not to be missed.
HIDDEN = {
    "stribeck": {"seed": 2, "strength": 30, "delta": 1.0},
    "presliding": {"seed": 700001},
    "rebound_damping": {"seed": 11, "strength": 30},
    "pusher_lag": {"seed": 5, "strength": 30},
    "force_gain": {"seed": 6, "strength": 30},
    "channel_skew": {"seed": 7, "strength": 30},
}
ANOTHER_FORM = ("stribeck",)
"""Hidden with another exponent than the catalogue's: the size is not the same number."""
LONG = ("presliding", "stribeck", "pusher_lag", "channel_skew")
"""Minutes each: with the slow tests."""


def where_the_misfit_sits(found):
    """Over whatever it is told, it is the whole misfit, and no phase but one that a push has."""
    before, after = found.state.lack_before, found.state.lack_after
    channels = {"force": 0, "position": 1}
    for one in found.misfit:
        k = channels[one.channel]
        total = (one.numbers * one.before).sum(), (one.numbers * one.after).sum()
        np.testing.assert_allclose(total, (before.chi2[:, k].sum(), after.chi2[:, k].sum()))
        if one.by == "phase":
            assert {"closing", "rebounding", "free", "at rest"} <= set(one.at) <= set(PHASES)


@pytest.mark.parametrize(
    "effect",
    [pytest.param(x, marks=pytest.mark.slow) if x in LONG else x for x in HIDDEN],
)
def test_a_hidden_effect_is_named_sized_and_gains_on_new_pushes(effect, tmp_path):
    options = dict(HIDDEN[effect])
    one = Analysis(random_case(options.pop("seed"), effect, **options), tmp_path)
    assert one.found.verdict in ("named", "ambiguous")
    assert len(one.found.causes) == 1
    assert effect in one.first
    cause = one.found.causes[0]
    if cause.id == effect and effect not in ANOTHER_FORM:
        for key, (value, error) in cause.parameters.items():
            assert abs(value - one.case.effects[effect][key]) < 4 * error
    assert cause.change_of_most > 0
    where_the_misfit_sits(one.found)
    assert one.found.gain.after < one.found.gain.before
    plain = Setup(one.found.plain.rig, one.found.plain.scatter)
    before, after = one.error(plain), one.error(one.found.setup)
    assert after < before and after < 1.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "seed", "strength"),
    [
        ("contact_hardening", 500009, 30.0),
        ("static_dwell", 300007, 6.0),
        ("probe_scale", 400021, 10.0),
    ],
    ids=[
        "a push jumps beside the null of a lag",
        "a push stands on a wrong branch",
        "a tilt beside it leads held-out pushes astray",
    ],
)
def test_an_effect_is_named_where_a_push_stands_on_an_edge(effect, seed, strength, tmp_path):
    one = Analysis(random_case(seed, effect, strength), tmp_path)
    assert effect in one.first and len(one.found.causes) == 1


@pytest.mark.slow
def test_what_explains_most_by_its_fit_is_named_though_linear_answers_miss_it(tmp_path):
    one = Analysis(random_case(400023, "stribeck", 10.0, delta=1.0), tmp_path)
    assert "stribeck" in one.first and len(one.found.causes) == 1
    away = np.abs(np.array(one.found.mu_s) / friction_of(one.case) - 1)
    assert away.max() < 2e-3


@pytest.mark.slow
def test_strong_bristles_are_told_without_a_search_for_other_causes(tmp_path, monkeypatch):
    monkeypatch.setattr(procedure, "begin_search", None)  # nothing fitted beside them arrives
    one = Analysis(random_case(700001, "presliding"), tmp_path)
    assert [cause.id for cause in one.found.causes] == ["presliding"]
    value, error = one.found.causes[0].parameters["sigma_0_N_per_m"]
    assert abs(value - one.case.effects["presliding"]["sigma_0_N_per_m"]) < 4 * error


def test_beside_a_background_what_is_read_says_whether_a_cause_matters(monkeypatch):
    moved = Changes(0.05, peak_force=0.001, sliding_distance=0.002, as_mu_s=0.05, of_most=0.002)
    monkeypatch.setattr(cause_rounds, "measure_changes", lambda *_: moved)
    search = object.__new__(procedure._CauseSearch)
    search.start, search.matters = SimpleNamespace(data=SimpleNamespace(task=None)), 0.005  # type: ignore
    search.usual, search.share = frozenset(), 0.0
    one = SimpleNamespace(best=SimpleNamespace(effect="pusher_lag"), without=None)
    assert search._does_matter(one, None)  # type: ignore
    search.share = 0.2
    assert not search._does_matter(one, None)  # type: ignore


@pytest.mark.parametrize(("effect", "matters"), [("pusher_lag", True), ("pusher_duration", False)])
def test_beside_a_background_half_counts_of_what_cuts_pushes_short(monkeypatch, effect, matters):
    monkeypatch.setattr(changes, "compare_readings", lambda *_: ReadingChanges(0, 0.008, 1, 0.008))
    monkeypatch.setattr(changes, "find_friction", lambda *_: np.zeros(2))
    at: Any = SimpleNamespace(c=np.zeros((1, 3)), mu=np.zeros((1, 1)), own=np.zeros((1, 2)))
    coordinates = SimpleNamespace(indices=lambda names: [2])
    task = SimpleNamespace(n=2, condition=[0, 0], model=SimpleNamespace(coordinates=coordinates))
    search = object.__new__(procedure._CauseSearch)
    search.start, search.matters = SimpleNamespace(data=SimpleNamespace(task=task)), 0.005  # type: ignore
    search.usual, search.share = frozenset(), 0.2
    one: Any = SimpleNamespace(best=SimpleNamespace(effect=effect), without=at)
    assert search._does_matter(one, at) == matters


def test_nothing_is_named_where_nothing_is_hidden(tmp_path):
    one = Analysis(random_case(1), tmp_path)
    assert one.found.verdict == "adequate" and not one.found.causes
    gain = one.found.gain
    assert gain.after == gain.before == pytest.approx(gain.noise_floor, rel=0.2)
    # The plain calibration, begun where the plain fit of the diagnosis ended, is no worse than
    # that of `fit`, and near it.
    alone, beside = df.fit(one.setup, df.load(one.path)), one.found.plain
    assert beside.degrees_of_freedom == alone.degrees_of_freedom
    assert alone.chi2 - 10 < beside.chi2 < alone.chi2 + 0.1
    assert (np.abs(beside.mu_s - alone.mu_s) < 0.5 * alone.mu_s_se).all()


def test_two_effects_are_both_named(tmp_path):
    pair = ("quadratic_drag", "force_gain")
    one = Analysis(random_case(3, pair, strength=40), tmp_path)
    sets = [{c.id, *c.confusable_with} for c in one.found.causes]
    assert len(sets) == 2
    assert all(any(effect in some for some in sets) for effect in pair)


def test_inseparable_effects_are_one_set(tmp_path):
    """A tilt holds the part back by m g sin(alpha), another ratio by a share of mu_s m g: at one
    mass and nearly one mu_s these are the same."""
    one = Analysis(random_case(100000 * 4 + 6, "friction_ratio", strength=10), tmp_path)
    assert one.found.verdict == "ambiguous"
    assert {"tilt", "friction_ratio"} <= one.first
    assert one.found.experiments[0].separates[0] == one.found.causes[0].id
    # Which of the two it is moves every mu_s, and the errors say so.
    away = np.abs(np.array(one.found.mu_s) - friction_of(one.case))
    assert (away < 2 * np.array(one.found.mu_s_standard_error)).all()
    state = one.found.state
    first = one.found.causes[0]
    drop, p_value = first.chi2_drop, first.p_value
    cause = CandidateCause(first.id, state.extended, drop, 0.0, p_value, drop)
    others = ["tilt", "friction_ratio", "probe_scale", "force_offset"]
    others.remove(first.id)
    found = find_alternatives(state.data.task, state.plain, state.extended, cause, others)
    assert {c.effect for c in found} == {"tilt", "friction_ratio"} - {first.id}
    assert all(c.drop == pytest.approx(cause.drop, abs=6) for c in found)


def test_what_the_catalogue_lacks_is_located(tmp_path, monkeypatch):
    case = random_case(100000 * 10, "friction_rise", strength=60)
    one = Analysis(case, tmp_path)
    assert one.found.verdict == "unexplained" and not one.found.causes
    assert one.found.location is not None and one.found.location.component == "friction"
    assert one.found.as_dict()["location"] == "friction"
    # The plain model's mu_s is off by what it lacks, that beside the curve is not.
    had, state = np.log(friction_of(case)), one.found.state
    away = np.log(one.found.mu_s) - had
    assert (np.abs(away) < 2 * np.divide(one.found.mu_s_standard_error, one.found.mu_s)).all()
    plain = find_friction(state.data.task, state.plain) - had
    assert np.linalg.norm(away) < 0.3 * np.linalg.norm(plain)
    # Where none is known beside a curve it is told as far open as the curve is large.
    unknown = np.full((2, len(had)), np.nan)
    monkeypatch.setattr(
        location,
        "fit_to_size",
        lambda _, start, curve: SimpleNamespace(fits=start, friction=unknown),
    )
    asked = replace(one.found.location, friction=None)
    told = location.settle_location(state.data.task, state.plain, asked, state.data.scales)
    assert told.friction is not None and np.isfinite(told.friction).all()
    assert (told.friction[1] >= np.abs(asked.correction).max()).all()


def test_too_few_pushes_to_hold_any_out_is_said(tmp_path):
    one = write(random_case(2, n=2), tmp_path)
    found = df.diagnose(read_setup(tmp_path / "setup.toml"), df.load(one))
    assert not found.causes and any("too few to hold any out" in note for note in found.notes)
