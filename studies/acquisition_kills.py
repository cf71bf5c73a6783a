"""Recording processes that are killed at random moments, and what their files hold.

One process is started, which imports all that it takes; each recording is a fork of it.
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
from nptdms import TdmsFile

from difffric.measurements.files.tdms_reader import read_recordings

RATE = 2_000_000
PUSH = 250_000  # samples: two segments and a half


def words() -> tuple[np.ndarray, np.ndarray]:
    """What each push plays."""
    i = np.arange(PUSH)
    return (7919 * i) % 20_011 - 10_000, (104_729 * i) % 1_000_003 - 500_000


def recording(path: str, told: int) -> None:
    """Record pushes without end, and write to `told` how many samples have been flushed."""
    from difffric.acquisition import stream
    from difffric.acquisition.push import Command
    from difffric.acquisition.recorder import acquire
    from fpga.emulator.emulator import emulated_card

    add, flushed = stream._PushWriter.add, [0]

    def add_and_tell(push, force, count):
        add(push, force, count)
        flushed[0] += len(force)
        os.write(told, b"%d\n" % flushed[0])

    stream._PushWriter.add = add_and_tell
    with emulated_card(rate=RATE, real=True) as card:
        for _ in range(100):
            card.add_push(*words())
        with card.open() as session:
            acquire(session, 100 * [Command(0.05, 2e-3)], path)


def killed(path: str, early: bool, after: float) -> int:
    """Fork a recording, kill it so many seconds after it began (`early`) or had flushed its first
    segment; how many samples it had flushed by then."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read)
        recording(path, write)
        os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as lines:
        first = b"" if early else lines.readline()
        time.sleep(after)
        os.kill(child, signal.SIGKILL)
        assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
        said = (first + lines.read()).splitlines()
    return int(said[-1]) if said else 0


def kills(folder: Path, times: int, seed: int) -> None:
    """Every file opens, by this library and by npTDMS with the index, and lacks no sample that was
    flushed."""
    code = "import sys; from studies.acquisition_kills import main; main(*sys.argv[1:])"
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder), str(times), str(seed)],
        cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    flushed = json.loads(done.stdout)
    assert len(flushed) == times and max(flushed) > 0
    for i, n in enumerate(flushed):
        path = folder / f"{i}.tdms"
        if not n and not (path.exists() and path.stat().st_size):
            continue  # killed before the first segment
        checked(path, n)


def checked(path: Path, flushed: int) -> None:
    """A file against what was played and told."""
    force, count = words()
    pushes, whole = read_recordings(path), TdmsFile.read(path)
    kept = [(p.force.n, p.position.n) for p in pushes if p.force and p.position]
    assert sum(n for n, _ in kept) >= flushed
    assert sum(len(group["force"]) for group in whole.groups() if "force" in group) >= flushed
    for push, (n, m) in zip(pushes, kept, strict=True):
        assert n == m <= PUSH
        assert np.array_equal(np.rint(push.force.samples * 2**15 / 10), force[:n])
        assert np.array_equal(np.rint(push.position.samples / 2e-8), count[:n])
    complete = [group.properties["complete"] for group in whole.groups()]
    assert complete == sorted(complete, reverse=True) and complete.count(False) <= 1


def main(folder: str, times: str, seed: str) -> None:
    """All recordings and kills; how much each had flushed, as JSON."""
    from fpga.emulator.emulator import build

    build()
    draw = random.Random(int(seed))
    found = [
        killed(f"{folder}/{i}.tdms", i % 5 == 4, draw.uniform(0, 0.4)) for i in range(int(times))
    ]
    print(json.dumps(found))
