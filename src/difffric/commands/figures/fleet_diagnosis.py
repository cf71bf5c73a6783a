"""The figure of a fleet's diagnosis: rigs by effects, coloured by the evidence."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from difffric.commands.figures.style import STYLE, write_name
from difffric.fleet.shared_effects import NAMED, NOT_VISIBLE, POSSIBLE, Row

MOST = 10.0
"""-log10 of the probability at which the colour is full."""
_ALL = "all rigs"
_RED, _GREY = "#b4532a", "#d9d9d9"
_EVIDENCE = LinearSegmentedColormap.from_list("evidence", ["#ffffff", "#9cc3dc", "#1f5f8b"])


def draw_matrix(
    rows: Sequence[Row], rigs: Sequence[str], words: Mapping[str, str], odd: Collection[str]
) -> Figure:
    """Effects (columns) over rigs, the evidence of all together on top. `words`: of a rig without
    evidence, instead of it; `odd`: rigs that differ, whose names are red."""
    n, m = len(rigs), len(rows)
    p = np.full((n, m), np.nan)
    for j, row in enumerate(rows):
        for i, rig in enumerate(rigs):
            if row.marks.get(rig) != NOT_VISIBLE:
                p[i, j] = row.p_values.get(rig, np.nan)
    total = np.array([[row.p_value for row in rows]])
    with matplotlib.rc_context({**STYLE, "axes.grid": False}):
        top, below = 0.3, 0.27 * n
        figure = Figure(figsize=(9.6, 2.9 + top + below), layout="constrained")
        upper, lower = figure.subplots(2, 1, height_ratios=(top, below), sharex=True)
        for ax, values in ((upper, total), (lower, p)):
            shown = np.ma.masked_invalid(-np.log10(np.maximum(values, 1e-300)))
            ax.set_facecolor(_GREY)
            image = ax.pcolormesh(
                np.arange(m + 1) - 0.5,
                np.arange(len(values) + 1) - 0.5,
                shown,
                vmin=0,
                vmax=MOST,
                cmap=_EVIDENCE,
                edgecolors="#ececec",
                linewidth=0.8,
            )
            ax.set_ylim(len(values) - 0.5, -0.5)
            ax.tick_params(length=0)
            for side in ax.spines.values():
                side.set_visible(False)
        for j, row in enumerate(rows):
            for i, rig in enumerate(rigs):
                mark = row.marks.get(rig)
                if mark in (NAMED, POSSIBLE):
                    lower.plot(j, i, "o", **_look(mark), zorder=3)
        for i, rig in enumerate(rigs):
            if rig in words:
                lower.text((m - 1) / 2, i, words[rig], ha="center", va="center", fontsize=9)
        upper.set_yticks([0], [_ALL], fontweight="bold")
        lower.set_yticks(range(n), [write_name(rig, 28) for rig in rigs], fontsize=9)
        for label, rig in zip(lower.get_yticklabels(), rigs, strict=True):
            if rig in odd:
                label.set(color=_RED, fontweight="bold")
        lower.set_xticks(range(m), [row.effect.replace("_", " ") for row in rows], fontsize=9)
        lower.tick_params("x", rotation=55)
        for label in lower.get_xticklabels():
            label.set(ha="right", rotation_mode="anchor")
        bar = figure.colorbar(
            image,
            ax=[upper, lower],
            shrink=min(1.0, 2.4 / (top + below)),
            pad=0.01,
            aspect=12,
            anchor=(0.0, 1.0),
        )
        bar.set_ticks(
            [0, 2, 4, 6, 8, 10],
            labels=["1", *(f"$10^{{-{k}}}$" for k in (2, 4, 6, 8)), "$10^{-10}$"],
        )
        bar.set_label("probability that chance\ngives as much", fontsize=9)
        outline: Any = bar.outline  # matplotlib's stubs take it for a function
        outline.set_visible(False)
        handles = [
            Line2D([], [], ls="", marker="o", **_look(NAMED), label="named"),
            Line2D([], [], ls="", marker="o", **_look(POSSIBLE), label="cannot be told from it"),
            Patch(color=_GREY, label="cannot be seen, or no evidence"),
        ]
        handles += [Line2D([], [], ls="", label="red name: the rig differs")] * bool(odd)
        figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=9)
    return figure


def _look(mark: str) -> dict:
    fill = _RED if mark == NAMED else "none"
    return {"ms": 7, "mfc": fill, "mec": _RED, "mew": 1.4}
