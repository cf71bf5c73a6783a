"""What the commands do where the set-up is that of an axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from difffric.axis.diagnosis.procedure import diagnose_axis
from difffric.axis.files.load_recording import load_axis
from difffric.axis.files.setup_file import format_axis, read_axis
from difffric.axis.fit import fit_axis
from difffric.axis.friction_levels import identify_axis
from difffric.axis.motion.simulate import simulate_axis
from difffric.axis.recordings import AxisRecordings, convert_to_newtons
from difffric.axis.setup import AxisSetup
from difffric.axis.unit_checks import refuse_wrong_units
from difffric.commands.axis import check, report
from difffric.commands.console import check_setup_stays, print_and_write, show_progress
from difffric.commands.options import ReadOptions, parse_channels, sign_setup
from difffric.errors import InputError


def read_both(setup: Path, data: Path, asked: ReadOptions) -> tuple[AxisSetup, AxisRecordings]:
    """Return the axis and its recording, whose names the set-up and the options say.

    Raises `InputError` where they cannot be used, or are plainly in other units than they say.
    """
    axis = read_axis(setup)
    names = {**axis.channels, **parse_channels([*(asked.channel or ())])}
    loaded = load_axis(data, skip_bad=asked.skip_bad, channels=names)
    if not asked.trust_units:
        refuse_wrong_units(axis, loaded)
    return replace(axis, channels=names), loaded


def run_check(data: Path, setup: Path, asked: ReadOptions, out: Path | None, quiet: bool) -> None:
    """Show what a fit of an axis would be given."""
    with show_progress(quiet) as tell:
        tell("reading", 0.0)
        axis, loaded = read_both(setup, data, asked)
        tell("what the data can tell", 0.3)
        found = check.examine_recording(axis, loaded)
        tell("drawing", 0.9)
        page = check.report_check(axis, found, pictures=out is not None)
    print_and_write(page, check.describe_check(found), out, timings=tell.timings)


def run_fit(
    data: Path,
    setup: Path,
    free: Sequence[str] | None,
    asked: ReadOptions,
    out: Path | None,
    quiet: bool,
) -> None:
    """Fit an axis to a recording: result.json, report.html, figures and the fitted set-up."""
    check_setup_stays(out, setup)
    axis, loaded = read_both(setup, data, asked)
    with show_progress(quiet) as tell:
        found = fit_axis(axis, loaded, free=free, tell=tell)
        tell("drawing", 0.95)
        page = report.report_fit(found, pictures=out is not None)
    files = (
        None
        if out is None
        else {"setup.toml": format_axis(found.setup, sign_setup("fit", data)).encode()}
    )
    print_and_write(page, found.as_dict(), out, files, tell.timings)


def run_identify(
    data: Path, setup: Path, asked: ReadOptions, out: Path | None, quiet: bool
) -> None:
    """Give the friction level of each stretch of a recording."""
    axis, loaded = read_both(setup, data, asked)
    with show_progress(quiet) as tell:
        levels = identify_axis(axis, loaded, tell=tell)
    answer = {"kind": "axis", **levels.as_dict()}
    page = report.report_levels(axis, levels, pictures=out is not None)
    print_and_write(page, answer, out, timings=tell.timings)


def run_diagnose(
    data: Path, setup: Path, matters: float, asked: ReadOptions, out: Path | None, quiet: bool
) -> None:
    """Say what the plain axis lacks, and write the extended set-up."""
    check_setup_stays(out, setup)
    axis, loaded = read_both(setup, data, asked)
    with show_progress(quiet) as tell:
        found = diagnose_axis(axis, loaded, matters=matters, tell=tell)
        tell("drawing", 0.95)
        page = report.report_diagnosis(found, pictures=out is not None)
    files = (
        None
        if out is None
        else {"setup.toml": format_axis(found.setup, sign_setup("diagnose", data)).encode()}
    )
    print_and_write(page, found.as_dict(), out, files, tell.timings)


def run_simulate(setup: Path, motion: Path | None, out: Path | None, quiet: bool) -> None:
    """Simulate an axis under the forces of a file, and report the motion and its derivatives.

    Raises `InputError` where there is no such file.
    """
    if motion is None:
        raise InputError(
            f"--motion is missing: expected the forces that drive the axis of {setup}, a .csv with "
            "time_s and force_N (or drive_V), or a recording"
        )
    axis = read_axis(setup)
    loaded = load_axis(motion, channels=axis.channels, needs_position=False)
    loaded = convert_to_newtons(loaded, axis.gain)
    with show_progress(quiet) as tell:
        tell("simulating", 0.0)
        time = np.concatenate([x.time for x in loaded.stretches])
        if np.any(np.diff(time) <= 0):
            raise InputError(f"{motion}: time_s does not grow; simulate one stretch at a time")
        force = np.concatenate([x.force for x in loaded.stretches])
        measured = np.concatenate([x.position for x in loaded.stretches])
        start = float(measured[0]) if np.isfinite(measured[0]) else 0.0
        moved = simulate_axis(axis, force, time, position=start)
    has_measured = bool(np.isfinite(measured).all())
    answer = report.describe_motion(moved, measured if has_measured else None)
    page = report.report_motion(
        axis, moved, force, measured if has_measured else None, pictures=out is not None
    )
    files: Mapping[str, bytes] | None = None
    if out is not None:
        rows = ["time_s,force_N,position_mm,speed_mm_per_s"]
        columns = (moved.time, force, 1e3 * moved.position, 1e3 * moved.speed)
        rows += [f"{t:.9g},{F:.9g},{x:.9g},{u:.9g}" for t, F, x, u in zip(*columns, strict=True)]
        files = {"motion.csv": ("\n".join(rows) + "\n").encode()}
    print_and_write(page, answer, out, files)
