"""difffric: differentiable identification of sliding friction. SI units throughout.

What most work needs stands here: a rig (`Rig`, `spring_damper_rig`, `load_setup`), a push of it
(`simulate`, `observe`, `sensitivity`), measured pushes (`load`, `Pushes`, `Recordings`), and what
they tell (`fit`, `identify`, `diagnose`, `next_push`, `Monitor`, `plan`, `centre`,
`identify_fleet`, `diagnose_fleet`). The set-up and the recording of an axis go into the same names
(`dispatch`). What goes further stands in the packages, each of which tells
in its docstring what it has and which of it to choose:

- `rig`: the laws of friction and contact, the catalogue of effects, the set-up's file
- `simulation`: a push by equation (2), its F_p and d, and their exact derivatives
- `measurements`: pushes and recordings, and F_p and d from samples without a model
- `acquisition`: pushes recorded by the card
- `axis`: an axis driven by a recorded force, its friction and mass
- `calibration`: the rig's parameters from pushes, with their errors
- `identification`: mu_s of each push; as a controller's C, too
- `diagnosis`: what the simulation lacks
- `monitoring`: friction over pushes, with an alarm
- `centering`: the offset of a ring, and the pushes that bring it to its target
- `fleet`: archives of many rigs
- `studies`: the paper's results, sampling rates, rival ways to centre
- `units`: the units that people use, and those of the equations

A name is imported when it is first used, so that a program pays only for what it needs; the names
stand in `__init__.pyi`, here and in each package.
"""

from __future__ import annotations

import importlib

import lazy_loader

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_MOVED = {
    "AbstractContact": "rig",
    "AbstractFriction": "rig",
    "Belief": "centering",
    "ClosedForm": "simulation",
    "ConstantSpeed": "rig",
    "Diffrax": "simulation",
    "Known": "centering",
    "Predictor": "identification",
    "RungeKutta": "simulation",
    "UnilateralSpringDamper": "rig",
    "ViscousCoulomb": "rig",
    "extended": "rig",
    "fit_predictor": "identification",
    "identifiable": "calibration",
    "identifier": "identification",
    "invert": "identification",
    "profile": "calibration",
    "regime_margin": "simulation",
    "universal": "rig",
}
"""Names that stood here before there were packages, and where each is now; they go with 0.2."""


def __getattr__(name: str):
    if name not in _MOVED:
        return _load(name)
    import warnings  # here, as nothing else of it is needed

    package = f"{__name__}.{_MOVED[name]}"
    warnings.warn(
        f"difffric.{name} is {package}.{name} now; the old name goes with version 0.2",
        DeprecationWarning,
        stacklevel=2,
    )
    return getattr(importlib.import_module(package), name)
