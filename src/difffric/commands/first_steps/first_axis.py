"""A first set-up of an axis: mass and friction guessed from its own recording."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import typer

from difffric.axis.files.load_recording import load_axis
from difffric.axis.files.setup_file import parse_axis
from difffric.axis.fit import fit_axis
from difffric.axis.recordings import VOLT, AxisRecordings
from difffric.axis.result import AxisFit
from difffric.axis.setup import COULOMB, MASS, OFFSET, VISCOUS, AxisExtras, AxisSetup
from difffric.commands.first_steps.setup_text import Line, format_tables
from difffric.commands.options import require_positive
from difffric.errors import InputError
from difffric.number_text import format_number
from difffric.units import to_um

_GUESS = "a guess from this recording; a fit finds it"


@dataclass(frozen=True)
class AxisNumbers:
    """What a person says of an axis; None: not said."""

    mass_kg: float | None
    gain_N_per_V: float | None
    resolution_um: float | None


def write_first_axis(
    data: Path, said: AxisNumbers, names: Mapping[str, str], skip_bad: bool
) -> tuple[str, str]:
    """(the text of a set-up for the recording of a file, what was guessed, in words). `names`: what
    the file calls a column or channel, by our name.

    Raises `InputError` where the file cannot be used, or tells neither mass nor the drive's gain.
    """
    loaded = load_axis(data, skip_bad=skip_bad, channels=names)
    found, gain, of_gain = _look(loaded, said)
    mass, of_mass = _find_mass(found, said.mass_kg)
    lines: dict[str, list[Line]] = {
        "axis": [("mass_kg", format_number(mass, 3), of_mass)],
        "friction": [
            ("coulomb_N", format_number(found.value(COULOMB), 3), _GUESS),
            (
                "k_v_N_s_per_m",
                format_number(max(found.value(VISCOUS), 0.0), 3),
                f"viscous friction; {'held at 0' if _is_open(found, VISCOUS) else _GUESS}",
            ),
        ],
        "drive": [
            *([] if gain is None else [("gain_N_per_V", f"{gain:.6g}", of_gain)]),
            (
                "offset_N",
                "0.0" if _is_open(found, OFFSET) else format_number(found.value(OFFSET), 2),
                "a force beside the recorded one; a fit finds it",
            ),
        ],
        "probe": [
            *([] if said.resolution_um is None
              else [("resolution_um", f"{said.resolution_um:.6g}", "given with --resolution-um")]),
            *([] if found.imposed
              else [("noise_um", f"{to_um(found.noise.encoder):.2g}", "measured here")]),
        ],
        "files": [
            (key, json.dumps(name, ensure_ascii=False), "what the files call it")
            for key, name in names.items()
        ],
    }  # fmt: skip
    text = format_tables(lines, data)
    parse_axis(text)
    numbers = (
        f"mass {'' if said.mass_kg else 'about '}{mass:.3g} kg, coulomb_N about "
        f"{found.value(COULOMB):.3g}, k_v about {max(found.value(VISCOUS), 0.0):.3g} N s/m"
    )
    if gain is not None:
        numbers += f", gain {gain:.4g} N/V"
    notes = "".join(f"\nNote: {note}." for note in found.notes)
    return text, numbers + notes


def _look(data: AxisRecordings, said: AxisNumbers) -> tuple[AxisFit, float | None, str]:
    """A fit that starts at nothing, and the drive's gain [N/V] with where it comes from."""
    held = {} if said.mass_kg is None else {MASS: AxisExtras(free=False)}
    own = AxisSetup(said.mass_kg or 1.0, coulomb=1.0)
    if data.unit != VOLT:
        return _drop_doubts(fit_axis(replace(own, extras=held), data)), None, ""
    gain, words = said.gain_N_per_V, "as given: mass and all friction go with it"
    if gain is None and said.mass_kg is not None:
        # In volts for newtons the mass is that of the axis, over the gain.
        in_volts = fit_axis(replace(own, mass=1.0, gain=1.0), data)
        if _is_open(in_volts, MASS):
            raise InputError(f"{data.source}: {_NO_MASS}: give --gain-n-per-v")
        gain, words = said.mass_kg / in_volts.value(MASS), "such that the mass is that given"
    if gain is None and sys.stdin.isatty():
        gain = typer.prompt("gain of the drive [N/V]", type=float)
    if gain is None or gain == 0 or not math.isfinite(gain):
        raise InputError(
            "--gain-n-per-v is missing: the drive is in volts (--mass-kg does as well: the gain "
            "follows from it)"
        )
    return _drop_doubts(fit_axis(replace(own, gain=gain, extras=held), data)), gain, words


_NO_MASS = "the motion is slow, or imposed by something else, and does not tell the mass"


def _find_mass(found: AxisFit, given: float | None) -> tuple[float, str]:
    """The mass [kg], and where it comes from: the option, else the recording, else who sits at the
    terminal.

    Raises `InputError` where none of them says it.
    """
    if given is not None:
        return given, "as given"
    if not _is_open(found, MASS):
        return found.value(MASS), _GUESS
    if sys.stdin.isatty():
        answer = typer.prompt(f"{_NO_MASS}; mass of the axis [kg]", type=float)
        return require_positive("mass", answer) or 1.0, "as given"
    raise InputError(f"--mass-kg is missing: {_NO_MASS}")


def _is_open(found: AxisFit, name: str) -> bool:
    """Whether the recording does not tell a parameter."""
    return found.standard_error(name) is None


def _drop_doubts(found: AxisFit) -> AxisFit:
    """The look without the notes that hold it against a set-up, which there is none of."""
    return replace(found, notes=found.data.notes)
