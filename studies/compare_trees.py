"""Hold what every command answers in two source trees against each other, to the last digit.

    python -m studies.compare_trees BEFORE [AFTER] [--only NAME ...] [--keep DIR]

BEFORE and AFTER (this tree, unless given) are checkouts of difffric. Each command runs on
`examples/` in both, and its `result.json` and the set-up that it writes are compared: only times
and versions may differ. Both trees read the examples of BEFORE. Answers lie in a folder for each
state of a tree's source, so that a tree that did not change is not run again. Exit status 1 where
anything differs.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path

import polars

ROOT = Path(__file__).parents[1]
SETUP, TABLE, RECORDINGS = (
    "{examples}/setup.toml",
    "{examples}/pushes.csv",
    "{examples}/pushes.tdms",
)
HIDDEN = "{examples}/hidden/pushes.tdms", "--setup", "{examples}/hidden/setup.toml"
COMMANDS = {
    "simulate": ["simulate", SETUP, "--velocity-mm-min", "3000"],
    "simulate slow": ["simulate", SETUP, "--velocity-mm-min", "500", "--stroke-mm", "2"],
    "family": ["family", SETUP],
    "check table": ["check", TABLE, "--setup", SETUP],
    "check recordings": ["check", RECORDINGS, "--setup", SETUP],
    "fit table": ["fit", TABLE, "--setup", SETUP, "--profile", "--next-push"],
    "fit recordings": ["fit", RECORDINGS, "--setup", SETUP],
    "fit slides": ["fit", "{examples}/slides.csv", "--setup", SETUP],
    "identify table": ["identify", TABLE, "--setup", SETUP],
    "identify recordings": ["identify", RECORDINGS, "--setup", SETUP],
    "identify slides": ["identify", "{examples}/slides.csv", "--setup", SETUP],
    "ring": ["ring", "{examples}/ring.csv", "--radius-mm", "60"],
    "plan": ["plan", SETUP, "--ring", "{examples}/ring.csv"],
    "centre": ["centre", SETUP, "--rings", "2"],
    "monitor": ["monitor", "{examples}/watched.csv", "--setup", SETUP],
    "export": ["export", SETUP],
    "acquire": ["acquire", "--simulate", SETUP, "--velocity-mm-min", "3000"],
    "diagnose table": ["diagnose", TABLE, "--setup", SETUP],
    "diagnose slides": ["diagnose", "{examples}/slides.csv", "--setup", SETUP],
    "diagnose hidden": ["diagnose", *HIDDEN],
    "paper": ["paper"],
    "identify fleet": ["identify", "{archive}"],
    "diagnose fleet": ["diagnose", "{archive}"],
}
OWN_TO_A_RUN = frozenset(
    ["answered_after_s", "date", "key", "seconds", "source", "version", "versions", "written"]
)
"""Keys of a result that say when, how long or with which version, and so differ between runs; `key`
is a fleet's digest of its files, of which their time is a part."""
ALARM = 3
"""Exit status of a monitor that found something."""


def entry_point(tree: Path) -> str:
    """The call that starts `difffric` as this tree's pyproject.toml has it."""
    with (tree / "pyproject.toml").open("rb") as file:
        module, _, function = tomllib.load(file)["project"]["scripts"]["difffric"].partition(":")
    return f"import sys; from {module} import {function} as main; sys.argv[0] = 'difffric'; main()"


def hash_source(tree: Path) -> str:
    """Ten digits that stand for the source of a tree's package."""
    digest = hashlib.sha256()
    package = tree / "src" / "difffric"
    for path in sorted(p for p in package.rglob("*") if p.suffix in (".py", ".csv", ".c", ".h")):
        digest.update(str(path.relative_to(package)).encode() + path.read_bytes())
    return digest.hexdigest()[:10]


