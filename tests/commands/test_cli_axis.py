"""The commands on the examples of an axis: what they write, and that it is right."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
AXIS, PISTON = EXAMPLES / "axis", EXAMPLES / "pneumatic_cylinder"


def run(*words):
    call = [sys.executable, "-m", "difffric.commands.main", *map(str, words), "--quiet"]
    return subprocess.run(call, capture_output=True, text=True, timeout=300)


def answer(out, *words):
    done = run(*words, "--out", out)
    assert done.returncode == 0, done.stderr
    assert (out / "report.html").stat().st_size > 10_000
    return json.loads((out / "result.json").read_text())


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    out = tmp_path_factory.mktemp("fit")
    return answer(out, "fit", AXIS / "recording.csv", "--setup", AXIS / "setup.toml"), out


def test_fit_finds_the_truth_and_writes_the_set_up(fitted):
    found, out = fitted
    truth = {"mass_kg": 95.0, "coulomb_N": 20.0, "k_v_N_s_per_m": 200.0, "offset_N": 3.0}
    for name, expected in truth.items():
        said = found["parameters"][name]
        assert abs(said["value"] - expected) < 3.5 * said["standard_error"]
    assert "gain_N_per_V = 35.15" in (out / "setup.toml").read_text()
    assert found["noise"]["force_p_value"] < 1e-6  # the cogging, which a fit does not know


def test_identify_gives_each_stretch_its_friction(fitted, tmp_path):
    _, out = fitted
    data = AXIS / "recording.csv"
    found = answer(tmp_path, "identify", data, "--setup", out / "setup.toml")
    truth = json.loads((AXIS / "truth.json").read_text())["coulomb_of_stretches_N"]
    for one, expected in zip(found["stretches"], truth, strict=True):
        assert one["coulomb_N"]["value"] == pytest.approx(expected, rel=0.02)


def test_diagnose_names_what_is_hidden(tmp_path):
    data, setup = AXIS / "recording.csv", AXIS / "setup.toml"
    found = answer(tmp_path, "diagnose", data, "--setup", setup)
    assert (found["verdict"], found["causes"][0]["id"]) == ("named", "cogging")
    assert found["causes"][0]["parameters"]["amplitude_N"]["value"] == pytest.approx(1, rel=0.03)
    assert "[effects.cogging]" in (tmp_path / "setup.toml").read_text()
    assert found["gain"]["heldout_nrmse_after"] < 1.2 < found["gain"]["heldout_nrmse_before"]


def test_simulate_follows_the_recorded_forces(fitted, tmp_path):
    _, out = fitted
    found = answer(tmp_path, "simulate", out / "setup.toml", "--motion", AXIS / "recording.csv")
    assert found["samples"] == 6986
    assert found["derivatives"]["final_position_m"]["position_m"] == 1.0
    assert (tmp_path / "motion.csv").read_text().count("\n") == 6987
    assert "--motion is missing" in run("simulate", out / "setup.toml").stderr


@pytest.mark.parametrize(
    ("pressure", "half_difference", "half_sum"), [(1, 3.93, 0.75), (5, 6.96, 2.11)]
)
def test_the_measured_piston_has_the_friction_of_its_averages(
    pressure, half_difference, half_sum, tmp_path
):
    data = PISTON / f"piston_{pressure}bar.csv"
    found = answer(tmp_path, "fit", data, "--setup", PISTON / "setup.toml")
    assert found["parameters"]["coulomb_N"]["value"] == pytest.approx(half_difference, rel=0.03)
    assert -found["parameters"]["offset_N"]["value"] == pytest.approx(half_sum, rel=0.03)
    assert found["motion"] == "imposed"
    assert ["mass_kg"] in [x["parameters"] for x in found["not_identifiable"]]


def test_check_shows_what_would_be_fitted(tmp_path):
    data, setup = AXIS / "recording.csv", AXIS / "setup.toml"
    found = answer(tmp_path, "check", data, "--setup", setup)
    assert len(found["stretches"]) == 5
    assert found["determines"]["not_identifiable"] == []
    errors = found["determines"]["standard_errors"]
    assert set(errors) == {*found["determines"]["first_look"]}
    assert 0 < errors["mass_kg"] < 1
    assert (tmp_path / "traces.png").exists()
    assert not (tmp_path / "setup.toml").exists()  # nothing was fitted


def test_check_says_what_such_data_leave_open(tmp_path):
    data, setup = PISTON / "piston_1bar.csv", PISTON / "setup.toml"
    found = answer(tmp_path, "check", data, "--setup", setup)
    assert found["motion"] == "imposed"
    assert found["determines"]["standard_errors"]["mass_kg"] is None
    assert found["determines"]["standard_errors"]["coulomb_N"] > 0


def test_init_writes_a_set_up_that_fit_takes(fitted, tmp_path):
    expected, _ = fitted
    setup = tmp_path / "setup.toml"
    assert "--gain-n-per-v is missing" in begin(AXIS / "recording.csv", setup).stderr
    done = begin(AXIS / "recording.csv", setup, "--gain-n-per-v", 35.15)
    assert done.returncode == 0, done.stderr
    found = answer(tmp_path / "fit", "fit", AXIS / "recording.csv", "--setup", setup)
    for name, said in expected["parameters"].items():
        value, error = said["value"], said["standard_error"]
        assert found["parameters"][name]["value"] == pytest.approx(value, abs=0.2 * error)
    assert "exists already" in begin(AXIS / "recording.csv", setup).stderr


def test_the_gain_follows_from_a_mass_that_is_known(tmp_path):
    setup = tmp_path / "setup.toml"
    begin(AXIS / "recording.csv", setup, "--mass-kg", 95)
    gain = tomllib.loads(setup.read_text())["drive"]["gain_N_per_V"]
    assert gain == pytest.approx(35.15, rel=0.005)


def test_init_asks_for_a_mass_that_no_motion_tells(tmp_path):
    done = begin(PISTON / "piston_1bar.csv", tmp_path / "s.toml")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "--mass-kg is missing" in done.stderr
    assert "for pushes only" in begin(AXIS / "recording.csv", tmp_path / "s.toml",
                                     "--stroke-mm", 2).stderr  # fmt: skip


def begin(data, to, *words):
    call = [sys.executable, "-m", "difffric.commands.main", "init", str(data), "--to", str(to)]
    return subprocess.run(
        [*call, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=300,
        stdin=subprocess.DEVNULL,
    )


def test_foreign_names_are_said_by_an_option_or_by_the_set_up(fitted, tmp_path):
    expected, _ = fitted
    data, setup = tmp_path / "a.csv", tmp_path / "s.toml"
    text = (AXIS / "recording.csv").read_text()
    data.write_text(text.replace("drive_V,position_mm", "Spannung [V],Weg [mm]", 1))
    setup.write_text((AXIS / "setup.toml").read_text() + "\n[files]\nposition = 'Weg'\n")
    done = run("identify", data, "--setup", setup)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "--channel drive='Spannung [V]'" in done.stderr or "Spannung" in done.stderr
    out = tmp_path / "out"
    found = answer(out, "fit", data, "--setup", setup, "--channel", "drive=Spannung")
    assert found["parameters"] == expected["parameters"]
    assert 'drive = "Spannung"' in (out / "setup.toml").read_text()


def test_units_that_are_plainly_wrong_are_said_first(tmp_path):
    data = tmp_path / "a.csv"
    text = (AXIS / "recording.csv").read_text()
    data.write_text(text.replace("position_mm", "position_m", 1))
    for command in ("fit", "check", "identify", "diagnose"):
        done = run(command, data, "--setup", AXIS / "setup.toml")
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
        assert "position_m looks like mm, call the column position_mm" in done.stderr
    trusted = run("fit", data, "--setup", AXIS / "setup.toml", "--trust-units")
    assert trusted.returncode == 0
    assert "a unit may be wrong" in " ".join(trusted.stdout.split())


@pytest.mark.parametrize(
    "words",
    [
        ("family", AXIS / "setup.toml"),
        ("plan", AXIS / "setup.toml", "--offset-um", 100),
        ("monitor", EXAMPLES / "pushes.csv", "--setup", AXIS / "setup.toml"),
        ("fit", AXIS / "recording.csv", "--setup", EXAMPLES / "setup.toml"),
        ("fit", EXAMPLES / "pushes.csv", "--setup", AXIS / "setup.toml"),
    ],
)
def test_an_axis_where_pushes_belong_is_one_line(words):
    done = run(*words)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "an axis" in done.stderr


def test_what_is_of_pushes_only_is_refused():
    done = run("fit", AXIS / "recording.csv", "--setup", AXIS / "setup.toml", "--robust")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--robust is for pushes only" in done.stderr
