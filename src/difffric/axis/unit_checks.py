"""Units that are plainly wrong, said before anything is fitted: positions in m that are called mm.

The mass and the Coulomb friction that a recording has at first sight are held against the set-up's,
which count as orders of magnitude only. Where the mass is a hundred times off or more, and one
other unit in one column brings both back, it is said.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from difffric.axis.one_thread import hold_one_thread
from difffric.axis.preparation import prepare_recording
from difffric.axis.recordings import NEWTON, AxisRecordings, convert_to_newtons
from difffric.axis.search import find_start
from difffric.axis.setup import COULOMB, MASS, PLAIN_NAMES, AxisSetup
from difffric.errors import InputError
from difffric.measurements.headings import find_unit_of, separate_unit
from difffric.units import UNITS

_OFF = 2.0
"""log10 of a ratio to the set-up's from which on a unit is in doubt."""
_FITTING = 0.8
"""log10 of a ratio that another unit has to lead to."""
_SLOWEST = 0.2
"""Seconds between samples from which on nothing of an acceleration is seen."""
_FASTEST = 1e-5
"""The same, below which no encoder is read."""
_TRUST = "(--trust-units takes them as they are)"


@dataclass(frozen=True)
class _WrongUnit:
    """A column whose numbers are to be multiplied by a factor, and what becomes of the numbers."""

    column: str
    """`time`, `force` or `position`"""
    factor: float
    mass: int
    """power of the factor that the mass goes with"""
    coulomb: int


_GUESSES = tuple(
    _WrongUnit(column, factor, *powers)
    for column, powers in (("position", (-1, 0)), ("force", (1, 1)), ("time", (2, 0)))
    for factor in (1e3, 1e-3, 1e6, 1e-6)
)


def refuse_wrong_units(setup: AxisSetup, data: AxisRecordings) -> None:
    """Do nothing where the units of a recording may be right.

    Raises `InputError` where the mass is far from the set-up's and another unit of one column would
    bring it back.
    """
    step = float(np.median(np.concatenate([np.diff(x.time) for x in data.stretches] or [[0.0]])))
    if step > _SLOWEST or 0 < step < _FASTEST:
        seems = _name_other(data.columns, "time", 1e-3 if step > _SLOWEST else 1e3)
        raise InputError(
            f"{data.source}: a sample every {step:.3g} s, as no axis is recorded: {seems} {_TRUST}"
        )
    seen = _look(setup, data)
    if seen is None:
        return
    off = {name: float(np.log10(seen[name] / getattr(setup, field)))
           for name, field in ((MASS, "mass"), (COULOMB, "coulomb"))}  # fmt: skip
    if abs(off[MASS]) < _OFF:
        return
    for guess in _GUESSES:
        power = np.log10(guess.factor)
        left = (off[MASS] + guess.mass * power, off[COULOMB] + guess.coulomb * power)
        if max(abs(x) for x in left) < _FITTING:
            seems = _name_other(data.columns, guess.column, guess.factor)
            if guess.column == "force" and data.unit != NEWTON:
                seems += ", or [drive] gain_N_per_V is"
            raise InputError(
                f"{data.source}: the mass would be {seen[MASS]:.2g} kg, where the set-up says "
                f"{setup.mass:.3g} kg: {seems} {_TRUST}"
            )


def _look(setup: AxisSetup, data: AxisRecordings) -> dict[str, float] | None:
    """Mass and Coulomb friction at first sight; None where the data do not tell them, the reason of
    which is told by what asks for them."""
    newtons = convert_to_newtons(data, setup.gain)
    try:
        ready = prepare_recording(newtons, replace(setup, resolution=None, noise=None))
        with hold_one_thread():
            values, imposed = find_start(ready.run_data, setup.values, PLAIN_NAMES)
    except (InputError, np.linalg.LinAlgError):
        return None
    return None if imposed or values[COULOMB] <= 0 else values


def _name_other(columns: Mapping[str, str], column: str, factor: float) -> str:
    """What a column seems to be in: its name with another unit, or how far it is off."""
    name = columns.get(column, "")
    own = find_unit_of(name)
    if own is not None:
        for unit in UNITS:
            if unit.of == own.of and np.isclose(unit.in_si, own.in_si * factor, rtol=1e-6, atol=0):
                stem = separate_unit(name)[0].strip()
                return f"{name} looks like {unit.symbol}, call the column {stem}_{unit.symbol}"
    what = {"position": "positions are", "force": "forces are", "time": "times are"}[column]
    size = f"{factor:g} times too small" if factor > 1 else f"{1 / factor:g} times too large"
    return f"its {what} {size}"
