"""64 bits for every test, as the command line and the notebooks have it, and one store of compiled
programs for all of them, so that a second run spends its time on testing."""

import os
from pathlib import Path

from hypothesis import settings

CACHE = Path(__file__).parents[1] / ".pytest_cache" / "jax"
CACHE.mkdir(mode=0o700, parents=True, exist_ok=True)
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(CACHE))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
os.environ["JAX_ENABLE_X64"] = "1"
os.environ.setdefault("JAX_PLATFORMS", "cpu")

settings.register_profile("same", derandomize=True)
settings.register_profile("random")
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))
"""The same inputs on every run, so that a failure is the change's; `HYPOTHESIS_PROFILE=random`
draws others."""

LONGEST = (
    "procedure",
    "integrators",
    "calibrate",
    "notebooks",
    "paper",
    "cli_fit",
    "docs",
    "browser",
    "identification",
)
"""Files that take longest: on several cores they begin, so that none is left over at the end."""


def pytest_collection_modifyitems(items):
    """Files in the order of `LONGEST`, then as they come."""
    rank = {f"test_{name}.py": k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))
