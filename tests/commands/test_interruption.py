"""Ctrl-C at any moment: the command ends soon, says what is known, and leaves folders as they were.

A compiler or a compiled program does not come back to Python for minutes. What stands for them here
is one product of two large matrices, which does not either, and in one test a program that XLA
really compiles.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from difffric.commands.running import interruption

EXAMPLES = Path(__file__).parents[2] / "examples"
SETUP = EXAMPLES / "setup.toml"
TABLE = ("identify", EXAMPLES / "pushes.csv", "--setup", SETUP, "--quiet")
SOON = 20.0
"""How long [s] a process may take to end: a second, on a machine of which it gets a twentieth."""

PATIENT = 300.0
"""How long [s] a command may take to come to the moment at which it is stopped."""

DRIVER = """
import sys, threading, time
import numpy as np

def busy():  # in compiled code, which no signal brings back
    print("now", flush=True)
    a = np.ones((30000, 3000))
    while True:
        a.T @ a

def run(): # a command, stopped at one of its moments
    moment = sys.argv.pop(1)
    if moment == "reading":
        from difffric.measurements import load_file
        load_file.load = lambda *a, **k: busy()
    if moment == "joining":  # another thread compiles, and the main thread waits for it at the end
        from difffric.measurements import load_file
        def join(*a, **k):
            beside = threading.Thread(target=busy)
            beside.start()
            try:
                time.sleep(1000)
            finally:
                beside.join()
        load_file.load = join
    if moment == "running":
        from difffric.commands import reports
        reports.identify.describe_friction = lambda *a: busy()
    if moment == "fitting":
        from difffric.identification import whole_recording
        whole_recording.fit_recordings = lambda *a: busy()
    if moment == "writing":
        from pathlib import Path
        written = Path.write_bytes
        def write_one(path, content):
            written(path, content)
            if path.name == "report.html":
                busy()
        Path.write_bytes = write_one
    if moment == "placing":
        import os
        placed = os.replace
        def place(a, b):
            placed(a, b)
            if str(b).endswith("report.html"):
                print("now", flush=True)
                time.sleep(3)
        os.replace = place
    if moment == "compiling":
        from difffric.compute.programs.record import UNDER_WAY
        def look():
            while not UNDER_WAY:
                time.sleep(0.05)
            print("now", flush=True)
        threading.Thread(target=look, daemon=True).start()
    from difffric.commands.main import main
    main()

run()
"""


def stop(moment, *words, cache):
    """Start a command, send it Ctrl-C at that moment, and return how it ended: exit status, its
    standard error, and the seconds that it took from then."""
    call = [sys.executable, "-c", DRIVER, moment, *map(str, words)]
    process = subprocess.Popen(
        call,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={
            **os.environ,
            "XDG_CACHE_HOME": str(cache),
            "DIFFFRIC_PROGRAMS": str(cache / "programs"),
            "JAX_COMPILATION_CACHE_DIR": str(cache / "jax"),
        },
        # Where the tests run in the background a shell has them ignore it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    guard = threading.Timer(PATIENT, process.kill)  # so that no fault keeps a busy process
    guard.start()
    try:
        assert process.stdout is not None
        # What the command prints before that moment comes first.
        assert "now\n" in iter(process.stdout.readline, ""), process.communicate()[1]
        sent = time.monotonic()
        process.send_signal(signal.SIGINT)
        error = process.communicate(timeout=SOON)[1]
        return process.returncode, error, time.monotonic() - sent
    finally:
        guard.cancel()
        process.kill()


def read_folder(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no such signal to one process")
@pytest.mark.parametrize("moment", ["reading", "joining", "running", "writing"])
@pytest.mark.parametrize("is_new", [True, False], ids=["new folder", "old folder"])
def test_ctrl_c_leaves_the_folder_as_it_was(moment, is_new, tmp_path):
    home = tmp_path / "home"
    out = home / "out"
    home.mkdir()
    if not is_new:
        out.mkdir()
        (out / "result.json").write_text("an earlier answer")
        (out / "mine.txt").write_text("the user's")
    before = read_folder(home)
    status, error, seconds = stop(moment, *TABLE, "--out", out, cache=tmp_path / "cache")
    print(f"ended after {seconds:.2f} s")
    assert status == 130, error
    assert error.startswith("difffric: stopped by Ctrl-C after ") and "Traceback" not in error
    assert f"{out} is as it was before" in error
    assert read_folder(home) == before and out.exists() is not is_new
    assert [p.name for p in home.rglob(".*")] == []


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no such signal to one process")
def test_a_folder_whose_files_take_their_places_is_written_whole(tmp_path):
    out = tmp_path / "out"
    status, error, _ = stop("placing", *TABLE, "--out", out, cache=tmp_path / "cache")
    assert status in (0, 130), error
    json.loads((out / "result.json").read_text())
    assert {"result.json", "report.html"} < {p.name for p in out.iterdir()}
    assert not [p for p in out.iterdir() if p.name.startswith(".") or p.is_dir()]


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no such signal to one process")
def test_ctrl_c_while_xla_compiles(tmp_path):
    data, setup = (EXAMPLES / "hidden" / name for name in ("pushes.tdms", "setup.toml"))
    words = ("diagnose", data, "--setup", setup, "--out", tmp_path / "out")
    status, error, seconds = stop("compiling", *words, cache=tmp_path / "cache")
    print(f"ended after {seconds:.2f} s")
    assert status == 130 and "Traceback" not in error, error
    assert not (tmp_path / "out").exists()
    left = [p.name for p in (tmp_path / "cache" / "programs").rglob("*") if p.is_file()]
    assert [name for name in left if not name.endswith(".lock")] == []


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no such signal to one process")
def test_what_is_known_by_then_is_told_and_lies_beside_the_folder(tmp_path):
    out, beside = tmp_path / "out", tmp_path / "out.partial.json"
    words = ("identify", EXAMPLES / "pushes.tdms", "--setup", SETUP, "--out", out, "--quiet")
    status, error, _ = stop("fitting", *words, cache=tmp_path / "cache")
    assert status == 130, error
    assert "known so far, mu_s by force and distance: 0.1" in error
    assert f"written to {beside}" in error and not out.exists()
    known = json.loads(beside.read_text())
    assert known["partial"] is True and known["command"] == "identify"
    assert known["stopped_at"] == "fitting every sample"
    rows = known["known"]["mu_s by force and distance"]
    assert all(row["mu_s_force"]["value"] > 0 for row in rows)


def test_a_whole_answer_takes_away_what_was_known_before(run, tmp_path):
    beside = tmp_path / "out.partial.json"
    beside.write_text("{}")
    assert run(*TABLE, "--out", tmp_path / "out")[0] == 0
    assert not beside.exists() and (tmp_path / "out" / "result.json").exists()


def test_ctrl_c_ends_what_is_to_go_on_until_then(monkeypatch):
    """As `monitor --follow`: the command goes on with what comes after, and ends as usual."""
    command, ended = interruption.RunningCommand(), []
    monkeypatch.setattr(command, "end", lambda: ended.append(True))
    monkeypatch.setattr(interruption, "_PATIENCE", 0.05)
    command.begin(["monitor"])
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with command.watch():
            with command.end_by_ctrl_c():
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(10)
            time.sleep(0.5)
        assert ended == [] and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
