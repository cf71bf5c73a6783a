"""A process of its own in which a stripped program is loaded and run first.

XLA ends the process that asks it to load what it finds inconsistent: it says so in no exception.
What nobody promised to load is therefore tried where nothing is lost.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path
from threading import Lock
from typing import Any

import jax
import numpy as np

SURVIVED = b"survived\n"
"""What the process answers of a program that it has loaded and run."""
_ANSWERS = "difffric.compute.programs.answer_trials"
"""The module that the process runs."""


class Trial:
    """The process, which serves all programs that this one makes, one after the other."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._process: subprocess.Popen | None = None

    def start(self) -> None:
        """Start the process, so that it has imported JAX by the time it is asked."""
        with self._lock:
            self._start()

    def survives(self, path: Path, arrays: list[Any]) -> bool:
        """Whether the process has loaded the program at this path and run it on these arrays. One
        that ends in it is replaced when the next program comes."""
        with self._lock:
            self._start()
            process = self._process
            if process is None or process.stdin is None or process.stdout is None:
                return False
            try:
                pickle.dump((str(path), [np.asarray(x) for x in arrays]), process.stdin)
                process.stdin.flush()
                return process.stdout.readline() == SURVIVED
            except (OSError, ValueError, pickle.PicklingError):
                return False

    def _start(self) -> None:
        if self._process is not None and self._process.poll() is None:
            return
        environment = os.environ | {
            "JAX_ENABLE_X64": str(int(jax.config.read("jax_enable_x64"))),
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        }
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", _ANSWERS],
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        except OSError:  # no process to be had: nothing is tried, and so nothing stripped
            self._process = None


TRIAL = Trial()
"""The one of this process."""
