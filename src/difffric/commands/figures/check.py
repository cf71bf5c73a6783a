"""The pictures of `difffric check`: recordings with their landmarks, and what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from difffric.commands.figures.acquire import find_envelope
from difffric.commands.figures.style import (
    OPEN_MARKS,
    STYLE,
    group_by_condition,
    make_figure,
    write_name,
)
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Channel, Recordings
from difffric.measurements.reduction.reduce import Reduced
from difffric.units import to_mm_min, to_um

if TYPE_CHECKING:
    from difffric.calibration.identifiability import Identifiability

_SHOWN = 4
"""Recordings that a page has room for beside each other."""
_BLUE = "#1f6f8b"
_MARKS = (("peak_time", "peak"), ("release_time", "release"), ("rest_time", "rest"))


def draw_recordings(recordings: Recordings, details: Sequence[Reduced]) -> Figure:
    """Draw force and position over time of some recordings, from the slowest to the fastest, with
    the landmarks that were found."""
    order = np.argsort([r.velocity for r in recordings], kind="stable")
    chosen = order[np.unique(np.linspace(0, len(order) - 1, _SHOWN).round().astype(int))]
    kinds = [k for k in ("force", "position") if any(getattr(r, k) for r in recordings)]
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(
            len(chosen),
            3.1 * len(chosen) + 0.6,
            2.5 * len(kinds) + 0.4,
            rows=len(kinds),
            squeeze=False,
            sharex="col",
        )
        for column, i in enumerate(chosen):
            push, seen = recordings[i], details[i]
            speed = f"{to_mm_min(push.velocity):g} mm/min"
            axes[0, column].set_title(f"{write_name(push.name)}\n{speed}".strip(), fontsize=9)
            for ax, kind in zip(axes[:, column], kinds, strict=True):
                channel = getattr(push, kind)
                if channel is not None:
                    _draw_channel(ax, channel)
                for field, words in _MARKS:
                    if np.isfinite(at := getattr(seen, field)):
                        ax.axvline(1e3 * at, color="#b4532a", ls=":", lw=1)
                        if ax is axes[0, column]:
                            place = {"xy": (1e3 * at, 1), "xycoords": ax.get_xaxis_transform()}
                            ax.annotate(words, **place, fontsize=7, rotation=90, va="top",
                                        ha="right", color="#b4532a")  # fmt: skip
                if column == 0:
                    ax.set_ylabel("force [N]" if kind == "force" else "position [µm]")
            axes[-1, column].set_xlabel("time [ms]")
    return figure


def _draw_channel(ax, channel: Channel) -> None:
    t, y = find_envelope(channel)
    if channel.unit == "m":
        y = to_um(y - y[0])
    ax.plot(1e3 * t, y, color=_BLUE, lw=0.8)


def draw_measured(pushes: Pushes, known: Identifiability) -> Figure:
    """Draw F_p and d over speed as measured, and as the set-up leads to."""
    slides = pushes.free_slides
    v = to_mm_min(pushes.release_velocity if slides else pushes.velocity)
    panels = [
        (y, error, expected, label)
        for y, error, expected, label in (
            (pushes.peak_force, pushes.peak_force_se, known.peak_force, "force $F_p$ [N]"),
            (
                to_um(pushes.sliding_distance),
                to_um(pushes.sliding_distance_se),
                to_um(known.sliding_distance),
                "sliding distance d [µm]",
            ),
        )
        if np.isfinite(y).any()
    ]
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(len(panels), 4.6 * len(panels) + 0.4, 3.4, squeeze=False)
        for ax, (y, error, expected, label) in zip(axes[0], panels, strict=True):
            for condition, mine, colour, marker in group_by_condition(pushes.condition):
                bars, name = np.nan_to_num(error[mine]), write_name(condition) or "measured"
                ax.errorbar(
                    v[mine], y[mine], bars, fmt=marker, color=colour, **OPEN_MARKS, label=name
                )
            ax.plot(v, expected, "+", color="#222", ms=7, mew=1, label="set-up")
            both = np.concatenate([y[np.isfinite(y)], expected[np.isfinite(expected)]])
            if both.min() > 0 and both.max() > 100 * both.min():
                ax.set_yscale("log")
            ax.set_xlabel("release speed [mm/min]" if slides else "pusher speed v [mm/min]")
            ax.set_ylabel(label)
        axes[0, 0].legend(fontsize=8)
    return figure
