"""Watching processes that are killed at random moments, and what their state files hold.

One process is started, which imports all that it takes; each watch is a fork of it. What a push
says is read without the model here: the state is what is at stake.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from difffric.measurements.files import table_csv
from difffric.monitoring import feed as monitor_feed
from difffric.monitoring import monitor
from difffric.monitoring.readings import Reading
from difffric.rig.setup_toml import read_setup

assert table_csv  # imported here, not by each fork


class PlainReader:
    """mu_s in proportion to the force, whatever the speed."""

    noise_known = (True, True)

    def __init__(self, rig):
        self.rig = rig

    def read(self, pushes, expected=None) -> Reading:
        F, d = pushes.peak_force, pushes.sliding_distance
        error, sigma = np.full(1, 1e-3), np.array([[0.5, 3e-7]])
        return Reading(np.log(F / 1200), error, 1e3 * d - np.round(1e3 * d), sigma, [None])


def watch(table: Path, setup: Path, state: Path, told: int | None = None) -> dict:
    """Count a table's pushes, the state saved after each, a byte written to `told` for each; what
    the monitor then knows."""
    monitor.Reader = PlainReader
    monitor_feed._SAVED = -1.0
    feed = monitor_feed.Feed(read_setup(setup), state=state)
    if told is not None:
        feed.on_push = lambda seen: os.write(told, b".")
    feed.files([table])
    return feed.monitor.as_dict()


def killed(table: Path, setup: Path, state: Path, after: float) -> int:
    """Fork a watch, kill it so many seconds after its first push; how many pushes the state has."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read)
        watch(table, setup, state, write)
        os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as pushes:
        pushes.read(1)
        time.sleep(after)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    if not state.exists():
        return 0
    return json.loads(state.read_bytes())["body"]["monitor"]["count"]


def main(table: str, setup: str, folder: str, times: str) -> None:
    """Kills, then a run to the end, as JSON: counts after each, and whether it is one run."""
    draw, given, at = random.Random(1), (Path(table), Path(setup)), Path(folder)
    counts = [killed(*given, at / "killed.json", draw.uniform(0, 0.02)) for _ in range(int(times))]
    parts = watch(*given, at / "killed.json")
    whole = watch(*given, at / "whole.json")
    print(json.dumps([counts, parts == whole, (at / "killed.json").read_bytes()
                      == (at / "whole.json").read_bytes()]))  # fmt: skip


def kills(table: Path, setup: Path, folder: Path, times: int) -> tuple[list[int], bool, bool]:
    """The same, in a process of its own."""
    code = "import sys; from studies.monitoring_kills import main; main(*sys.argv[1:])"
    done = subprocess.run(
        [sys.executable, "-c", code, str(table), str(setup), str(folder), str(times)],
        cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return tuple(json.loads(done.stdout))
