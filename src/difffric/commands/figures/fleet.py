"""The figure of a fleet: mu_s of each rig over the dates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date

import matplotlib
import numpy as np
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure

from difffric.commands.figures.style import STYLE, make_figure, write_name

MOST = 12
"""Rigs that have a line and a name of their own; of more, the rest is drawn in grey."""


def draw_by_date(days: Mapping[str, Sequence[Mapping]]) -> Figure:
    """Draw the mean mu_s of each day, with bars of one standard deviation between its pushes.

    `days` has for each rig its days, each with `date`, `mu_s_mean` and `spread`.
    """
    ranked = sorted(days, key=lambda rig: -len(days[rig]))
    named = set(ranked[:MOST])
    with matplotlib.rc_context(STYLE):
        figure, ax = make_figure(width=8.6, height=4.6)
        colours = iter(matplotlib.color_sequences["tab20"])
        for rig, rows in days.items():
            at = date2num([date.fromisoformat(row["date"]) for row in rows])
            mean = np.array([row["mu_s_mean"] for row in rows], float)
            bar = np.array([row["spread"] or 0.0 for row in rows], float) * mean
            look = {"color": "#bbb", "zorder": 1}
            if rig in named:
                look = {"color": next(colours), "label": write_name(rig), "zorder": 2}
            ax.errorbar(at, mean, bar, fmt="o-", ms=4, lw=0.8, elinewidth=0.8, capsize=2, **look)
        locator = AutoDateLocator(minticks=2)
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        every = np.concatenate(
            [date2num([date.fromisoformat(r["date"]) for r in rows]) for rows in days.values()]
        )
        ax.set_xlim(every.min() - 0.7, every.max() + 0.7)
        ax.set_ylabel("mu_s, mean of a day")
        ax.legend(fontsize=8, ncols=6, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure
