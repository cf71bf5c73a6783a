"""The commands as a user types them: exit status, one clear line, nothing half-written."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

SETUP = """
[part]
mass_kg = 18.9

[friction]
mu_s = 0.141
k_v_N_s_per_m = 5.0

[contact]
k_N_per_m = 8.0e5
b_N_s_per_m = 1500.0
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A cache folder of the tests' own, so that the user's is left alone."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def setup(tmp_path):
    path = tmp_path / "setup.toml"
    path.write_text(SETUP)
    return path


def run(home, *arguments, **environment):
    command = [sys.executable, "-m", "difffric.commands.main", *map(str, arguments)]
    env = {**os.environ, "XDG_CACHE_HOME": str(home), **environment}
    return subprocess.run(command, capture_output=True, text=True, env=env, timeout=300)


def test_simulate_answers_in_the_contract_s_fields(home, setup, tmp_path):
    out = tmp_path / "out"
    done = run(home, "simulate", setup, "--velocity-mm-min", 3000, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "F_p = 174.3" in done.stdout and "stops at the first loss of contact" in done.stdout
    answer = json.loads((out / "result.json").read_text())
    assert answer["regime"] == "released_by_rebound" and answer["contacts"] == 1
    assert answer["stuck_first"] is False and answer["side"] == "both"
    assert answer["margin"] == pytest.approx(1500 * 0.05 / (0.141 * 18.9 * 9.80665) - 1, rel=1e-5)
    names = {
        "mu_s", "mu_k_over_mu_s", "k_v_N_s_per_m", "k_N_per_m", "b_N_s_per_m", "mass_kg",
        "velocity_m_per_s",
    }  # fmt: skip
    assert set(answer["derivatives"]["peak_force_N"]) == names
    assert set(answer["derivatives"]["sliding_distance_m"]) == names
    assert sorted(p.name for p in out.iterdir()) == [
        "force.png", "position.png", "report.html", "result.json",
    ]  # fmt: skip


def test_simulate_says_why_there_is_no_distance(home, setup, tmp_path):
    out = tmp_path / "out"
    short = ("--stroke-mm", 0.001)
    done = run(home, "simulate", setup, "--velocity-mm-min", 500, *short, "--out", out, "--quiet")
    assert done.returncode == 0 and done.stderr == ""
    answer = json.loads((out / "result.json").read_text())
    assert answer["sliding_distance_m"] is None and answer["reason"] == "rests in contact"
    assert answer["regime"] == "no_motion"
    assert answer["derivatives"]["sliding_distance_m"]["mu_s"] is None


def test_family_writes_both_fits(home, setup, tmp_path):
    out = tmp_path / "out"
    done = run(home, "family", setup, "--out", out)
    assert done.returncode == 0, done.stderr
    answer = json.loads((out / "result.json").read_text())
    assert set(answer["equation_3"]["fitted"]) == {"C_v", "C_mu"}
    assert set(answer["equation_5"]["fitted"]) == {"mu_0", "C_1", "k1", "C_2", "k2"}
    assert len(answer["peak_force_N"]) == len(answer["velocity_m_per_s"])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--velocity-mm-min", 0), "--velocity-mm-min: expected a number > 0, got 0"),
        (("--velocity-mm-min", "nan"), "--velocity-mm-min: expected a number > 0, got nan"),
        (("--velocity-mm-min", 3000, "--stroke-mm", 0), "--stroke-mm: expected a number > 0"),
        (("--velocity-mm-min", 3000, "--mu-s", -0.1), "--mu-s: expected a number > 0"),
        (("--velocity-mm-min", 3000, "--mass-kg", 0), "--mass-kg: expected a number > 0"),
    ],
)
def test_bad_options_are_one_line_and_status_2(home, setup, tmp_path, arguments, says):
    out = tmp_path / "out"
    done = run(home, "simulate", setup, *arguments, "--out", out)
    assert done.returncode == 2
    assert says in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not out.exists() or not list(out.iterdir())


def test_a_bad_setup_names_everything_at_once(home, tmp_path):
    path = tmp_path / "setup.toml"
    path.write_text(SETUP.replace("mass_kg = 18.9", "mass_kg = -1").replace("mu_s", "mu_S"))
    done = run(home, "simulate", path, "--velocity-mm-min", 3000)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    for words in ("mass_kg", "got -1", "mu_S", "unknown key", "setup.toml"):
        assert words in done.stderr


def test_a_missing_setup_is_one_line(home, tmp_path):
    done = run(home, "simulate", tmp_path / "none.toml", "--velocity-mm-min", 3000)
    assert done.returncode == 2 and "none.toml" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_32_bits_are_one_line(home, setup):
    # Where JAX computes: a push without its curves over time is NumPy's, which has 64 at any rate.
    words = ("simulate", setup, "--velocity-mm-min", 3000)
    assert run(home, *words, JAX_ENABLE_X64="0").returncode == 0
    done = run(home, *words, "--out", home / "out32", JAX_ENABLE_X64="0")
    assert done.returncode == 2 and "64-bit" in done.stderr
    assert not (home / "out32").exists()


def test_an_out_that_is_a_file_is_said_before_the_work(home, setup, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("kept")
    done = run(home, "simulate", setup, "--velocity-mm-min", 3000, "--out", blocked)
    assert done.returncode == 2 and "file is a file; --out needs a folder" in done.stderr
    assert blocked.read_text() == "kept"
