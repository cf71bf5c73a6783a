"""Figures of what is being recorded: two strokes in a row (Figure III.3), and the live one."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from difffric.commands.figures.style import STYLE, make_figure, write_name
from difffric.identification.live import LivePush
from difffric.measurements.recordings import Channel, Recording
from difffric.number_text import format_number
from difffric.units import to_mm_min, to_um

_BLUE, _RED = "#1f6f8b", "#b4532a"
_COLUMNS = 2000  # of a drawn trace: more are not seen


def find_envelope(channel: Channel) -> tuple[NDArray, NDArray]:
    """(times [s], samples) that draw a channel as all of its samples would: the least and the
    largest of each piece."""
    size = max(channel.n // _COLUMNS, 1)
    if size == 1:
        return channel.time, channel.samples
    pieces = channel.samples[: channel.n // size * size].reshape(-1, size)
    both = np.stack([pieces.min(axis=1), pieces.max(axis=1)], axis=1).ravel()
    t = channel.start + channel.dt * size * (np.arange(len(pieces)) + 0.5)
    return np.repeat(t, 2), both


def draw_strokes(recordings: Sequence[Recording]) -> Figure:
    """Force over time of successive strokes on one axis; the time between two recordings, in
    which nothing is recorded, is left out."""
    figure, ax = make_figure(width=7.2, height=3.4)
    begin = 0.0
    with matplotlib.rc_context(STYLE):
        for i, push in enumerate(recordings):
            assert push.force is not None
            t, force = find_envelope(push.force)
            t = t - push.force.start + begin
            speed = f"{to_mm_min(push.velocity):g} mm/min"
            label = (
                f"{write_name(push.name)}, {speed}: at most {format_number(float(force.max()), 4)} "
            )
            ax.plot(
                1e3 * t, force, color=(_BLUE, _RED)[i % 2], lw=0.8, label=label + push.force.unit
            )
            begin += push.force.n * push.force.dt
            if i + 1 < len(recordings):
                ax.axvline(1e3 * begin, color="0.6", ls=":", lw=1)
        ax.set_xlabel("recorded time [ms]")
        unit = recordings[0].force.unit if recordings[0].force else "N"
        ax.set_ylabel(f"force [{unit}]")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(recordings), fontsize=9)
    return figure


def draw_live(figure: Figure, pushes: Sequence[LivePush | None], last: Recording) -> None:
    """Draw the last push's force, and mu_s of all until now, into a figure."""
    figure.clear()
    with matplotlib.rc_context(STYLE):
        left, right = figure.subplots(1, 2)
        assert last.force is not None
        t, force = find_envelope(last.force)
        left.plot(1e3 * t, force, color=_BLUE, lw=0.8)
        left.set(xlabel="time [ms]", ylabel=f"force [{last.force.unit}]")
        left.set_title(f"{write_name(last.name)}, {to_mm_min(last.velocity):g} mm/min", loc="left")
        newest = pushes[-1] if pushes else None
        if newest and newest.reduced and not np.isnan(newest.reduced.peak_force):
            seen = newest.reduced
            left.plot(
                1e3 * seen.peak_time,
                seen.peak_force,
                "v",
                color=_RED,
                label=f"$F_p$ = {seen.peak_force:.1f} N",
            )
            if not np.isnan(seen.sliding_distance):
                label = f"released; d = {to_um(seen.sliding_distance):.0f} µm"
                left.axvline(1e3 * seen.release_time, color=_RED, ls=":", lw=1, label=label)
            left.legend(loc="upper right", fontsize=8)
        for i, (way, name) in enumerate(
            (("mu_s_force", "force"), ("mu_s_distance", "distance"), ("mu_s_optimal", "optimal"))
        ):
            found = [
                (n, getattr(p.friction, way)) for n, p in enumerate(pushes, 1) if p and p.friction
            ]
            found = [(n, x) for n, x in found if x.value is not None]
            if found:
                n, value = [n for n, _ in found], [x.value for _, x in found]
                error = [x.standard_error or 0.0 for _, x in found]
                x = np.array(n) + 0.12 * (i - 1)
                right.errorbar(
                    x,
                    value,
                    error,
                    fmt="os*"[i],
                    ms=3 + 3 * (i == 2),
                    lw=1,
                    color=("0.6", "#5b7f3b", _BLUE)[i],
                    label=name,
                )
        right.set(xlabel="push", ylabel="$\\mu_s$", xlim=(0.5, max(len(pushes), 1) + 0.5))
        right.xaxis.get_major_locator().set_params(integer=True)
        if right.get_legend_handles_labels()[0]:
            right.legend(loc="best", fontsize=8)
