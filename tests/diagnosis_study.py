"""A study of diagnosis: random rigs with hidden effects, from files, started from rough set-ups.

    python -m tests.diagnosis_study [--only clean] [--cases 50] [--shard 1/2] [--results DIR]

Every case has a seed of its own, is made by `tests.hidden`, which shares no code with the library,
written to files, diagnosed from them, and appended as a line of JSON to DIR/CODE/GROUP.jsonl. What
is there already is not done again. `tests.diagnosis_figures` makes the figures.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests import diagnosis_figures as figures
from tests.hidden import case as cases
from tests.hidden import random_case, strength, write
from tests.hidden.outsiders import TABLE as OUTSIDERS
from tests.reference.effect_parameters import NULLS
from tests.study import RESULTS, code, prepare

EFFECTS = tuple(NULLS)
IN_RECORDINGS = tuple(e for e in EFFECTS if e not in cases.TABLE_ONLY and e != "normal_force")
TIMING = ("pusher_ripple", "force_lowpass", "force_highpass", "channel_skew", "presliding")
IN_TABLES = tuple(e for e in EFFECTS if e not in TIMING)
"""those that F_p and d show"""
HEAVIER = (1.0, 1.3)
"""Relative masses where a normal force is looked for."""


@dataclass(frozen=True)
class Group:
    """One part of the study: what is hidden in its cases."""

    seed: int
    count: int
    make: Callable
    """(case number, seed) -> case"""


def _turn(names: Sequence, i: int):
    return names[i % len(names)]


def _strong(strength: float, kind: str = cases.RECORDINGS, among=IN_RECORDINGS) -> Callable:
    def make(i, seed):
        effect = _turn(among, i)
        more = {"masses": HEAVIER} if effect == "normal_force" else {}
        if effect == "stribeck" and (i // len(among)) % 2:
            more["delta"] = 1.0
        if effect == "pusher_ramp" and (i // len(among)) % 2:
            more["s_curve"] = True
        return random_case(seed, effect, strength, kind=kind, **more)

    return make


def _counts(i, seed):
    """An effect that changes F_p or d by 3 % and more, among small ones of every other."""
    share = 0.03 * 4 ** np.random.default_rng(seed).uniform()
    return random_case(seed, _turn(IN_RECORDINGS, i), change=share, nuisances=True)


def _pair(i, seed):
    rng = np.random.default_rng([seed, 7])
    names = [e for e in IN_RECORDINGS if e != "presliding"]
    for attempt in range(20):
        pair = rng.choice(len(names), 2, replace=False)
        try:
            return random_case(seed + attempt, [names[k] for k in pair], strength=30.0)
        except ValueError:  # inseparable, or not to be scaled to that
            continue
    raise ValueError("no pair")


def _outsider(i, seed):
    return random_case(seed, _turn(tuple(OUTSIDERS), i), strength=40.0)


GROUPS = {
    "clean": Group(1, 1000, lambda i, seed: random_case(seed)),
    "clean tables": Group(2, 1000, lambda i, seed: random_case(seed, kind=cases.TABLE)),
    "s = 6": Group(3, 240, _strong(6.0)),
    "s = 10": Group(4, 240, _strong(10.0)),
    "s = 30": Group(5, 120, _strong(30.0)),
    "typical": Group(6, 240, lambda i, seed: random_case(seed, _turn(IN_RECORDINGS, i))),
    "tables": Group(7, 240, _strong(10.0, cases.TABLE, IN_TABLES)),
    "with nuisances": Group(8, 240, _counts),
    "pairs": Group(9, 200, _pair),
    "outsiders": Group(10, 150, _outsider),
}


def run_case(group: str, i: int, keep: Path | None = None) -> dict:
    """One case: what was hidden, and what the diagnosis says."""
    import difffric as df
    from difffric.setup_file import read_setup

    line: dict = {"group": group, "case": i}
    try:
        case = GROUPS[group].make(i, 100_000 * GROUPS[group].seed + i)
    except ValueError as error:
        return {**line, "skipped": str(error)}
    line |= {"kind": case.kind, "effects": dict(case.effects), "outsider": dict(case.outsider)}
    line["components"] = list(case.components)
    line["s"] = strength(case) if case.hidden else 0.0
    with tempfile.TemporaryDirectory() as empty:
        folder = keep or Path(empty)
        path = write(case, folder)
        setup, data = read_setup(folder / "setup.toml"), df.load(path)
        began = time.perf_counter()
        try:
            found = df.diagnose(setup, data, use_data_mass=len(case.masses) > 1)
        except (df.DifffricError, ArithmeticError, ValueError) as error:
            return {**line, "error": f"{type(error).__name__}: {error}"}
        line["seconds"] = time.perf_counter() - began
    return {**line, **found.as_dict()}


def load(folder: Path, group: str) -> list[dict]:
    """The lines of a group, in the order of the cases; a line cut short is left out."""
    path, lines = folder / f"{group}.jsonl", {}
    if path.exists():
        for text in path.read_text(encoding="utf-8").splitlines():
            try:
                line = json.loads(text)
            except json.JSONDecodeError:
                continue
            lines[line["case"]] = line
    return [lines[i] for i in sorted(lines)]


def run(group: str, folder: Path, count: int, shard: tuple[int, int] = (1, 1)) -> None:
    """Do the first cases of a group that are not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    there = {line["case"] for line in load(folder, group)}
    for i in range(count):
        if i in there or i % shard[1] != shard[0] - 1:
            continue
        line = run_case(group, i)
        with (folder / f"{group}.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        print(figures.told(line), file=sys.stderr, flush=True)


def main(words: Sequence[str] | None = None) -> int:
    """Run what is missing, print the figures, write the page."""
    parser = argparse.ArgumentParser(prog="python -m tests.diagnosis_study", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--only", choices=GROUPS, action="append", help="groups (default: all)")
    parser.add_argument("--cases", type=int, help="how many of each group (default: all)")
    parser.add_argument("--shard", default="1/1", help="i/n: the i-th of n processes")
    parser.add_argument("--results", type=Path, default=RESULTS / "diagnosis")
    asked = parser.parse_args(words)
    prepare()
    i, n = (int(x) for x in asked.shard.split("/"))
    folder = asked.results / code()
    for group in asked.only or GROUPS:
        run(group, folder, asked.cases or GROUPS[group].count, (i, n))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
