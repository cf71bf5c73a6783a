"""Hidden effects: data from a simulator that shares no code with the library, from rough set-ups.
What is named, its size, and what it gains on pushes that nobody has fitted."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import difffric as df
from difffric.commands.main import app
from difffric.diagnosis.alternatives import find_alternatives
from difffric.diagnosis.exploration import CandidateCause
from difffric.diagnosis.misfit import PHASES
from difffric.diagnosis.shape_scan import is_within_travel
from difffric.rig.setup import Setup
from difffric.rig.setup_toml import read_setup
from tests.browser import WIDTHS, browser, faults, needs_chromium
from tests.hidden import heldout, random_case, write
from tests.unit.diagnosis.prediction import prediction_error

__all__ = ["browser"]  # a fixture

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
LONG = ("presliding", "pusher_lag", "channel_skew")
"""Minutes each: with the slow tests."""


class Analysis:
    """A case on disk, its diagnosis, and the prediction of pushes that it has not seen."""

    def __init__(self, case, folder):
        self.case, self.folder = case, folder
        self.path = write(case, folder)
        self.setup = read_setup(folder / "setup.toml")
        self.options = {"use_data_mass": len(case.masses) > 1}
        self.found = df.diagnose(self.setup, df.load(self.path), **self.options)

    @property
    def first(self) -> set[str]:
        """The set that the first cause stands for."""
        first = self.found.causes[0]
        return {first.id, *first.confusable_with}

    def error(self, setup: Setup) -> float:
        """Of a set-up on further pushes of the same rig."""
        new = write(heldout(self.case, len(self.case.pushes)), self.folder / "new")
        noise = self.case.noise.force, np.sqrt(2) * self.case.noise.position
        return prediction_error(setup, df.load(new), noise, **self.options)


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
    assert cause.change > 0
    where_the_misfit_sits(one.found)
    assert one.found.gain.after < one.found.gain.before
    plain = Setup(one.found.plain.rig, one.found.plain.scatter)
    before, after = one.error(plain), one.error(one.found.setup)
    assert after < before and after < 1.1


@pytest.mark.parametrize("kind", ["recordings", "table"])
def test_nothing_is_named_where_nothing_is_hidden(kind, tmp_path):
    one = Analysis(random_case(1, kind=kind), tmp_path)
    assert one.found.verdict == "adequate" and not one.found.causes
    gain = one.found.gain
    assert gain.after == gain.before == pytest.approx(gain.noise_floor, rel=0.2)


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
    state = one.found.state
    first = one.found.causes[0]
    drop, p_value = first.chi2_drop, first.p_value
    cause = CandidateCause(first.id, state.extended, drop, 0.0, p_value, drop)
    others = ["tilt", "friction_ratio", "probe_scale", "force_offset"]
    others.remove(first.id)
    found = find_alternatives(state.data.task, state.plain, state.extended, cause, others)
    assert {c.effect for c in found} == {"tilt", "friction_ratio"} - {first.id}
    assert all(c.drop == pytest.approx(cause.drop, abs=6) for c in found)


def test_a_wave_longer_than_two_ways_is_none(tmp_path):
    write(random_case(2, kind="table"), tmp_path)
    found = df.diagnose(read_setup(tmp_path / "setup.toml"), df.load(tmp_path / "pushes.csv"))
    data, plain = found.state.data, found.state.plain
    coordinates = data.task.model.coordinates
    names = [f"friction_waviness.{key}" for key in ("amplitude", "wavelength_m", "phase_rad")]
    for ways in (1.9, 2.1):
        c = plain.c[0].copy()
        length = ways * data.scales.ways.max()
        c[coordinates.indices(names)] = coordinates.point(
            dict(zip(names, (0.1, length, 0.5), strict=True))
        )
        there = is_within_travel(data.task, c, "friction_waviness", data.scales)
        assert there == (ways < 2)
        assert is_within_travel(data.task, c, "friction_patch", data.scales)


def test_what_the_catalogue_lacks_is_located(tmp_path):
    case = random_case(100000 * 10, "friction_rise", strength=60)
    one = Analysis(case, tmp_path)
    assert one.found.verdict == "unexplained" and not one.found.causes
    assert one.found.location is not None and one.found.location.component == "friction"
    assert one.found.as_dict()["location"] == "friction"


@pytest.fixture(scope="module")
def commanded(tmp_path_factory):
    """A case, its file, and the folder that `difffric diagnose` has written."""
    folder = tmp_path_factory.mktemp("commanded")
    case = random_case(2, "probe_scale", strength=12, kind="table")
    path = write(case, folder / "data")
    words = ["diagnose", str(path), "--setup", str(folder / "data" / "setup.toml")]
    ended = CliRunner().invoke(app, [*words, "--out", str(folder / "out"), "--quiet"])
    assert ended.exit_code == 0, ended.output
    return case, path, folder / "out"


def test_the_command_writes_a_set_up_that_the_others_take(commanded):
    case, path, out = commanded
    answer = json.loads((out / "result.json").read_text())
    assert [cause["id"] for cause in answer["causes"]] == ["probe_scale"]
    found = answer["causes"][0]["parameters"]["factor"]
    off = found["value"] - case.effects["probe_scale"]["factor"]
    assert abs(off) < 4 * found["standard_error"]
    wanted = {"verdict", "lack_of_fit", "causes", "negligible", "location", "gain"}
    assert wanted | {"not_visible", "next_experiment"} <= answer.keys()
    extended = read_setup(out / "setup.toml")
    pushes = df.load(path)
    assert "probe_scale.factor" in df.fit(extended, pushes).names
    again = df.diagnose(extended, pushes)
    assert again.verdict == "adequate"
    assert df.simulate(extended.rig, velocity=0.05).peak_force > 0


@needs_chromium
def test_the_report_shows_at_both_widths(browser, commanded):
    for width in WIDTHS:
        assert faults(browser, commanded[-1] / "report.html", width) == [], width


def test_bad_input_is_one_clear_line(tmp_path):
    case = random_case(2, kind="table")
    setup = read_setup(write(case, tmp_path).parent / "setup.toml")
    pushes = df.load(tmp_path / "pushes.csv")
    with pytest.raises(df.InputError, match="held_out"):
        df.diagnose(setup, pushes, held_out="day")


def test_too_few_pushes_to_hold_any_out_is_said(tmp_path):
    one = write(random_case(2, n=2), tmp_path)
    found = df.diagnose(read_setup(tmp_path / "setup.toml"), df.load(one))
    assert not found.causes and any("too few to hold any out" in note for note in found.notes)


def test_one_speed_and_one_channel_are_answered_for_what_they_show(tmp_path):
    case = random_case(2, kind="table")
    setup = read_setup(write(case, tmp_path).parent / "setup.toml")
    pushes = df.load(tmp_path / "pushes.csv")
    nothing = np.full(len(pushes), np.nan)
    found = df.diagnose(setup, replace(pushes, sliding_distance=nothing))
    assert found.verdict == "adequate"
    assert {"probe_scale", "release_threshold"} <= set(found.not_visible)
