"""The VHDL with one thing changed at a time: what the core's tests must notice.

A branch that is reached may still go unnoticed; a branch, an operator or an assignment whose change
fails a test does not.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from tests.card.hdl.simulate import SOURCES

CHANGES = [
    (r"\b(?:els)?if (?!rising_edge)(.*?) then", ("false", "true")),  # the condition
    (r"\band\b", ("or",)),
    (r"\bor\b", ("and",)),
    (r"\bxor\b", ("and",)),
    (r"\bnot\b", ("",)),
    (r" (>=) ", (">",)),
    (r" (>) ", (">=",)),
    (r"(?<=word) (<) ", ("<=",)),
    (r" (\+) ", ("-",)),
    (r" (-) 1", ("+",)),
    (r" (/ 2)", ("",)),
    (r"'1'", ("'0'",)),
    (r"'0'", ("'1'",)),
    (r"^ +(\w+ <= .*;)$", ("null;",)),  # an assignment of a process
]

UNSEEN = {
    "watch 51: if word >= peak_now then": "an equal peak is the same peak",
}
"""Changes that change nothing, and why."""


def _body(text: str) -> Iterator[tuple[int, int, int, bool]]:
    """(number, where it begins, where it ends, whether in a process) of an architecture's lines."""
    at, inside, process = 0, False, False
    for number, line in enumerate(text.splitlines(keepends=True), 1):
        if inside and not line.lstrip().startswith("--"):
            yield number, at, at + len(line.split("--")[0].rstrip()), process
        inside = inside or line == "begin\n"
        process = (process or "process (" in line) and "end process" not in line
        at += len(line)


def mutants(source: Path) -> Iterator[tuple[str, str]]:
    """(what is changed, the file's text) of each."""
    text = source.read_text(encoding="utf-8")
    for number, lo, hi, process in _body(text):
        for pattern, puts in CHANGES:
            for found in re.finditer(pattern, text[lo:hi]):
                begin, end = found.span(1 if found.re.groups else 0)
                for put in puts:
                    if put == "null;" and not process:
                        continue
                    line = f"{text[lo : lo + begin]}{put}{text[lo + end : hi]}".strip()
                    said = f"{source.stem.removeprefix('difffric_')} {number}: {line}"
                    yield said, text[: lo + begin] + put + text[lo + end :]


def all_mutants() -> dict[str, tuple[Path, str]]:
    """What is changed -> the file and its text."""
    return {said: (source, text) for source in SOURCES for said, text in mutants(source)}
