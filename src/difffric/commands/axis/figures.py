"""Pictures of an axis: friction over speed, what is left over, and the motion."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from difffric.axis.motion.trajectory import AxisTrajectory
from difffric.axis.residual_forces import measure_friction, predict_runs
from difffric.axis.result import AxisFit, FrictionLevel
from difffric.axis.setup import AxisSetup
from difffric.commands.figures.style import OPEN_MARKS, STYLE, make_figure
from difffric.units import to_mm, to_um

_WAYS = ((1, "#1f6f8b", "forwards"), (-1, "#b4532a", "backwards"))
_MOST_POINTS = 4000
"""Points that are drawn of a long recording at most."""
_SPEED_OVER = 0.03
"""Seconds that a drawn speed is made of."""


def draw_friction(fit: AxisFit) -> Figure:
    """Draw the friction over the speed: measured, and the fitted law."""
    found = measure_friction(fit)
    with matplotlib.rc_context(STYLE):
        figure, ax = make_figure(width=7.2, height=4.4)
        for sign, colour, word in _WAYS:
            mine = found.sign == sign
            if not mine.any():
                continue
            some = np.flatnonzero(mine)[:: max(1, mine.sum() * 2 // _MOST_POINTS)]
            ax.plot(found.speed[some], found.friction[some], ".", color=colour, ms=3, alpha=0.25,
                    mew=0, label=f"{word}, measured")  # fmt: skip
            order = np.argsort(found.speed[mine])
            ax.plot(found.speed[mine][order], found.law[mine][order], color=colour, lw=1.6,
                    label=f"{word}, fitted")  # fmt: skip
        low, high = np.quantile(found.friction, [0.002, 0.998])
        room = 0.15 * (high - low)
        ax.set_ylim(low - room, high + room)
        ax.axhline(0, color="#333", lw=0.6)
        ax.set_xlabel("speed [m/s]")
        ax.set_ylabel("friction [N]")
        ax.legend(fontsize=8, markerscale=3, loc="upper left")
    return figure


def draw_residual(fit: AxisFit, plain: AxisFit | None = None) -> Figure:
    """Draw the force that is left over, over the position; above that of the plain axis, where
    there is one beside the fitted one."""
    both = [x for x in (plain, fit) if x is not None]
    titles = ["plain axis", "extended"] if len(both) == 2 else [""]
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(
            1, 7.2, 1.2 + 2.6 * len(both), rows=len(both), squeeze=False, sharex=True, sharey=True
        )
        spread = 0.0
        for ax, one, title in zip(axes[:, 0], both, titles, strict=True):
            found = measure_friction(one)
            left = found.friction - found.law
            for sign, colour, word in _WAYS:
                mine = found.sign == sign
                if not mine.any():
                    continue
                x = to_mm(found.position[mine])
                edges = np.linspace(x.min(), x.max() + 1e-9, 61)
                place = np.digitize(x, edges) - 1
                count = np.bincount(place, minlength=60)[:60]
                mean = np.bincount(place, left[mine], minlength=60)[:60] / np.maximum(count, 1)
                middle = (edges[1:] + edges[:-1]) / 2
                some = np.flatnonzero(mine)[:: max(1, mine.sum() * 2 // _MOST_POINTS)]
                ax.plot(to_mm(found.position[some]), left[some], ".", color=colour, ms=2,
                        alpha=0.15, mew=0)  # fmt: skip
                seen = count > 0
                ax.plot(middle[seen], mean[seen], color=colour, lw=1.3, label=word)
            spread = max(spread, float(np.quantile(np.abs(left), 0.98)))
            ax.set_ylim(-1.3 * spread, 1.3 * spread)
            ax.axhline(0, color="#333", lw=0.6)
            ax.set_ylabel("force left over [N]")
            ax.set_title(title, fontsize=10)
        axes[-1, 0].set_xlabel("position [mm]")
        axes[0, 0].legend(fontsize=8, loc="upper right")
    return figure


def draw_prediction(fit: AxisFit) -> Figure:
    """Draw the positions, measured and predicted over each run, and their difference."""
    found = predict_runs(fit)
    with matplotlib.rc_context(STYLE):
        figure, (top, bottom) = make_figure(
            1, 7.2, 5.0, rows=2, sharex=True, height_ratios=(2.2, 1.3)
        )
        for i, run in enumerate(found):
            step = max(1, len(run.time) * len(found) // _MOST_POINTS)
            top.plot(run.time[::step], to_mm(run.measured[::step]), ".", color="#1f6f8b", ms=2.5,
                     mew=0, label="measured" if i == 0 else None)  # fmt: skip
            top.plot(run.time[::step], to_mm(run.predicted[::step]), color="#b4532a", lw=0.9,
                     label="predicted" if i == 0 else None)  # fmt: skip
            off = to_um(run.measured - run.predicted)
            bottom.plot(run.time[::step], off[::step], ".", color="#1f6f8b", ms=1.5, mew=0)
        top.set_ylabel("position [mm]")
        top.legend(fontsize=8, loc="upper right", markerscale=3)
        bottom.axhline(0, color="#333", lw=0.6)
        bottom.set_ylabel("difference [µm]")
        bottom.set_xlabel("time [s]")
    return figure


def draw_levels(setup: AxisSetup, levels: Sequence[FrictionLevel]) -> Figure:
    """Draw the Coulomb friction of each stretch."""
    with matplotlib.rc_context(STYLE):
        figure, ax = make_figure(width=6.4, height=3.6)
        known = [
            (i + 1, x.coulomb, x.standard_error)
            for i, x in enumerate(levels)
            if x.coulomb is not None
        ]
        place, value, error = (np.array(x, float) for x in zip(*known, strict=True))
        ax.errorbar(place, value, error, fmt="o", color="#1f6f8b", **OPEN_MARKS)
        ax.axhline(setup.coulomb, color="#b4532a", lw=1)
        ax.set_xlabel("stretch")
        ax.set_ylabel("Coulomb friction [N]")
    return figure


def draw_motion(moved: AxisTrajectory, force: NDArray, measured: NDArray | None) -> Figure:
    """Draw force, position and speed of a simulated motion."""
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(1, 7.2, 6.0, rows=3, sharex=True)
        step = max(1, len(moved.time) // _MOST_POINTS)
        t = moved.time[::step]
        axes[0].plot(t, force[::step], color="#1f6f8b", lw=0.8)
        axes[0].set_ylabel("force [N]")
        if measured is not None:
            axes[1].plot(t, to_mm(measured[::step]), color="#1f6f8b", lw=2.2, alpha=0.5,
                         label="recorded")  # fmt: skip
        axes[1].plot(t, to_mm(moved.position[::step]), color="#b4532a", lw=1, label="simulated")
        axes[1].set_ylabel("position [mm]")
        axes[1].legend(fontsize=8)
        axes[2].plot(t, moved.speed[::step], color="#b4532a", lw=0.8)
        axes[2].set_ylabel("speed [m/s]")
        axes[2].set_xlabel("time [s]")
    return figure


def draw_traces(fit: AxisFit) -> Figure:
    """Draw force, position and speed of the recording over time: runs coloured by their way, what
    lies between them grey."""
    t, force, position, speed = ([] for _ in range(4))
    way = []
    for k, stretch in enumerate(fit.data.stretches):
        sign = np.zeros(len(stretch))
        for run in fit.runs:
            if run.run.stretch == k:
                sign[run.run.samples] = run.run.sign
        way.append(sign)
        t.append(stretch.time)
        force.append(stretch.force)
        position.append(to_mm(stretch.position))
        speed.append(_smooth_speed(stretch.time, stretch.position))
    columns = [np.concatenate(x) for x in (t, force, position, speed, way)]
    step = max(1, len(columns[0]) // (2 * _MOST_POINTS))
    time, *lines, sign = (x[::step] for x in columns)
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(1, 7.2, 6.0, rows=3, sharex=True)
        labels = ("force [N]", "position [mm]", "speed [mm/s]")
        for ax, line, label in zip(axes, lines, labels, strict=True):
            for s, colour, word in (*_WAYS, (0, "#999", "rest, turn")):
                mine = np.where(sign == s, line, np.nan)
                ax.plot(time, mine, ".", color=colour, ms=2, mew=0, label=word)
            ax.set_ylabel(label)
        axes[-1].set_xlabel("time [s]")
        axes[0].legend(fontsize=8, markerscale=5, loc="lower right", bbox_to_anchor=(1, 1), ncols=3)
    return figure


def _smooth_speed(time: NDArray, position: NDArray) -> NDArray:
    """The speed (n,) over some hundredths of a second [mm/s]."""
    width = max(1, round(_SPEED_OVER / float(np.median(np.diff(time)))))
    width = min(width, max(1, (len(time) - 1) // 2))
    slope = (position[width:] - position[:-width]) / (time[width:] - time[:-width])
    before = width // 2
    return to_mm(np.concatenate([
        np.full(before, slope[0]), slope, np.full(width - before, slope[-1])
    ]))  # fmt: skip
