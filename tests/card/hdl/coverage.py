"""Which branches of the VHDL the core's tests take: `.venv/bin/python -m tests.card.hdl.coverage`.

GHDL's gcc code generator hands the VHDL to gcc, whose gcov then counts. What counts is each
executable line, and each condition of a line that begins with `if` or `elsif`, both ways; on other
lines gcov also sees GHDL's own checks, which must never fail.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

from tests.card.hdl.simulate import CORE_TESTS, SOURCES, TOP, call, run

BACKEND = {"GHDL_BACKEND": "gcc"}


@dataclass(frozen=True)
class Coverage:
    lines: int
    ways: int
    """of all conditions; each has two"""
    missed: frozenset[str]
    """file:line of what was not reached"""


def covered(folder: Path, only: str = "") -> Coverage:
    """Of all core tests, which must pass, or of those whose names hold `only`."""
    flags = "-Wc,-fprofile-arcs", "-Wc,-ftest-coverage"
    for source in SOURCES:
        call("ghdl", "-a", "--work=top", *flags, source, folder=folder, environment=BACKEND)
    link = "-Wl,-lgcov", "-Wl,--coverage"
    call("ghdl", "-e", "--work=top", *link, TOP, folder=folder, environment=BACKEND)
    chosen = BACKEND | ({"COCOTB_TEST_FILTER": only} if only else {})
    told = run(CORE_TESTS, folder, built=True, environment=chosen)
    if failed := [name for name, why in told.items() if why]:
        raise RuntimeError(f"failed under GHDL's gcc code generator: {failed}")
    lines, ways, missed = set(), 0, set()
    for source in SOURCES:
        code = source.read_text(encoding="utf-8").splitlines()
        for line in _counted(source, folder):
            number = line["line_number"]
            place = f"{source.name}:{number}"
            condition = code[number - 1].lstrip().startswith(("if ", "elsif "))
            counts = [way["count"] for way in line["branches"]] if condition else []
            lines.add(place)
            ways += len(counts)
            if 0 in (line["count"], *counts):
                missed.add(place)
    return Coverage(len(lines), ways, frozenset(missed))


def _counted(source: Path, folder: Path) -> list[dict]:
    data = source.with_suffix(".gcda").name
    options = "--json-format", "--branch-probabilities", "--stdout"
    (found,) = json.loads(call("gcov", *options, data, folder=folder, both=False))["files"]
    return found["lines"]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = covered(Path(folder))
    missed = ", ".join(sorted(found.missed)) or "none"
    print(f"{found.lines} lines, {found.ways} ways of the conditions; missed: {missed}")


if __name__ == "__main__":
    main()
