"""The names of `difffric` that take a rig with its pushes, or an axis with its recording.

Each is the function for pushes, with its arguments and its docstring; given the set-up or the
recording of an axis it hands over to `difffric.axis`. Neither side knows the other, and none is
imported before it is asked for.
"""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable
from typing import Any

from threadpoolctl import threadpool_limits

_OF_PUSHES = {
    "diagnose": "diagnosis.procedure",
    "fit": "calibration.calibrate",
    "identify": "identification.estimators",
    "load": "measurements.load_file",
    "load_setup": "rig.setup_toml",
    "read_setup": "rig.setup_toml",
    "simulate": "simulation.trajectory",
}
"""Name -> where its function for pushes is."""
_OF_AXIS = {
    "diagnose": "axis.diagnosis.procedure.diagnose_axis",
    "fit": "axis.fit.fit_axis",
    "identify": "axis.friction_levels.identify_axis",
    "load": "axis.files.load_recording.load_axis",
    "load_setup": "axis.files.setup_file.read_axis",
    "read_setup": "axis.files.setup_file.read_axis",
    "simulate": "axis.motion.simulate.simulate_axis",
}
"""Name -> the function for an axis."""
_LONG = ("diagnose", "fit", "identify")
"""Those that compute with matrices for seconds. Threads of BLAS wait for each other in loops
meanwhile: where another process is busy, a matrix of 250 is inverted 50 times as slowly."""


def __getattr__(name: str) -> Any:
    if name not in _OF_PUSHES:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    found = globals()[name] = _join(name)
    return found


def _join(name: str) -> Callable[..., Any]:
    """The function of a name, for either."""
    of_pushes = getattr(importlib.import_module(f"difffric.{_OF_PUSHES[name]}"), name)

    @functools.wraps(of_pushes)
    def choose(*given: Any, **options: Any) -> Any:
        if name == "load":
            return _load(of_pushes, *given, **options)
        data = given[1] if len(given) > 1 else options.get("data")
        function = of_pushes
        if given and _is_axis(name, given[0]):
            _refuse_pushes(name, data)
            function = _get_of_axis(name)
        else:
            _refuse_axis(name, data)
        if name not in _LONG:
            return function(*given, **options)
        with threadpool_limits(1, user_api="blas"):
            return function(*given, **options)

    said = inspect.cleandoc(of_pushes.__doc__ or name)
    choose.__doc__ = f"{said}\n\nOf an axis: `difffric.{_OF_AXIS[name]}`, with its own options."
    return choose


def _get_of_axis(name: str) -> Callable[..., Any]:
    module, _, function = _OF_AXIS[name].rpartition(".")
    return getattr(importlib.import_module(f"difffric.{module}"), function)


def _is_axis(name: str, first: Any) -> bool:
    """Whether the first argument is an axis, or the file of one."""
    if name in ("load_setup", "read_setup"):
        from difffric.axis.files.file_kind import is_axis_file

        return is_axis_file(first)
    return type(first).__module__.startswith("difffric.axis")


def _refuse_pushes(name: str, data: Any) -> None:
    """Refuse pushes beside an axis."""
    if type(data).__module__.startswith("difffric.measurements"):
        from difffric.errors import InputError

        raise InputError(
            f"{name}: the data are pushes, and the set-up is of an axis: expected a recording of "
            "an axis (time, force and position), or a set-up with [part] and [contact]"
        )


def _refuse_axis(name: str, data: Any) -> None:
    """Refuse the recording of an axis beside a rig that has none."""
    if type(data).__module__.startswith("difffric.axis"):
        from difffric.errors import InputError

        raise InputError(
            f"{name}: the data are a recording of an axis (force and position over time, no speed "
            "of a push), and the set-up is of a push rig: expected a set-up with [axis], or pushes"
        )


def _load(of_pushes: Callable[..., Any], path: Any, **options: Any) -> Any:
    """What a file holds: a recording of an axis tells itself by its columns, or by groups that
    have a force and a position and no speed."""
    from difffric.axis.files.file_kind import is_axis_recording, lacks_speeds
    from difffric.axis.files.load_recording import load_axis
    from difffric.errors import InputError

    if is_axis_recording(path, options.get("channels") or ()):
        return load_axis(path, **options)
    try:
        return of_pushes(path, **options)
    except InputError:
        if lacks_speeds(path):
            return load_axis(path, **options)
        raise
