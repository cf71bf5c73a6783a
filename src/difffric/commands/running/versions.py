"""The versions that matter in a report of a fault: difffric's, and of what it stands on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version

_STANDS_ON = ("jax", "jaxlib", "equinox", "optimistix", "diffrax", "lineax", "numpy", "scipy")
_ON = ("1", "true", "yes", "on", "y", "t")
"""What JAX takes for a yes."""


def list_versions() -> list[str]:
    """Return the versions, a line each kind; the first is `difffric X.Y.Z`."""
    found = ", ".join(f"{name} {_find_version(name)}" for name in _STANDS_ON)
    bits = 64 if os.environ.get("JAX_ENABLE_X64", "1").lower() in _ON else 32
    return [
        f"difffric {_find_version('difffric')}",
        f"Python {platform.python_version()} ({platform.python_implementation()})",
        found,
        f"{platform.platform()}, {platform.machine()}, {os.cpu_count()} processors",
        f"numbers of {bits} bits",
    ]


def _find_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
