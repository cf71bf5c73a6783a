"""What the commands do where the set-up is that of an axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from difffric.axis.diagnosis.procedure import diagnose_axis
from difffric.axis.files.load_recording import load_axis
from difffric.axis.files.setup_file import format_axis, read_axis
from difffric.axis.fit import fit_axis
from difffric.axis.friction_levels import identify_axis
from difffric.axis.motion.simulate import simulate_axis
from difffric.axis.recordings import convert_to_newtons
from difffric.commands.axis import report
from difffric.commands.console import check_setup_stays, print_and_write, show_progress
from difffric.errors import InputError


def run_fit(
    data: Path,
    setup: Path,
    free: Sequence[str] | None,
    skip_bad: bool,
    out: Path | None,
    quiet: bool,
) -> None:
    """Fit an axis to a recording: result.json, report.html, figures and the fitted set-up."""
    check_setup_stays(out, setup)
    axis, loaded = read_axis(setup), load_axis(data, skip_bad=skip_bad)
    with show_progress(quiet) as tell:
        found = fit_axis(axis, loaded, free=free, tell=tell)
        tell("drawing", 0.95)
        page = report.report_fit(found, pictures=out is not None)
    files = None if out is None else {"setup.toml": format_axis(found.setup).encode()}
    print_and_write(page, found.as_dict(), out, files, tell.timings)


def run_identify(data: Path, setup: Path, skip_bad: bool, out: Path | None, quiet: bool) -> None:
    """Give the friction level of each stretch of a recording."""
    axis, loaded = read_axis(setup), load_axis(data, skip_bad=skip_bad)
    with show_progress(quiet) as tell:
        levels = identify_axis(axis, loaded, tell=tell)
    answer = {"kind": "axis", **levels.as_dict()}
    page = report.report_levels(axis, levels, pictures=out is not None)
    print_and_write(page, answer, out, timings=tell.timings)


def run_diagnose(
    data: Path, setup: Path, matters: float, skip_bad: bool, out: Path | None, quiet: bool
) -> None:
    """Say what the plain axis lacks, and write the extended set-up."""
    check_setup_stays(out, setup)
    axis, loaded = read_axis(setup), load_axis(data, skip_bad=skip_bad)
    with show_progress(quiet) as tell:
        found = diagnose_axis(axis, loaded, matters=matters, tell=tell)
        tell("drawing", 0.95)
        page = report.report_diagnosis(found, pictures=out is not None)
    files = None if out is None else {"setup.toml": format_axis(found.setup).encode()}
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
    loaded = convert_to_newtons(load_axis(motion, needs_position=False), axis.gain)
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
