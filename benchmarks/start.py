"""Each command as a whole process, with an empty cache and with a warm one, beside `import jax`.

    python -m benchmarks.start [--rounds 5] [--tree FOLDER] [COMMAND ...]

Times are by the clock and, in brackets, of all processors; warm ones are medians. × are the ratios
to `import jax`, which runs once before each process: with an empty cache, and warm. The memory is
the most that the process ever held, of its runs. `--tree` measures another checkout of this
repository: the state before a change.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from benchmarks.table import seconds

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
SETUP = str(EXAMPLES / "setup.toml")
TABLE, RECORDINGS = str(EXAMPLES / "pushes.csv"), str(EXAMPLES / "pushes.tdms")
COMMANDS = {
    "--help": ["--help"],
    "identify --help": ["identify", "--help"],
    "simulate": ["simulate", SETUP, "--velocity-mm-min", "3000"],
    "identify, a table": ["identify", TABLE, "--setup", SETUP],
    "identify, a table, --out": ["identify", TABLE, "--setup", SETUP, "--out", "out"],
    "identify, recordings": ["identify", RECORDINGS, "--setup", SETUP],
    "fit, a table": ["fit", TABLE, "--setup", SETUP],
    "fit, recordings": ["fit", RECORDINGS, "--setup", SETUP],
    "family": ["family", SETUP],
    "ring": ["ring", str(EXAMPLES / "ring.csv"), "--radius-mm", "60"],
    "plan": ["plan", SETUP, "--offset-um", "500"],
    "monitor": ["monitor", str(EXAMPLES / "watched.csv"), "--setup", SETUP, "--state", "state"],
    "acquire --simulate": ["acquire", "--simulate", SETUP, "--out", "out"],
    "diagnose, a table": ["diagnose", TABLE, "--setup", SETUP],
    "diagnose examples/hidden": [
        "diagnose",
        str(EXAMPLES / "hidden" / "pushes.tdms"),
        "--setup",
        str(EXAMPLES / "hidden" / "setup.toml"),
    ],
}
IMPORT_JAX = [sys.executable, "-c", "import jax"]


class Run(NamedTuple):
    """What one process took."""

    clock: float
    """seconds by the clock"""
    processors: float
    """seconds of all processors"""
    memory: float
    """the most that it held [bytes]"""


def timed(words: list[str], folder: Path, tree: Path = ROOT) -> Run:
    """A process with the caches of `folder`, of the library in `tree`."""
    environment = {n: x for n, x in os.environ.items() if not n.startswith(("JAX_", "DIFFFRIC_"))}
    environment["XDG_CACHE_HOME"] = str(folder / "cache")
    environment["PYTHONPATH"] = str(tree / "src")
    with tempfile.TemporaryFile() as told:
        start = time.perf_counter()
        process = subprocess.Popen(words, env=environment, cwd=folder, stdout=told, stderr=told)
        _, status, used = os.wait4(process.pid, 0)
        clock = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in (0, 3):  # 3: a monitor's alarm
            told.seek(0)
            raise SystemExit(f"{' '.join(words)}: {told.read().decode()}")
    return Run(clock, used.ru_utime + used.ru_stime, 1024.0 * used.ru_maxrss)


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--rounds", type=int, default=5)
    options.add_argument("--tree", type=Path, default=ROOT)
    options.add_argument("commands", nargs="*", metavar="COMMAND")
    given = options.parse_args()
    tree = given.tree.resolve()
    print("| command | empty cache | × | warm | × | memory |\n|" + " --- |" * 6)
    for name in given.commands or COMMANDS:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            words = [sys.executable, "-m", "difffric.commands.main", *COMMANDS[name]]
            timed(IMPORT_JAX, folder)  # its files are in memory from here on
            alone, warm = [timed(IMPORT_JAX, folder)], []
            first = timed(words, folder, tree)
            for k in range(given.rounds):
                for path in (*folder.glob("out*"), *folder.glob("state*")):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
                alone.append(timed(IMPORT_JAX, folder))
                warm.append(timed(words, folder, tree))
                if k and sum(run.clock for run in warm) > 60:
                    break
        clock, spent = (statistics.median(x) for x in list(zip(*warm, strict=True))[:2])
        unit = statistics.median(run.clock for run in alone)
        held = max(run.memory for run in (first, *warm))
        cells = (
            f"`{name}`",
            f"{seconds(first.clock)} ({seconds(first.processors)})",
            f"{first.clock / unit:.2g}",
            f"{seconds(clock)} ({seconds(spent)})",
            f"{clock / unit:.2f}",
            f"{held / 1e9:.2g} GB",
        )
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
