"""The pictures of `difffric identify`; they load no calibration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from difffric.commands.figures.friction_of_pushes import draw_friction_of_pushes
from difffric.commands.figures.style import (
    OPEN_MARKS,
    STYLE,
    group_by_condition,
    make_figure,
    write_name,
)
from difffric.identification.estimates import WAYS, Identified
from difffric.units import to_mm_min

_TITLES = {
    "mu_s_force": "from the force",
    "mu_s_distance": "from the distance",
    "mu_s_weighted": "by equation (7)",
    "mu_s_optimal": "optimal combination",
    "mu_s_slide": "from the free slide",
    "mu_s_trace": "from the whole recording",
}


def draw_identified(found: Identified, velocity: NDArray) -> Figure:
    """Draw mu_s of each push over its speed (n,) [m/s], a panel for each way to it."""
    ways = [way for way in WAYS if np.isfinite(found.values(way)).any()] or ["mu_s_optimal"]
    v = to_mm_min(velocity)
    best = np.array([np.nan if p.best.value is None else p.best.value for p in found])
    with matplotlib.rc_context(STYLE):
        columns = 2 if len(ways) == 4 else min(len(ways), 3)
        rows = -(-len(ways) // columns)
        figure, axes = make_figure(
            columns,
            3.5 * columns + 0.6,
            3.0 * rows,
            rows=rows,
            squeeze=False,
            sharey=True,
            sharex=True,
        )
        conditions = [p.condition for p in found]
        for condition, mine, colour, marker in group_by_condition(conditions):
            for ax, way in zip(axes.flat, ways, strict=False):
                if np.isfinite(best[mine]).any():
                    ax.axhline(np.nanmean(best[mine]), color=colour, lw=0.8, ls=":")
                error = np.nan_to_num(found.standard_errors(way)[mine])
                ax.errorbar(
                    v[mine],
                    found.values(way)[mine],
                    error,
                    fmt=marker,
                    color=colour,
                    **OPEN_MARKS,
                    label=write_name(condition) or "each push",
                )
        misfits = np.array([p.misfits for p in found])
        if misfits.any() and "mu_s_trace" in ways:
            ax = axes.flat[ways.index("mu_s_trace")]
            ax.plot(v[misfits], found.values("mu_s_trace")[misfits], "x", color="#666", ms=9)
        for ax, way in zip(axes.flat, ways, strict=False):
            ax.set_title(_TITLES[way], fontsize=10)
        known = np.concatenate([found.values(way) for way in ways])
        known = known[np.isfinite(known)]
        if len(known):  # a vague estimate's bar may leave the panel
            room = 0.2 * np.ptp(known) or 0.1 * known.max()
            axes[0, 0].set_ylim(known.min() - room, known.max() + room)
        for ax in axes.flat[len(ways) :]:
            ax.set_visible(False)
        slides = all(np.isnan(p.velocity) for p in found)
        for ax in axes.flat[max(0, len(ways) - columns) : len(ways)]:  # the last of each column
            ax.set_xlabel("release speed [mm/min]" if slides else "pusher speed v [mm/min]")
            ax.tick_params(labelbottom=True)
        for ax in axes[:, 0]:
            ax.set_ylabel(r"$\mu_s$")
        if any(conditions):
            axes[0, 0].legend(fontsize=8)
    return figure


def draw_best_estimates(found: Identified, order: NDArray, summary: Mapping[str, Any]) -> Figure:
    """Draw the best mu_s of each push over the order (n,) of the pushes, and the means."""
    means = {
        condition: (of["mean"], of["spread"] or 0.0)
        for condition, of in summary.items()
        if of["mean"] is not None
    }
    value = np.array([np.nan if p.best.value is None else p.best.value for p in found])
    error = np.array([p.best.standard_error or 0.0 for p in found])
    conditions = [p.condition for p in found]
    return draw_friction_of_pushes(conditions, order, value, error, means, "mean ± spread")
