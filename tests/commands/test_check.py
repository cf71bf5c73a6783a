"""`difffric check`: what it says of the examples is what the library says; it fits nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import difffric as df
from tests.commands.variants import EXAMPLES, Table, V

SETUP = EXAMPLES / "setup.toml"


def read_answer(folder: Path) -> dict:
    return json.loads((folder / "result.json").read_text())


def test_recordings_are_shown_as_the_library_reduces_them(run, tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("check fits nothing")

    monkeypatch.setattr("difffric.calibration.calibrate.fit", refuse)
    out = tmp_path / "out"
    code, said, _ = run("check", EXAMPLES / "pushes.tdms", "--setup", SETUP, "--out", out)
    assert code == 0 and "14 recordings at 7 speeds from 600 to 5000 mm/min" in said
    typed = f"  difffric fit {EXAMPLES / 'pushes.tdms'} --setup {SETUP} --out DIR\n"
    assert said.endswith(
        f"Then calibrate: difffric fit takes the same data and the same set-up.\n{typed}"
    )
    assert "landmarks right?" in " ".join(said.split())
    answer = read_answer(out)
    reduction = df.measurements.reduce_recordings(df.load(EXAMPLES / "pushes.tdms"))
    for row, F, d, one in zip(
        answer["pushes"],
        reduction.pushes.peak_force,
        reduction.pushes.sliding_distance,
        reduction.details,
        strict=True,
    ):
        assert (row["peak_force_N"], row["sliding_distance_m"]) == (F, d)
        assert row["rest_time_s"] == one.rest_time > row["release_time_s"] > row["peak_time_s"]
    assert answer["noise"]["force"]["level"] == pytest.approx(0.5, rel=0.05)
    assert answer["kind"] == "recordings"
    assert (out / "traces.png").exists() and (out / "measured.png").exists()


def test_what_the_data_can_determine_is_what_the_library_expects(run, tmp_path):
    out = tmp_path / "out"
    code, said, _ = run("check", EXAMPLES / "pushes.csv", "--setup", SETUP, "--out", out)
    assert code == 0 and "Next: Look at the figure: are these the pushes" in said
    assert "landmarks" not in said  # a table has none
    expected = df.calibration.identifiable(df.read_setup(SETUP), df.load(EXAMPLES / "pushes.csv"))
    assert read_answer(out)["determines"] == json.loads(json.dumps(expected.as_dict()))


def test_what_one_speed_leaves_open_is_said_before_a_fit(run, tmp_path):
    data = Table().write(tmp_path / "pushes.csv")
    rows = data.read_text().splitlines()
    data.write_text("\n".join([rows[0], *(r for r in rows if r.startswith("5000.0,"))]) + "\n")
    assert "figure" not in run("check", data, "--setup", SETUP)[1]
    code, said, _ = run("check", data, "--setup", SETUP, "--out", tmp_path / "out")
    answer = read_answer(tmp_path / "out")
    open_ = {name for x in answer["determines"]["not_identifiable"] for name in x["parameters"]}
    assert code == 0 and open_ and all(name in said for name in open_)
    assert "Not determined by these data" in said
    assert np.isclose(answer["pushes"][0]["velocity_m_per_s"], 5000e-3 / 60)


def test_wrong_units_are_said_by_check_too(run, tmp_path):
    data = Table(units={V: "m/s"}).write(tmp_path / "pushes.csv")
    code, _, said = run("check", data, "--setup", SETUP, "--out", tmp_path / "out")
    assert code == 2 and "speeds look like m/s" in said.splitlines()[0]
    assert not (tmp_path / "out").exists()