def make_archive(folder: Path, examples: Path) -> None:
    """A fleet of two rigs from the examples, as `identify ARCHIVE` expects it."""
    for rig, data in (("one", "pushes.csv"), ("two", "slides.csv")):
        (folder / rig).mkdir(parents=True)
        shutil.copy(examples / "setup.toml", folder / rig)
        shutil.copy(examples / data, folder / rig)


def run(tree: Path, name: str, examples: Path, kept: Path) -> Path:
    """The folder with what a command answered in a tree; it runs where that is not there yet."""
    out = kept / hash_source(tree) / name.replace(" ", "_")
    if (out / "exit_status").exists():
        return out
    shutil.rmtree(out, ignore_errors=True)
    with tempfile.TemporaryDirectory() as temporary:
        places = {"examples": str(examples), "archive": f"{temporary}/archive"}
        if any("{archive}" in word for word in COMMANDS[name]):
            make_archive(Path(temporary, "archive"), examples)
        words = [word.format(**places) for word in COMMANDS[name]]
        environment = {k: x for k, x in os.environ.items() if not k.startswith("DIFFFRIC_")}
        environment |= {"PYTHONPATH": str(tree / "src")}
        done = subprocess.run(
            [sys.executable, "-c", entry_point(tree), *words, "--out", str(out)],
            env=environment,
            cwd=temporary,
            capture_output=True,
            text=True,
        )
    if done.returncode not in (0, ALARM):
        raise SystemExit(f"{tree}: difffric {' '.join(words)}: {done.stderr[-2000:]}")
    (out / "exit_status").write_text(str(done.returncode), encoding="utf-8")
    return out


def differences(before, after, path: str = "") -> Iterator[str]:
    """Where two answers differ, a line each; numbers count to the last digit."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted(before.keys() | after.keys()):
            if key in OWN_TO_A_RUN:
                continue
            if key not in before or key not in after:
                yield f"{path}/{key}: only {'after' if key in after else 'before'}"
            else:
                yield from differences(before[key], after[key], f"{path}/{key}")
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for k, pair in enumerate(zip(before, after, strict=True)):
            yield from differences(*pair, f"{path}/{k}")
    elif repr(before) != repr(after):  # so that one NaN is like another
        relative = ""
        if isinstance(before, float) and isinstance(after, float):
            scale = max(abs(before), abs(after), math.ulp(0.0))
            relative = f" (relative {abs(after - before) / scale:.1e})"
        yield f"{path}: {str(before)[:80]} became {str(after)[:80]}{relative}"


def read_answers(out: Path) -> dict:
    """All that a command wrote of numbers: results, and the set-up."""
    found: dict = {"exit_status": (out / "exit_status").read_text(encoding="utf-8")}
    for path in sorted(out.rglob("*.json")):
        found[str(path.relative_to(out))] = json.loads(path.read_text(encoding="utf-8"))
    for path in sorted(out.glob("pushes/*/*/*.parquet")):  # a fleet's data set, by rig and date
        table = polars.read_parquet(path, hive_partitioning=False).drop("date", strict=False)
        found[f"{path.parent.parent.name}/{path.name}"] = table.to_dict(as_series=False)
    for path in sorted(out.rglob("*.toml")):
        found[str(path.relative_to(out))] = tomllib.loads(path.read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Compare the trees named on the command line; exit status 1 where they differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path, nargs="?", default=ROOT)
    parser.add_argument("--only", choices=list(COMMANDS), action="append")
    parser.add_argument("--keep", type=Path, default=ROOT / ".study" / "trees")
    asked = parser.parse_args()
    examples = asked.before.resolve() / "examples"
    differing = 0
    for name in asked.only or COMMANDS:
        before, after = (
            read_answers(run(tree.resolve(), name, examples, asked.keep.resolve()))
            for tree in (asked.before, asked.after)
        )
        found = list(differences(before, after))
        differing += bool(found)
        print(f"{name}: {f'{len(found)} differences' if found else 'equal'}", flush=True)
        for line in found[:20]:
            print(f"    {line}")
    sys.exit(differing > 0)


if __name__ == "__main__":
    main()
