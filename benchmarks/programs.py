"""What each compiled program of a command costs, with an empty store and with a warm one.

    python -m benchmarks.programs [--tree FOLDER] [COMMAND ...]

Prints a Markdown table a command: seconds by the clock to trace, compile, load and run each
program, and its size; before it those of the whole process. COMMAND is a name of
`benchmarks.start`. Programs that are made in threads of their own take their time beside others.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.start import COMMANDS, ROOT
from difffric.compute.programs import record
from difffric.compute.programs.record import Record

HEAD = "| program | traced s | compiled s | MB | loaded s | calls | run s |\n|" + " --- |" * 7
DEFAULT = ("fit, a table", "plan", "diagnose examples/hidden")


def run(words: list[str], folder: Path, tree: Path) -> tuple[list[Record], float]:
    """The programs of one process with the caches of `folder`, and its time [s]."""
    told = folder / "programs.jsonl"
    told.unlink(missing_ok=True)
    environment = {n: x for n, x in os.environ.items() if not n.startswith(("JAX_", "DIFFFRIC_"))}
    environment |= {
        "XDG_CACHE_HOME": str(folder / "cache"),
        "PYTHONPATH": str(tree / "src"),
        record.FILE: str(told),
    }
    for path in (*folder.glob("out*"), *folder.glob("state*")):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    start = time.perf_counter()
    call = [sys.executable, "-m", "difffric.commands.main", *words]
    done = subprocess.run(call, env=environment, cwd=folder, capture_output=True, text=True)
    clock = time.perf_counter() - start
    if done.returncode not in (0, 3):  # 3: a monitor's alarm
        raise SystemExit(f"{' '.join(words)}: {done.stderr}")
    return (record.read(told) if told.exists() else []), clock


def format_record(one: Record) -> str:
    """A program's row of the table."""
    numbers = (one.traced, one.compiled, 1e-6 * one.size, one.loaded)
    cells = [*(f"{x:.2f}" for x in numbers), f"{one.runs}", f"{one.ran:.2f}"]
    return f"| `{one.name.removeprefix('difffric.')}` | {' | '.join(cells)} |"


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--tree", type=Path, default=ROOT)
    options.add_argument("commands", nargs="*", metavar="COMMAND")
    given = options.parse_args()
    for name in given.commands or DEFAULT:
        with tempfile.TemporaryDirectory() as place:
            for state in ("an empty store", "a warm one"):
                found, clock = run(COMMANDS[name], Path(place), given.tree.resolve())
                print(f"\n`{name}`, {state}: {clock:.1f} s\n\n{HEAD}")
                print("\n".join(map(format_record, found)), flush=True)


if __name__ == "__main__":
    main()
