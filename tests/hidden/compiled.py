"""A copy of the reference stepper of its own: compiled, and free to be given other laws.

`tests.reference` itself stays as it is (interpreted unless REFERENCE_JIT says otherwise), so that
its tests in the same process see nothing of what is changed here.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import sys
import types
from pathlib import Path
from typing import Any

REFERENCE = Path(__file__).parents[1] / "reference"
MODULES = ("effect_parameters", "effect_laws", "runge_kutta", "effect_events", "effects")
PACKAGE = "tests_hidden_reference"


def module(name: str) -> Any:
    """The copy's module of that name, as it is now."""
    if PACKAGE not in sys.modules:
        package = types.ModuleType(PACKAGE)
        package.__path__ = [str(REFERENCE)]
        sys.modules[PACKAGE] = package
        before = os.environ.get("REFERENCE_JIT")
        os.environ["REFERENCE_JIT"] = "1"
        try:
            importlib.import_module(f"{PACKAGE}.jit")
        finally:
            del os.environ["REFERENCE_JIT"]
            if before is not None:
                os.environ["REFERENCE_JIT"] = before
    return importlib.import_module(f"{PACKAGE}.{name}")


def digest() -> str:
    """Stands for the source of all that is compiled into a step."""
    here, found = Path(__file__).parent, hashlib.sha256()
    paths = [REFERENCE / f"{name}.py" for name in (*MODULES, "jit")]
    for path in (*paths, *(here / f"{name}.py" for name in ("compiled", "forms", "stepper"))):
        found.update(path.read_bytes())
    return found.hexdigest()[:12]


def stored(function) -> Any:
    """Compiles, and keeps the program on disk.

    numba looks at the function's own file only to see whether a stored program is up to date; with
    the digest in the function's name a change of any law is seen too.
    """
    import numba

    function.__qualname__ = f"{function.__name__}_{digest()}"
    return numba.njit(function, error_model="numpy", cache=True)
