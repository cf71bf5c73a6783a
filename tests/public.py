"""What is public: the names that difffric and its packages list, read as a user would."""

import importlib
from types import ModuleType

import difffric


def public_names():
    """(module, the names of its functions and classes) of difffric and of each listed package."""
    modules = [difffric]
    for module in modules:  # it grows on the way
        found = (getattr(module, name) for name in module.__all__)
        modules += [x for x in found if isinstance(x, ModuleType) and hasattr(x, "__all__")]
    return [
        (
            module.__name__,
            {x for x in module.__all__ if not isinstance(getattr(module, x), ModuleType)},
        )
        for module in modules
    ]


def is_public(module: str, name: str) -> bool:
    """Whether a documented example may import a name from a module.

    It may where a package lists the name, and where the module is itself a listed one that has no
    list of its own, as `difffric.units`.
    """
    package, _, last = module.rpartition(".")
    held = importlib.import_module(module)
    if hasattr(held, "__all__"):
        return name in held.__all__
    return last in getattr(importlib.import_module(package), "__all__", ()) and hasattr(held, name)
