"""The process behind `trial`: it loads and runs the programs that it is told of, until its input
ends."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

from difffric.compute.programs.record import Record
from difffric.compute.programs.store import read_program
from difffric.compute.programs.trial import SURVIVED


def answer_trials() -> None:
    """Read (path, arrays) after (path, arrays), and write a line for each."""
    while True:
        try:
            path, arrays = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            call = read_program(Path(path), Record("", ""))
            answer = b"none\n" if call is None else SURVIVED
            if call is not None:
                call(arrays)
        except Exception:  # the caller sees what comes of it
            answer = b"failed\n"
        sys.stdout.buffer.write(answer)
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    answer_trials()
