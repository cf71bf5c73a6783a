"""Options that several commands share, and what a command makes of them."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import difffric as df
from difffric.axis.files.file_kind import is_axis_file
from difffric.errors import InputError
from difffric.name_text import make_printable
from difffric.units import from_mm

if TYPE_CHECKING:
    from difffric.rig.rig import Rig

Setup = Annotated[Path, typer.Argument(help="The set-up, a setup.toml.", show_default=False)]
Data = Annotated[Path, typer.Argument(help="Measured data, .csv or .tdms.", show_default=False)]
SetupOption = Annotated[
    Path | None,
    typer.Option(
        "--setup",
        help="The set-up, a setup.toml, which is needed; init writes a first one.",
        show_default=False,
    ),
]
DataMass = Annotated[
    bool, typer.Option("--use-data-mass", help="Accept masses that differ from the set-up's.")
]
Channel = Annotated[
    list[str] | None,
    typer.Option(
        metavar="OURS=THEIRS",
        help="Name of a column or channel in your file, such as force=Kraft. Repeatable.",
    ),
]
TrustUnits = Annotated[
    bool,
    typer.Option(
        "--trust-units", help="Take the units that the file says, even if the data look wrong."
    ),
]
SkipBad = Annotated[
    bool, typer.Option("--skip-bad", help="Leave out rows and pushes that cannot be used.")
]
Out = Annotated[
    Path | None,
    typer.Option(help="Folder for the results: report.html, result.json, figures and other files."),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show no progress on standard error.")]


@dataclass(frozen=True)
class ReadOptions:
    """How measured data are to be read, as the options say it."""

    skip_bad: bool = False
    channel: Sequence[str] | None = None
    trust_units: bool = False
    use_data_mass: bool = False


def require_positive(name: str, value: float | None) -> float | None:
    """Return an option's value; None, where it was not given, goes through.

    Raises `InputError` where the value is no finite number above 0.
    """
    if value is not None and not 0 < value < float("inf"):
        raise InputError(f"{name}: expected a number > 0, got {value:g}")
    return value


def check_setup(setup: Path | None, data: Path) -> Path:
    """Return the set-up's file, which one rig's data need.

    Raises `InputError` where none is given.
    """
    if setup is None:
        raise InputError(
            f"--setup is missing: expected the set-up of the rig of {data}; difffric init {data} "
            "writes one"
        )
    return setup


def read_setup_for(setup: Path, channel: list[str] | None) -> df.Setup:
    """Read a set-up; what `--channel` says counts before its `[files]`.

    Raises `InputError` where the file is wrong, and for a `--channel` without its two names.
    """
    read, given = read_rig_setup(setup), parse_channels(channel)
    return replace(read, channels={**read.channels, **given}) if given else read


def read_rig_setup(setup: Path) -> df.Setup:
    """Read the set-up of a push rig.

    Raises `InputError` where the file is wrong, or is that of an axis.
    """
    if is_axis_file(setup):
        raise InputError(
            f"{setup}: the set-up of an axis, which has no pushes: check, fit, identify, diagnose "
            "and simulate take it"
        )
    return df.read_setup(setup)


def parse_channels(channel: list[str] | None) -> dict[str, str]:
    """Return the file's names by ours, as `--channel` says them.

    Raises `InputError` for one without its two names, and for one given twice.
    """
    given: dict[str, str] = {}
    for text in channel or []:
        ours, equals, theirs = text.partition("=")
        if not (equals and ours.strip() and theirs.strip()):
            raise InputError(f"--channel {text}: expected OURS=THEIRS, such as force=Kraft")
        if ours.strip() in given:
            raise InputError(f"--channel {ours.strip()}: given twice, expected once")
        given[ours.strip()] = theirs.strip()
    return given


def load_data(
    data: Path, setup: df.Setup, skip_bad: bool, trust_units: bool
) -> df.Pushes | df.Recordings:
    """Load measured pushes with the names that the set-up gives, and hold their units against it.

    Raises `InputError` where they cannot be used, or are plainly in other units than they say,
    unless `trust_units`.
    """
    # Not at the top: help needs no check. The set-up says that these are pushes, and no axis.
    from difffric.axis.files.file_kind import is_axis_recording
    from difffric.measurements.load_file import load
    from difffric.measurements.unit_checks import refuse_wrong_units

    if is_axis_recording(data) and not setup.channels:
        raise InputError(
            f"{data}: the recording of an axis (force and position over time) beside the set-up of "
            "a push rig: expected a set-up with [axis], or pushes"
        )
    loaded = load(data, skip_bad=skip_bad, channels=setup.channels)
    if trust_units:
        return loaded
    return replace(loaded, notes=(*loaded.notes, *refuse_wrong_units(loaded, setup.rig)))


def format_command(
    command: str,
    data: Path,
    setup: Path,
    asked: ReadOptions,
    *rest: str,
) -> str:
    """Return what to type for a command on the same data, read in the same way."""
    words = ["difffric", command, str(data), "--setup", str(setup)]
    for option, given in (
        ("--skip-bad", asked.skip_bad),
        ("--trust-units", asked.trust_units),
        ("--use-data-mass", asked.use_data_mass),
    ):
        words += [option] * given
    for names in asked.channel or ():
        words += ["--channel", names]
    return shlex.join([*words, *rest])


def sign_setup(command: str, data: Path) -> str:
    """Return the line in which a command signs for a set-up that it has calibrated on data."""
    return f"Calibrated on {make_printable(data.name)} by difffric {command}."


def load_motions(data: Path, setup: df.Setup) -> df.Recordings:
    """Load recordings, each with the motion of its pusher.

    Raises `InputError` for a table, and where a pusher cannot be used.
    """
    from difffric.measurements.load_file import load
    from difffric.measurements.recorded_motion import take_recorded_motion

    loaded = load(data, channels=setup.channels)
    if isinstance(loaded, df.Pushes):
        raise InputError(f"--motion {data}: expected recordings with a channel pusher, got a table")
    return take_recorded_motion(loaded)


def load_rig(
    setup: Path,
    mu_s: float | None = None,
    mass_kg: float | None = None,
    stroke_mm: float | None = None,
) -> Rig:
    """Load the set-up's rig and put what the command line gives in place of the file's values.

    Raises `InputError` where the file or a given value is wrong.
    """
    rig = read_rig_setup(setup).rig
    given = {
        "mu_s": require_positive("--mu-s", mu_s),
        "mass_kg": require_positive("--mass-kg", mass_kg),
    }
    rig = df.rig.parameters.with_values(rig, {k: v for k, v in given.items() if v is not None})
    if require_positive("--stroke-mm", stroke_mm) is not None:
        rig = df.rig.parameters.with_stroke(rig, from_mm(stroke_mm))
    return rig
