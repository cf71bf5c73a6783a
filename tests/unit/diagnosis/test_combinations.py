"""Three causes hidden together in a table of known friction, by a simulator of the tests' own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import difffric as df
from difffric.diagnosis.combinations.explanation import explain_table
from difffric.rig import parameters
from difffric.simulation.columns import observe_columns
from tests.hidden.case import MM_MIN, RECORDINGS, TABLE, Case, Noise, Push
from tests.hidden.simulate import readings
from tests.unit.diagnosis.analysis import Analysis

HIDDEN = {
    "rebound_damping": {"b_N_s_per_m": 2600.0},
    "release_latch": {"threshold_N": 15.0},
    "pusher_duration": {"duration_s": 0.047},
}
TRUE = {f"{effect}.{key}": x for effect, sizes in HIDDEN.items() for key, x in sizes.items()}
NOISE = Noise(force=1.0, position=10e-6)
SPEEDS = (500, 800, 1000, 1500, 2000, 3000, 4000, 5000)
FRICTIONS = {"DRY": 0.141, "WET": 0.115}


def _make_case(speeds, seed, hidden, kind=TABLE, **more):
    """A rig with these effects hidden, pushed at these speeds [mm/min] in two conditions."""
    pushes = [
        Push(v * MM_MIN, mu, i, 1.0, name)
        for name, mu in FRICTIONS.items()
        for i, v in enumerate(speeds)
    ]
    rig = {
        "mass_kg": 18.9,
        "mu_k_over_mu_s": 0.75,
        "k_v_N_s_per_m": 0.0,
        "k_N_per_m": 5.6e5,
        "b_N_s_per_m": 0.0,
    }
    given = {"stroke": None, "noise": NOISE, **more}
    return Case(seed, kind, rig, FRICTIONS, 0.0, pushes, hidden, **given)


def _measure(speeds, seed, hidden=HIDDEN):
    """The table that such a rig gives, mu_s known by a gauge."""
    case = _make_case(speeds, seed, hidden)
    pushes = case.pushes
    F, d = readings(case).T
    rng = np.random.default_rng(seed)
    n = len(pushes)
    return df.Pushes(
        velocity=[push.velocity for push in pushes],
        peak_force=F + NOISE.force * rng.standard_normal(n),
        sliding_distance=d + NOISE.position * rng.standard_normal(n),
        peak_force_se=np.full(n, NOISE.force),
        sliding_distance_se=np.full(n, NOISE.position),
        mu_s_gauge=[push.mu_s for push in pushes],
        condition=[push.condition for push in pushes],
    )


@pytest.fixture(scope="module")
def table():
    return _measure(SPEEDS, 5)


def _explain(table):
    rough = df.spring_damper_rig(mass=18.9, mu_s=0.13, k=8.5e5, b=1200.0, k_v=10.0)
    return explain_table(rough, table, np.unique(table.velocity, return_inverse=True)[1])


@pytest.fixture(scope="module")
def found(table):
    return _explain(table)


def test_a_loss_a_latch_and_a_duration_are_named_together(found):
    assert found.best.parts == set(HIDDEN)
    assert not found.rivals


def test_each_is_sized_within_three_standard_errors(found, table):
    fit = df.fit(found.extend_setup(found.best), table, several_starts=False)
    assert fit.converged and fit.reduced_chi2 < 2.0
    for name, true in TRUE.items():
        assert abs(fit.value(name) - true) < 3 * fit.standard_error(name)


def test_held_out_pushes_are_foreseen_as_by_the_true_model(found):
    """At speeds that the search has not seen: at least 90 % of what the true model gains."""
    further = _measure((650, 1200, 2500, 3500, 4500), 6)

    def error(one):
        rig = parameters.with_values(
            found.extend_setup(one).rig, {"mu_s": np.asarray(further.mu_s_gauge)}
        )
        seen = observe_columns(rig, further.velocity)
        r = np.stack(
            [
                (further.peak_force - seen.peak_force) / NOISE.force,
                (further.sliding_distance - np.nan_to_num(seen.sliding_distance)) / NOISE.position,
            ]
        )
        return np.sqrt(np.nanmean(r**2))

    before, after = error(found.stages[0]), error(found.best)
    assert before - after > 0.9 * (before - 1.0)


def test_no_part_is_needless(found):
    """Each buys more than its number would by chance, on the search's own cost."""
    price = np.log(2 * 2 * len(SPEEDS))
    for one in found.without.values():
        assert one.cost - found.best.cost > price


def test_what_a_fold_holds_out_does_not_move_its_end(found):
    """The points of a fold descend without its pushes: others than those of the next fold."""
    ends = found.blind[len(found.best.parts)]
    assert len(ends.c) == len(SPEEDS)
    assert len(np.unique(ends.c, axis=0)) == len(SPEEDS)


ALONE = {**HIDDEN, "pusher_duration": {"duration_s": 0.065}}
"""A tip that stops earlier leaves slow parts at rest in contact, and no d that a table could hold:
all that is left is as without."""


@pytest.mark.slow
@pytest.mark.parametrize("effect", ALONE)
def test_each_alone_is_named_and_sized(effect):
    """A latch alone shows where the tip stops at the first loss of contact: there it is nothing but
    an early count."""
    table = _measure(SPEEDS, 8, {effect: ALONE[effect]})
    alone = _explain(table)
    assert effect in alone.best.parts
    fit = df.fit(alone.extend_setup(alone.best), table, several_starts=False)
    for key, true in ALONE[effect].items():
        name = f"{effect}.{key}"
        assert abs(fit.value(name) - true) < 3 * fit.standard_error(name)


@pytest.mark.slow
@pytest.mark.parametrize(
    "hidden", [("rebound_damping",), ("pusher_duration",), ("rebound_damping", "pusher_duration")]
)
def test_recordings_show_a_loss_above_b_and_a_duration(hidden, tmp_path):
    """Alone and together; a latch is no matter of recordings, which hold the samples."""
    effects = {effect: HIDDEN[effect] for effect in hidden}
    case = _make_case((500, 1000, 2000, 4000), 9, effects, RECORDINGS, noise=Noise(), stroke=2e-3)
    one = Analysis(replace(case, scatter=0.015), tmp_path)
    causes = {cause.id: cause for cause in one.found.causes}
    assert set(hidden) == set(causes)
    for effect in hidden:
        for key, (value, error) in causes[effect].parameters.items():
            assert abs(value - HIDDEN[effect][key]) < 3 * error
