"""Set-up of all benchmarks: 64 bits, nothing compiled before, and what the machine is."""

from __future__ import annotations

import os
from importlib.metadata import PackageNotFoundError, version

import jax

jax.config.update("jax_enable_x64", True)
# A first call's time is a compilation's, not a cache's. The whole commands have their own.
jax.config.update("jax_enable_compilation_cache", False)

# By default JAX hands each call to another thread, which takes longer than one push.
jax.config.update("jax_cpu_enable_async_dispatch", False)

PACKAGES = ("jax", "numpy", "scipy", "numba", "casadi", "diffrax", "optimistix")


def pytest_benchmark_update_machine_info(config, machine_info):
    """Cores and versions, as the table names them; the host's name is nobody's business."""
    machine_info.pop("node", None)
    machine_info["cores"] = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    )
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = None
    machine_info["packages"] = versions
