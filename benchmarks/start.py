"""Each command as a whole process, with an empty cache and with a warm one, beside `import jax`.

    python -m benchmarks.start [--rounds 5] [COMMAND ...]

Times are by the clock and, in brackets, of all processors; warm ones are medians, and × is their
ratio to `import jax`, which runs once before each of them.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import difffric
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
}
IMPORT_JAX = [sys.executable, "-c", "import jax"]


def timed(words: list[str], folder: Path) -> tuple[float, float]:
    """(seconds by the clock, seconds of processors) of a process."""
    environment = {n: x for n, x in os.environ.items() if not n.startswith(("JAX_", "DIFFFRIC_"))}
    environment["XDG_CACHE_HOME"] = str(folder / "cache")
    environment["PYTHONPATH"] = str(Path(difffric.__path__[0]).parent)
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(words, env=environment, cwd=folder, capture_output=True, text=True)
    clock, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode not in (0, 3):  # 3: a monitor's alarm
        raise SystemExit(f"{' '.join(words)}: {done.stderr}")
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return clock, spent


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--rounds", type=int, default=5)
    options.add_argument("commands", nargs="*", metavar="COMMAND")
    given = options.parse_args()
    print("| command | empty cache | warm | × `import jax` |\n| --- | --- | --- | --- |")
    for name in given.commands or COMMANDS:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            words = [sys.executable, "-m", "difffric.commands.main", *COMMANDS[name]]
            timed(IMPORT_JAX, folder)  # its files are in memory from here on
            first, warm, alone = timed(words, folder), [], []
            for k in range(given.rounds):
                for path in (*folder.glob("out/*"), *folder.glob("state*")):
                    path.unlink()
                alone.append(timed(IMPORT_JAX, folder))
                warm.append(timed(words, folder))
                if k and sum(clock for clock, _ in warm) > 60:
                    break
        clock, spent = (statistics.median(x) for x in zip(*warm, strict=True))
        ratio = clock / statistics.median(x for x, _ in alone)
        told = f"{seconds(first[0])} ({seconds(first[1])}) | {seconds(clock)} ({seconds(spent)})"
        print(f"| `{name}` | {told} | {ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main()
