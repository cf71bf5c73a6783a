"""The commands on the examples of an axis: what they write, and that it is right."""

import json
import subprocess
import sys
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


def test_what_is_of_pushes_only_is_refused():
    done = run("fit", AXIS / "recording.csv", "--setup", AXIS / "setup.toml", "--robust")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--robust is for pushes only" in done.stderr
