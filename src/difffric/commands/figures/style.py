"""What all figures look like: colours, marks, and an empty figure to draw on."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from difffric.name_text import shorten_name

COLOURS = {"DRY": "#b4532a", "OILY": "#1f6f8b"}
"""Of the paper's conditions: the same in every figure."""
_OTHERS = ("#1f6f8b", "#b4532a", "#5b7f3b", "#7a4f9a", "#b08a1e", "#555555")
MARKERS = "osD^vP"
"""Marks of one condition after another, where a print has no colours."""
OPEN_MARKS: Any = {"ms": 5, "mfc": "none", "lw": 1, "capsize": 2}
"""How measured points and their error bars are drawn."""
STYLE: Any = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "font.size": 10,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "difffric",
}


def write_name(name: str, most: int = 24) -> str:
    """Return a name from a user's file as a figure may show it: its letters as they are, never a
    formula, on one line of at most so many letters."""
    line = shorten_name(name, most).replace("$", r"\$")
    # Matplotlib leaves labels that begin with an underscore out of legends.
    return f" {line}" if line.startswith("_") else line


def name_curve(*words: str) -> str:
    """Return the label of a curve that a page's read-out names and a legend leaves out."""
    return "_" + ", ".join(filter(None, map(write_name, words)))


def choose_colours(conditions: Sequence[str]) -> dict[str, str]:
    """Return a colour for each condition, in order of appearance; DRY and OILY have their own."""
    names = list(dict.fromkeys(conditions))
    taken = {COLOURS[c] for c in names if c in COLOURS}
    others = cycle([c for c in _OTHERS if c not in taken])
    return {c: COLOURS[c] if c in COLOURS else next(others) for c in names}


def group_by_condition(conditions: Sequence[str]) -> list[tuple[str, NDArray, str, str]]:
    """Return (condition, mask (n,), colour, marker), an entry a condition of the n pushes."""
    colours = choose_colours(conditions)
    return [
        (c, np.array([x == c for x in conditions]), colour, MARKERS[i % len(MARKERS)])
        for i, (c, colour) in enumerate(colours.items())
    ]


def make_figure(
    columns: int = 1, width: float = 6.4, height: float = 4.0, rows: int = 1, **options: Any
) -> tuple[Figure, Any]:
    """Return an empty figure in the style of all, and its axes; `options` are those of `subplots`.

    Width and height are in inches.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.subplots(rows, columns, **options)
    return figure, axes
