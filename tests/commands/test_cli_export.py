"""`difffric ring` and `difffric export` as a user types them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.commands.test_cli import home, run, setup

EXAMPLES = Path(__file__).parents[2] / "examples"
__all__ = ["home", "setup"]  # fixtures


def test_ring_writes_its_answer(home, tmp_path):
    out = tmp_path / "out"
    done = run(home, "ring", EXAMPLES / "ring.csv", "--noise-um", 0.3, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "towards the probe" in done.stdout
    assert sorted(p.name for p in out.iterdir()) == ["report.html", "result.json", "ring.png"]
    answer = json.loads((out / "result.json").read_text())
    truth = json.loads((EXAMPLES / "truth.json").read_text())["ring"]
    off = answer["offset_m"] - 1e-6 * truth["offset_um"]
    assert abs(off) < 4 * answer["offset_standard_error_m"]
    assert 0.7 < answer["reduced_chi2"] < 1.3


def test_export_writes_what_a_controller_needs(home, setup, tmp_path):
    out = tmp_path / "out"
    done = run(home, "export", setup, "--slowest-mm-min", 3000, "--out", out)
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in out.iterdir()) == [
        "golden.csv", "predictor.c", "predictor.h", "predictor.json", "predictor.png",
        "report.html", "result.json",
    ]  # fmt: skip
    answer = json.loads((out / "result.json").read_text())
    assert answer["proof"] == "bounded" and max(answer["bound"].values()) <= 0.005
    assert answer["random_pushes"] == 1_000_000 and max(answer["worst"].values()) <= 0.005


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["export", "SETUP"], "give --out DIR"),
        (["export", "SETUP", "--out", "/proc/x"], "cannot write here"),
        (["export", "SETUP", "--out", "OUT", "--slowest-mm-min", "6000"], "the box is empty"),
        (["export", "SETUP", "--out", "OUT", "--max-error", "2"], "max_error: expected a share"),
        (["export", "SETUP", "--out", "OUT", "--least-mu-s", "-1"], "--least-mu-s: expected"),
        (["export", "SETUP", "--out", "OUT", "--no-stroke", "--stroke-mm", "1"], "one of them"),
        (["ring", "gone.csv"], "gone.csv: no such file"),
        (["ring", "SETUP"], "expected the columns angle_deg"),
        (["ring", "RING", "--noise-um", "0"], "--noise-um: expected a number > 0"),
        (["ring", "RING", "--form-um", "-1"], "--form-um: expected a number >= 0"),
        (["ring", "THREE"], "3 usable readings; expected at least 4"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(home, setup, tmp_path, arguments, said):
    (tmp_path / "three.csv").write_text("angle_deg,radius_mm\n0,50\n120,50\n240,50\n")
    places = {
        "SETUP": setup, "OUT": tmp_path / "out", "RING": EXAMPLES / "ring.csv",
        "THREE": tmp_path / "three.csv",
    }  # fmt: skip
    done = run(home, *(places.get(x, x) for x in arguments))
    assert done.returncode == 2 and not done.stdout
    assert said in done.stderr and len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_an_error_out_of_reach_is_no_bad_input(home, setup, tmp_path):
    done = run(home, "export", setup, "--max-error", "1e-9", "--slowest-mm-min", 4900, "--out",
               tmp_path / "out")  # fmt: skip
    assert done.returncode == 1 and "was reached; allow more" in done.stderr
    assert not (tmp_path / "out").exists()
