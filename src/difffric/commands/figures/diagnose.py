"""Figures of a diagnosis: where the misfit sits before and after, and what each effect explains."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from difffric.commands.figures.style import STYLE, make_figure, name_curve, write_name
from difffric.diagnosis.location import Location
from difffric.diagnosis.misfit import Misfit
from difffric.diagnosis.verdict import Diagnosis
from difffric.units import to_mm_min

_BEFORE, _AFTER = "#c0392b", "#2c6fbb"
_PLAIN, _WITH_CAUSES = "plain model", "with its causes"
_WIDE = 30
"""Ratio of the largest to the smallest squared residual from which on their axis is logarithmic:
within less, a logarithmic axis shows few numbers."""


def draw_misfit(found: Diagnosis) -> Figure:
    """Draw chi-square per number of each push, force and position, before and after."""
    data = found.state.data
    counts = np.maximum(data.task.counts, 1)
    v = to_mm_min(np.asarray(data.measured.velocity))
    order = np.argsort(v, kind="stable")
    x = np.arange(len(v))
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(2, 9.6, 3.8, sharey=True)
        shown: list[float] = []
        names = ("force", "position" if found.used_recordings else "sliding distance")
        for k, (ax, name) in enumerate(zip(axes, names, strict=True)):
            drawn = [(found.state.lack_before, _BEFORE, _PLAIN, -0.15)]
            if found.causes:
                drawn.append((found.state.lack_after, _AFTER, _WITH_CAUSES, 0.15))
            for lack, colour, label, shift in drawn:
                y = (lack.chi2[:, k] / counts[:, k])[order]
                ax.plot(x + shift, y, "o", ms=4, color=colour, label=label)
                shown.extend(y)
            ax.axhline(1.0, color="0.5", lw=1, ls=":")
            ax.set(title=name, xlabel="push, by speed [mm/min]")
            ax.set_xticks(x[:: max(1, len(x) // 7)])
            ax.set_xticklabels([f"{s:.0f}" for s in v[order][:: max(1, len(x) // 7)]])
        _choose_scale(axes[0], shown)  # of both, which share it
        axes[0].set_ylabel("squared residual per number,\nin units of the noise (1 is perfect)")
        axes[0].legend(frameon=False, fontsize=9)
    return figure


_SCALE = {"m/s": (to_mm_min(1.0), "mm/min"), "m": (1e3, "mm"), "s": (1e3, "ms"), "": (1.0, "")}


def draw_where(found: Diagnosis) -> Figure:
    """The misfit by phase and over what changes during a push and between pushes, before and
    after."""
    channels = list(dict.fromkeys(one.channel for one in found.misfit))
    columns = list(dict.fromkeys(one.by for one in found.misfit))
    with matplotlib.rc_context(STYLE):
        rows, width = len(channels), 2.2 * len(columns)
        options = {"rows": rows, "sharey": "row", "squeeze": False}
        figure, axes = make_figure(len(columns), width, 2.4 * rows, **options)
        for ax in axes.flat:
            ax.set_visible(False)
        for one in found.misfit:
            ax = axes[channels.index(one.channel), columns.index(one.by)]
            ax.set_visible(True)
            _one(ax, one, bool(found.causes))
            if one.channel == channels[0]:
                ax.set_title(write_name(one.by))
        for row, channel in enumerate(channels):
            axes[row, 0].set_ylabel(f"{channel}\n(1 is perfect)")
    return figure


def _one(ax, one: Misfit, causes: bool) -> None:
    scale, unit = _SCALE[one.unit]
    named = isinstance(one.at[0], str)
    x = np.arange(len(one.at)) if named else scale * np.array(one.at, float)
    drawn = [(one.before, _BEFORE, _PLAIN)]
    if causes:
        drawn.append((one.after, _AFTER, _WITH_CAUSES))
    for y, colour, label in drawn:
        style = "o" if named else "o-"
        ax.plot(x, y, style, ms=4, lw=1, color=colour, label=name_curve(label))
    ax.axhline(1.0, color="0.5", lw=1, ls=":")
    _choose_scale(ax, [value for y, *_ in drawn for value in y])
    if named:
        ax.set_xticks(
            x, [write_name(str(name)) for name in one.at], rotation=30, ha="right", fontsize=8
        )
        ax.set_xlim(-0.5, len(x) - 0.5)
    elif unit:
        ax.set_xlabel(f"[{unit}]")


def _choose_scale(ax, shown: Sequence[float]) -> None:
    """Make the axis of squared residuals logarithmic where they differ by far."""
    if max(shown) > _WIDE * max(min(shown), 0.1):
        ax.set_yscale("log")


def draw_residuals(found: Diagnosis, shown: int = 3) -> Figure:
    """Draw whitened residuals over time of the pushes that fit worst, before and after."""
    state, task = found.state, found.state.data.task
    worst = np.argsort(-state.lack_before.chi2.sum(axis=1) / task.counts.sum(axis=1))[:shown]
    drawn = [(state.plain, _BEFORE, _PLAIN)]
    if found.causes:
        drawn.append((state.extended, _AFTER, _WITH_CAUSES))
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(len(worst), 3.4 * len(worst), 4.6, rows=2, squeeze=False)
        for column, i in enumerate(worst):
            for k, blocks in enumerate(task.model.pushes.data):
                ax, there = axes[k, column], blocks.a[i] > 0
                t = 0.5e3 * (blocks.t[i][blocks.first[i]] + blocks.t[i][blocks.second[i]])[there]
                for fits, colour, label in drawn:
                    y = fits.residual[0, i, k][there]
                    ax.plot(t, y, color=colour, lw=0.9, alpha=0.8, label=name_curve(label))
                ax.axhline(0.0, color="0.5", lw=0.8)
                ax.set_xlim(t[0], t[-1])
                if k == 0:
                    ax.set_title(f"{to_mm_min(float(state.data.measured.velocity[i])):.0f} mm/min")
                else:
                    ax.set_xlabel("time [ms]")
        axes[0, 0].set_ylabel("force residual\n[standard deviations]")
        axes[1, 0].set_ylabel("position residual\n[standard deviations]")
    return figure


def draw_location(found: Location) -> Figure:
    """Draw what each free form explains, and the best one's curve with its band."""
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(2, 9.6, 3.6)
        names = sorted(found.explained, key=lambda name: found.explained[name])
        colours = [_AFTER if name == found.form else "0.7" for name in names]
        shares = [100 * found.explained[name] for name in names]
        axes[0].barh([name.replace("_", " ") for name in names], shares, color=colours)
        axes[0].set(xlabel="share of the misfit that it explains [%]", xlim=(0, 100))
        scale, unit = (1e3, "m" + found.unit) if found.unit != "N" else (1.0, "N")
        x, y, se = scale * found.x, 100 * found.correction, 100 * found.standard_error
        axes[1].fill_between(x, y - 2 * se, y + 2 * se, color=_AFTER, alpha=0.2, lw=0)
        axes[1].plot(x, y, color=_AFTER)
        axes[1].axhline(0.0, color="0.5", lw=0.8)
        room = 0.3 * np.ptp(y) + 1e-9
        axes[1].set(
            xlabel=f"{found.quantity} [{unit}]",
            ylabel="correction [%]",
            xlim=(0, x[-1]),
            ylim=(y.min() - room, y.max() + room),
            title=found.form.replace("_", " "),
        )
    return figure
