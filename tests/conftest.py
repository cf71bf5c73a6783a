"""64 bits for every test, as the command line and the notebooks have it, and one store of compiled
programs for all of them, so that a second run spends its time on testing."""

import os
from pathlib import Path

CACHE = Path(__file__).parents[1] / ".pytest_cache" / "jax"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(CACHE))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
os.environ["JAX_ENABLE_X64"] = "1"
os.environ.setdefault("JAX_PLATFORMS", "cpu")

LONGEST = (
    "diagnose",
    "integrate",
    "fit",
    "notebooks",
    "paper",
    "cli_fit",
    "docs",
    "identification",
)
"""Files that take longest: on several cores they begin, so that none is left over at the end."""


def pytest_collection_modifyitems(items):
    """Files in the order of `LONGEST`, then as they come."""
    rank = {f"test_{name}.py": k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))
