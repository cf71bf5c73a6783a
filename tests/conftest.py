"""64 bits for every test, as the command line and the notebooks have it; one store of compiled
programs for all workers and the commands that they start; and programs that compile soon.

Nearly all of the time of a first run is compiling. What is compiled is kept below `.pytest_cache`,
so that what one worker has made the others load, and a second run spends its time on testing.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings

CACHE = Path(__file__).parents[1] / ".pytest_cache"
STORES = {"JAX_COMPILATION_CACHE_DIR": CACHE / "jax", "DIFFFRIC_PROGRAMS": CACHE / "programs"}
"""Where JAX keeps what it has traced, and the library what need not be traced again."""
QUICK_PROGRAMS = CACHE / "quick_programs"
"""The library's store for the files of `QUICK`: its keys do not know how XLA was asked."""
COMPILER = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=1"
"""XLA's older code generator for loops, and LLVM's first level of optimisation: large programs
compile in half of the time or less. Values differ by roundings."""


def _are_known(flags: str) -> bool:
    """Whether XLA knows these flags: it ends a process that it is given others in."""
    code = "import jax; jax.devices()"
    environment = os.environ | {"XLA_FLAGS": flags}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True)
    return done.returncode == 0


for name, folder in STORES.items():
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    os.environ.setdefault(name, str(folder))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
os.environ["JAX_ENABLE_X64"] = "1"
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# As the commands set it: with another value they would not find the tests' programs.
os.environ.setdefault("EQX_ON_ERROR", "nan")
# Likewise: where every core has a worker, a product of matrices by threads that wait for each other
# took 50 times as long, and the whole suite three times.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if "XLA_FLAGS" not in os.environ:  # the workers have it of the process that starts them
    os.environ["XLA_FLAGS"] = COMPILER if _are_known(COMPILER) else ""

settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("random", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))
"""The same inputs on every run, so that a failure is the change's; `HYPOTHESIS_PROFILE=random`
draws others. No deadline: beside others a quick test may wait half a second."""

LONGEST = (
    "procedure",
    "procedure_tables",
    "integrators",
    "calibrate",
    "notebooks",
    "paper",
    "cli_fit",
    "effects",
    "docs",
    "browser",
    "identification",
)
"""Files that take longest: on several cores they begin, so that none is left over at the end."""

QUICK = {"integrators", "effects", "effect_reference", "reference", "residual_rows", "simulation"}
"""Files whose large programs run a few times: they are compiled without LLVM's optimisation, in a
third of the time, and run six times slower. No fit is among them, which would take longer so."""


def pytest_collection_modifyitems(items):
    """Files in the order of `LONGEST`, then as they come."""
    rank = {f"test_{name}.py": k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))


@pytest.fixture(scope="module", autouse=True)
def compile_as_the_file_needs(request):
    """Compile without optimisation what the files of `QUICK` need; let go of what they and the
    longest files compiled, as all programs of a run fill a worker's memory."""
    name = request.path.stem.removeprefix("test_")
    with pytest.MonkeyPatch.context() as patch:
        if name in QUICK:
            import jax

            patch.setenv("DIFFFRIC_PROGRAMS", str(QUICK_PROGRAMS))
            jax.config.update("jax_disable_most_optimizations", True)
        yield
    if name in QUICK:
        sys.modules["jax"].config.update("jax_disable_most_optimizations", False)
    if name in QUICK.union(LONGEST) and "jax" in sys.modules:
        sys.modules["jax"].clear_caches()
