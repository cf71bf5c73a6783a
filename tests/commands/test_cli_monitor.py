"""`difffric monitor` as a user types it: alarms, restarts, kills, a growing file, bad input."""

from __future__ import annotations

import json
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from difffric.commands import main
from difffric.measurements.files.tdms_reader import read_recordings
from difffric.measurements.files.tdms_writer import RecordingWriter, Waveform
from studies.monitoring_kills import kills
from tests.reference import files
from tests.reference.data import MM_MIN, Rig, make_pushes, measure, record

TRUE = Rig(m=18.9, mu_s=0.141, ratio=0.75, k_v=5.0, k=8e5, b=1500.0, scatter=0.015, stroke=1.2e-3)
SPEEDS = tuple(MM_MIN * v for v in (2000, 3000, 5000))
SETUP = """\
[part]
mass_kg = 18.9

[friction]
mu_s = 0.141
mu_s_scatter = 0.015
k_v_N_s_per_m = 8.0

[contact]
k_N_per_m = 8.0e5
b_N_s_per_m = 1500.0

[pusher]
stroke_mm = 1.2

[force_sensor]
noise_N = 0.5

[probe]
noise_um = 0.3
"""


class Done(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def run(monkeypatch, capfd):
    """A command line, in this process: exit status and what it said."""
    monkeypatch.setattr(main, "prepare_jax", lambda: None)  # tests/conftest.py has done it

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["difffric", "monitor", *map(str, arguments), "--quiet"])
        with pytest.raises(SystemExit) as stop:
            main.main()
        return Done(int(stop.value.code or 0), *capfd.readouterr())

    return run


def pushes(seed: int = 1):
    """60 as ever, then 20 with 10 % more friction."""
    rng = np.random.default_rng(seed)
    before = make_pushes(TRUE, rng, 60, SPEEDS)
    after = make_pushes(replace(TRUE, mu_s=1.1 * TRUE.mu_s), rng, 20, SPEEDS, first=61)
    return [*before, *after], rng


@pytest.fixture(scope="module")
def given(tmp_path_factory) -> Path:
    """A folder: a set-up, a table, its first 50 rows, and recordings of the first five pushes."""
    folder = tmp_path_factory.mktemp("monitor")
    (folder / "setup.toml").write_text(SETUP)
    made, rng = pushes()
    columns = measure(made, rng)
    files.write_table(folder / "all.csv", columns, digits=9)
    files.write_recordings(folder / "five.tdms", [record(p, rng) for p in made[:5]])
    return folder


def rows(given: Path, n: int, path: Path) -> Path:
    """The table's first n rows, as a file."""
    path.write_text("".join((given / "all.csv").read_text().splitlines(keepends=True)[: n + 1]))
    return path


def answer(folder: Path) -> dict:
    def refuse(word):
        raise AssertionError(f"{word} in result.json")

    return json.loads((folder / "result.json").read_text(), parse_constant=refuse)


def test_an_alarm_is_a_status_a_line_a_file_and_a_figure(run, given, tmp_path):
    done = run(given / "all.csv", "--setup", given / "setup.toml", "--out", tmp_path / "out")
    assert done.code == 3
    assert done.out.startswith("ALARM at push 6") and "friction +" in done.out
    found = answer(tmp_path / "out")
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "result.json", "report.html", "monitor.png",
    }  # fmt: skip
    alarm = found["alarms"][0]
    assert found["arl"] == 1000 and alarm["new"] and alarm["parameter"] == "mu_s"
    best = alarm["candidates"][0]
    assert abs(best["change"] - 0.1) < 4 * best["standard_error"]
    assert abs(alarm["change_point"] - 61) <= 2
    assert [x["alarm"] for x in found["pushes"]].index(True) + 1 == alarm["push"]
    above = [x["number"] for x in found["pushes"] if (x["evidence"] or 0) >= 1]
    assert above == [a["push"] for a in found["alarms"]]


def test_a_run_in_parts_is_one_run(run, given, tmp_path):
    """The second goes on where the first stopped, counts nothing twice, and says the same."""
    setup, state = given / "setup.toml", tmp_path / "state.json"
    run(given / "all.csv", "--setup", setup, "--out", tmp_path / "whole")
    part = rows(given, 30, tmp_path / "all.csv")
    first = run(part, "--setup", setup, "--state", state)
    assert first.code == 0 and first.out.startswith("There is no alarm in 30 pushes.")
    rows(given, 80, part)
    second = run(part, "--setup", setup, "--state", state, "--out", tmp_path / "parts")
    assert second.code == 3 and "30 recognised" in second.out
    whole, parts = answer(tmp_path / "whole"), answer(tmp_path / "parts")
    assert parts["pushes"] == whole["pushes"] and parts["alarms"] == whole["alarms"]
    assert (parts["counted_before"], parts["recognised"], parts["counted"]) == (30, 30, 80)
    kept = state.read_bytes()
    third = run(part, "--setup", setup, "--state", state)
    assert third.code == 0 and third.out.startswith("There is no alarm in 0 pushes.")
    assert state.read_bytes() == kept


def refused(done: Done, *words: str):
    assert done.code == 2 and done.err.count("\n") == 1 and done.out == ""
    for word in words:
        assert word in done.err


