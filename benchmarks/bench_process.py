"""Whole commands, from the shell and back, with a warm compilation cache."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

import difffric
from benchmarks import contest

GROUP = "8. A whole process, with a warm compilation cache"
SETUP = """\
[part]
mass_kg = 18.9

[friction]
mu_s = 0.141
mu_k_over_mu_s = 0.75
k_v_N_s_per_m = 5.0

[contact]
k_N_per_m = 8.0e5
b_N_s_per_m = 1500.0
"""
REFERENCE = "difffric simulate SETUP --velocity-mm-min 3000"
MAIN = "from difffric.commands.main import main; main()"


def _simulate(*options):
    def command(folder):
        if importlib.util.find_spec("difffric.commands.main") is None:
            pytest.skip("difffric.commands.main is not there yet")
        setup = folder / "setup.toml"
        setup.write_text(SETUP, encoding="utf-8")
        arguments = ["simulate", str(setup), "--velocity-mm-min", "3000", "--quiet"]
        return [sys.executable, "-c", MAIN, *arguments, *options]

    return command


def _python(code):
    return lambda folder: [sys.executable, "-c", code]


# contender -> its command, rounds
CONTENDERS = {
    REFERENCE: (_simulate(), 5),
    "the same with --out: result.json, report.html, figures": (_simulate("--out", "out"), 2),
    'python -c "import jax"': (_python("import jax"), 5),
    'python -c "import scipy.integrate"': (_python("import scipy.integrate"), 5),
}


@pytest.mark.benchmark(group=GROUP)
@pytest.mark.parametrize("contender", CONTENDERS)
def test_process(benchmark, contender, tmp_path):
    make, rounds = CONTENDERS[contender]
    command = make(tmp_path)
    # A cache of its own, so that the first call compiles and the timed ones do not.
    environment = {n: v for n, v in os.environ.items() if n != "JAX_COMPILATION_CACHE_DIR"}
    environment["XDG_CACHE_HOME"] = str(tmp_path / "cache")
    source = Path(difffric.__path__[0]).parent
    environment["PYTHONPATH"] = os.pathsep.join([str(source), os.environ.get("PYTHONPATH", "")])

    def call():
        subprocess.run(
            command, env=environment, cwd=tmp_path, check=True, stdout=subprocess.DEVNULL
        )

    is_reference = contender == REFERENCE
    contest.race(
        benchmark, contender, call, rounds=rounds, warmup_rounds=0, is_reference=is_reference
    )
