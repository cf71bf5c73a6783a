"""Hidden effects in tables of F_p and d, and the command that looks for them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import difffric as df
from difffric.commands.main import app
from difffric.diagnosis.shape_scan import is_within_travel
from difffric.rig.setup_toml import read_setup
from tests.browser import WIDTHS, browser, faults, needs_chromium
from tests.hidden import random_case, write
from tests.unit.diagnosis.analysis import Analysis

__all__ = ["browser"]  # a fixture


@pytest.fixture(scope="module")
def nothing_hidden(tmp_path_factory):
    """A table in which nothing is hidden, diagnosed."""
    return Analysis(random_case(1, kind="table"), tmp_path_factory.mktemp("nothing"))


def test_nothing_is_named_where_nothing_is_hidden(nothing_hidden):
    found = nothing_hidden.found
    assert found.verdict == "adequate" and not found.causes
    gain = found.gain
    assert gain.after == gain.before == pytest.approx(gain.noise_floor, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "seed", "n"),
    [("contact_hardening", 700009, 24), ("friction_patch", 1700003, 100)],
    ids=["which takes another k and b", "which the plain fit met with a k_v of zero"],
)
def test_a_cause_of_a_table_is_followed_that_is_slow_to_show(effect, seed, n, tmp_path):
    one = Analysis(random_case(seed, effect, 10.0, kind="table", n=n), tmp_path)
    assert [cause.id for cause in one.found.causes] == [effect]


def test_a_wave_longer_than_two_ways_is_none(nothing_hidden):
    state = nothing_hidden.found.state
    data, plain = state.data, state.plain
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


def test_one_speed_and_one_channel_are_answered_for_what_they_show(tmp_path):
    case = random_case(2, kind="table")
    setup = read_setup(write(case, tmp_path).parent / "setup.toml")
    pushes = df.load(tmp_path / "pushes.csv")
    nothing = np.full(len(pushes), np.nan)
    found = df.diagnose(setup, replace(pushes, sliding_distance=nothing))
    assert found.verdict == "adequate"
    assert {"probe_scale", "release_threshold"} <= set(found.not_visible)