def test_states_that_cannot_be_gone_on_from_are_left_alone(run, given, tmp_path):
    setup, state = given / "setup.toml", tmp_path / "state.json"
    table = rows(given, 5, tmp_path / "five.csv")
    assert run(table, "--setup", setup, "--state", state).code == 0
    other = tmp_path / "other.toml"
    other.write_text(SETUP.replace("8.0e5", "8.1e5"))
    whole = state.read_bytes()
    refused(run(table, "--setup", other, "--state", state), "another set-up")
    refused(run(table, "--setup", setup, "--state", state, "--arl", "500"), "1000", "500")
    changed = tmp_path / "five.csv"
    lines = changed.read_text().splitlines(keepends=True)
    lines[3] = lines[3].replace("18.9", "18.91")
    changed.write_text("".join(lines))
    refused(run(changed, "--setup", setup, "--state", state), "first 5 pushes are not those")
    assert state.read_bytes() == whole
    for damage in (whole[:-20], whole.replace(b"0.", b"1.", 1), b"", b"[1, 2]", b"\xff\xfe"):
        state.write_bytes(damage)
        refused(run(table, "--setup", setup, "--state", state), "state", "left as it is")
        assert state.read_bytes() == damage
    state.write_bytes(whole.replace(b'"difffric_monitor": 1', b'"difffric_monitor": 9'))
    refused(run(table, "--setup", setup, "--state", state), "version 9, expected 1")


def test_pushes_that_are_out_of_order_or_repeated_are_refused(run, given, tmp_path):
    setup = given / "setup.toml"
    lines = (given / "all.csv").read_text().splitlines(keepends=True)
    bad, state = tmp_path / "bad.csv", tmp_path / "state.json"

    def of(*which):
        bad.write_text("".join(lines[i] for i in (0, *which)))
        done = run(bad, "--setup", setup, "--state", state)
        assert not state.exists()
        return done

    refused(of(1, 3, 2), "push 3", "its order is 2 after 3")
    refused(of(1, 2, 2), "push 3", "its order is 2 after 2")
    refused(of(), "no rows below the header")
    orderless = [",".join(c for i, c in enumerate(x.split(",")) if i != 6) for x in lines]
    bad.write_text("".join(orderless[i] for i in (0, 1, 2, 1)))
    refused(run(bad, "--setup", setup), "push 3", "the same push twice")
    copy = rows(given, 4, tmp_path / "copy.csv")
    once = rows(given, 4, tmp_path / "once.csv")
    refused(run(once, copy, "--setup", setup), "copy.csv", "the same push twice")
    refused(run(once, "--setup", setup, "--arl", "3"), "--arl: expected at least 20")
    refused(run(once, "--setup", setup, "--follow"), "--follow: expected a .tdms")
    refused(run(once, once, "--setup", setup, "--follow"), "--follow: expected one .tdms")


def test_a_table_and_recordings_go_one_after_the_other(run, given, tmp_path):
    setup, table = given / "setup.toml", rows(given, 6, tmp_path / "six.csv")
    done = run(table, given / "five.tdms", "--setup", setup, "--out", tmp_path / "out")
    found = answer(tmp_path / "out")
    assert done.code == 0 and [x["source"] for x in found["pushes"]] == 6 * ["six.csv"] + 5 * [
        "five.tdms"
    ]
    truth = [p.mu_s for p in pushes()[0][:5]]
    for seen, mu_s in zip(found["pushes"][6:], truth, strict=True):
        assert seen["mu_s"]["value"] == pytest.approx(mu_s, rel=0.02)  # k_v is 8 there, not 5


def test_a_recording_is_followed_while_it_is_written(run, given, tmp_path):
    """As `acquire` writes it: no push is taken before it is complete, each once."""
    path, source = tmp_path / "pushes.tdms", read_recordings(given / "five.tdms")
    setup, state = given / "setup.toml", tmp_path / "state.json"

    def write():
        writer = RecordingWriter(path)
        for push in source:
            channels = {
                name: Waveform(unit, channel.dt, channel.start)
                for name, unit in (("force", "N"), ("position", "m"))
                if (channel := getattr(push, name))
            }
            said = {"velocity_mm_min": push.velocity / MM_MIN, "order": push.order}
            assert push.force and push.position
            force, position = push.force.samples, push.position.samples
            writer.begin(push.name, channels, **said)
            for part in np.array_split(np.arange(len(force)), 3):
                writer.append(force=force[part], position=position[part])
                time.sleep(0.15)
            writer.end()
        writer.close()

    thread = threading.Thread(target=write)
    thread.start()
    done = run(path, "--setup", setup, "--state", state, "--follow", "--idle-s", "6",
               "--out", tmp_path / "followed")  # fmt: skip
    thread.join()
    assert done.code == 0
    run(path, "--setup", setup, "--out", tmp_path / "read")
    followed, read = answer(tmp_path / "followed"), answer(tmp_path / "read")
    assert followed["pushes"] == read["pushes"] and len(read["pushes"]) == 5
    again = run(path, "--setup", setup, "--state", state)
    assert "5 recognised" in again.out


@pytest.mark.parametrize("times", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_a_kill_at_any_moment_loses_nothing(given, tmp_path, times):
    """kill -9 at random moments, gone on from each time: one run, to the last bit of the state."""
    table = rows(given, 80, tmp_path / "all.csv")
    counts, same, same_file = kills(table, given / "setup.toml", tmp_path, times)
    assert counts == sorted(counts) and len({x for x in counts if 0 < x < 80}) > 1
    assert same and same_file
