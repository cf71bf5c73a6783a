"""Studies that are stopped and go on: a line of JSON a case, in a folder for each state of the
source, and their figures between two marks of a page."""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / ".study"
KEPT = ROOT / "studies" / "results"
"""Where cases are kept with the source, so that a study of a day can be done in parts."""


def code(simulator: str, rooms: Sequence[str] | None = None) -> str:
    """Ten digits that stand for the source of the library and of a simulator (of tests).

    `rooms` are the packages of the library that count, beside the modules in none; by default all.
    Only what a program does counts: a comment, a docstring or a line broken elsewhere is no reason
    to do a study of a day again.
    """
    digest = hashlib.sha256()
    for folder in (ROOT / "src" / "difffric", ROOT / "tests" / simulator):
        for path in sorted(folder.rglob("*.py")):
            inner = path.relative_to(folder)
            of_library = folder.name == "difffric" and len(inner.parts) > 1
            if rooms is not None and of_library and inner.parts[0] not in rooms:
                continue
            digest.update((str(inner) + strip_words(path.read_text("utf-8"))).encode())
    return digest.hexdigest()[:10]


def strip_words(source: str) -> str:
    """The program without its comments, its docstrings and its line breaks."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [one for one in node.body if not _is_docstring(one)]
    return ast.unparse(tree)


def _is_docstring(one: ast.stmt) -> bool:
    """Whether a statement is a string by itself, as what describes a constant is too."""
    if not isinstance(one, ast.Expr) or not isinstance(one.value, ast.Constant):
        return False
    return isinstance(one.value.value, str)


def load(folder: Path, name: str) -> list[dict]:
    """The lines of one part, in the order of the cases; a line cut short is left out."""
    path, lines = folder / f"{name}.jsonl", {}
    if path.exists():
        for text in path.read_text(encoding="utf-8").splitlines():
            try:
                line = json.loads(text)
            except json.JSONDecodeError:
                continue
            lines[line["case"]] = line
    return [lines[case] for case in sorted(lines)]


def add_missing(
    source: Path, target: Path, change: Callable[[dict], dict] = lambda line: line
) -> None:
    """Add to the lines of every part in `target` those of `source` that it has not, changed."""
    for path in sorted(source.glob("*.jsonl")):
        target.mkdir(parents=True, exist_ok=True)
        there = {line["case"] for line in load(target, path.stem)}
        for line in load(source, path.stem):
            if line["case"] not in there:
                _append(target / path.name, json.dumps(change(line), allow_nan=True))


def run(
    name: str,
    folder: Path,
    cases: int,
    one: Callable[[int], dict],
    shard: tuple[int, int] = (1, 1),
    told: Callable[[dict], str] | None = None,
) -> None:
    """Do the first `cases` of a part that are not there yet; `told` says a line of each."""
    folder.mkdir(parents=True, exist_ok=True)
    there = {line["case"] for line in load(folder, name)}
    todo = [i for i in range(cases) if i not in there and i % shard[1] == shard[0] - 1]
    began = time.perf_counter()
    for done, case in enumerate(todo, 1):
        line = one(case)
        _append(folder / f"{name}.jsonl", json.dumps(line, allow_nan=True))
        each = (time.perf_counter() - began) / done
        left = each * (len(todo) - done) / 60
        if told is not None:
            print(told(line), file=sys.stderr)
        say = f"\r{name}: {done} of {len(todo)}, {each:.1f} s each, {left:.0f} min left "
        print(say, end="", file=sys.stderr, flush=True)
    if todo:
        print(file=sys.stderr)


def take_turns(sizes: Mapping[str, int], rounds: int) -> Iterator[tuple[str, int]]:
    """The parts in turn, `rounds` times, each with the number of its first cases to do by then: a
    study that is stopped has the same share of each."""
    for turn in range(1, rounds + 1):
        for part, cases in sizes.items():
            yield part, -(-cases * turn // rounds)


def _append(path: Path, line: str) -> None:
    """On a line of its own, whatever became of the last one."""
    cut = path.exists() and path.read_bytes()[-1:] not in (b"", b"\n")
    with path.open("a", encoding="utf-8") as file:
        file.write("\n" * cut + line + "\n")


def into(page: str, text: str, mark: str = "study") -> str:
    """The page with the text between its marks; they are added at its end where missing."""
    start, end = f"<!-- {mark}:start -->", f"<!-- {mark}:end -->"
    block = f"{start}\n{text}\n{end}"
    marked = re.compile(re.escape(start) + ".*?" + re.escape(end), re.DOTALL)
    if marked.search(page):
        return marked.sub(lambda _: block, page)
    return f"{page.rstrip()}\n\n{block}\n".lstrip()


def write_into(page: Path, text: str, mark: str = "study") -> None:
    """The same, of a file."""
    before = page.read_text(encoding="utf-8") if page.exists() else ""
    page.write_text(into(before, text, mark), encoding="utf-8")


def pick_core(shard: tuple[int, int], cores: Sequence[int]) -> set[int]:
    """The cores for the i-th of n processes: one of its own, or all where it is alone."""
    i, n = shard
    return {sorted(cores)[(i - 1) % len(cores)]} if n > 1 else set(cores)


def prepare(shard: tuple[int, int] = (1, 1)) -> None:
    """Compiled programs are stored, as the tests' are, and a failed step is a NaN, which the fit
    takes as a refusal. Before JAX is imported.

    One of several processes keeps to a core: XLA's threads wait for each other by counting, which
    takes a tenth of the time of two processes on two cores.
    """
    if hasattr(os, "sched_setaffinity"):  # Linux
        os.sched_setaffinity(0, pick_core(shard, list(os.sched_getaffinity(0))))
    from tests import conftest  # 64 bits, and the store of compiled programs

    assert conftest.CACHE
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    import jax  # which another module of a study may have imported already

    jax.config.update("jax_enable_x64", True)


def arguments(
    program: str, text: str, parts: Sequence[str], page: Path, words: Sequence[str] | None
) -> tuple[argparse.Namespace, tuple[int, int]]:
    """The command line, and the shard."""
    parser = argparse.ArgumentParser(prog=f"python -m {program}", description=text)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--only", choices=parts, action="append", help="parts (default: all)")
    parser.add_argument("--cases", type=int, help="how many of each part (default: all)")
    parser.add_argument("--rounds", type=int, default=1, help="the parts take turns so often")
    parser.add_argument("--shard", default="1/1", help="i/n: the i-th of n processes")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--page", type=Path, default=page)
    parser.add_argument("--keep", action="store_true", help="keep the cases with the source")
    asked = parser.parse_args(words)
    if asked.rounds < 1:
        parser.error(f"argument --rounds: expected 1 or more, got {asked.rounds}")
    i, n = (int(x) for x in asked.shard.split("/"))
    return asked, (i, n)
