"""What a page's script is told of a panel of a figure: its axes, and what its lines are."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection, LineCollection, QuadMesh
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.dates import DateLocator
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Annotation, Text
from matplotlib.ticker import FixedFormatter

_CELLS = 80
"""Cells of a coloured map in each direction whose values are kept, at most."""
_DIGITS = 6
"""Significant digits of a point with an error bar: as many as the read-out shows."""


def describe_panel(ax: Axes, place: str, size: tuple[float, float]) -> dict[str, Any]:
    """Return what the page's script knows of a panel, once it has been drawn.

    `place` is the panel's name, `size` the drawing's width and height. The script finds the values
    in the drawing itself: told are the axes, and for each of its parts what it is.
    """
    width, height = size
    box = ax.get_position()
    bars = [_describe_bars(ax, x) for x in ax.containers if isinstance(x, BarContainer)]
    return {
        "id": place,
        "box": [box.x0 * width, (1 - box.y1) * height, box.x1 * width, (1 - box.y0) * height],
        "x": _describe_axis(ax, "x"),
        "y": _describe_axis(ax, "y"),
        "title": write_plain(ax.get_title()),
        "parts": [*filter(None, (_describe_part(ax, one, size) for one in ax.get_children()))],
        "map": _describe_map(ax),
        "bars": [bar for some in bars for bar in some],
    }


def write_plain(text: str) -> str:
    """Return a text of a figure without matplotlib's marks for formulas."""
    pieces = re.split(r"(?<!\\)\$", text)
    if len(pieces) % 2 == 0:  # no formula: a single $ is one
        pieces = [text]
    pieces[1::2] = [re.sub(r"\\mathdefault|[\\{}]", "", x) for x in pieces[1::2]]
    return " ".join("".join(pieces).replace(r"\$", "$").split())


def _describe_axis(ax: Any, letter: str) -> dict[str, Any]:
    axis, low_high = getattr(ax, f"{letter}axis"), getattr(ax, f"get_{letter}lim")()
    shared = getattr(ax, f"get_shared_{letter}_axes")().get_siblings(ax)
    words = [axis.get_label_text(), *(getattr(x, f"get_{letter}label")() for x in shared)]
    scale, told = axis.get_scale(), {}
    if scale == "symlog":
        own = axis.get_transform()
        told = {"threshold": own.linthresh, "linear": own.linscale, "base": own.base}
    elif isinstance(axis.get_major_locator(), DateLocator):
        scale = "date"
    named = isinstance(axis.get_major_formatter(), FixedFormatter) and len(axis.get_ticklocs()) > 0
    if named or scale == "symlog":
        labels = [write_plain(x.get_text()) for x in axis.get_ticklabels()]
        told["ticks"] = [
            [float(at), label] for at, label in zip(axis.get_ticklocs(), labels, strict=True)
        ]
    tick = axis.get_major_ticks(1)[0] if axis.get_major_ticks() else None
    return {
        "scale": scale,
        "limits": [float(x) for x in low_high],
        "label": write_plain(next(filter(None, words), "")),
        "group": min(x.get_gid() or "" for x in shared),
        "labelled": bool(tick and tick.label1.get_visible()),
        "grid": bool(tick and tick.gridline.get_visible()),
        **told,
    }


def _describe_part(ax: Any, artist: Any, size: tuple[float, float]) -> dict[str, Any] | None:
    """What a part does when its panel is zoomed, and what it is called; None: it stays."""
    if not isinstance(artist, (Line2D, Collection, Patch, Text)) or artist is ax.patch:
        return None
    if isinstance(artist, Annotation):
        coords: Any = artist.xycoords
        coords = coords if isinstance(coords, tuple) else (coords, coords)
        along = tuple(
            one == "data" or (not isinstance(one, str) and one.contains_branch_seperately(
                ax.transData)[i]) for i, one in enumerate(coords)
        )  # fmt: skip
        anchor = artist.xy
    elif isinstance(artist, Collection) and artist.get_offset_transform().contains_branch(
        ax.transData
    ):
        along, anchor = (True, True), (0, 0)
    else:
        along = artist.get_transform().contains_branch_seperately(ax.transData)
        anchor = artist.get_position() if isinstance(artist, Text) else (0, 0)
    if not any(along):
        return None
    label = str(artist.get_label())
    told: dict[str, Any] = {"id": artist.get_gid(), "x": bool(along[0]), "y": bool(along[1])}
    if isinstance(artist, Text):
        if not artist.get_text():
            return None
        low = [getattr(ax, f"get_{letter}lim")()[0] for letter in "xy"]
        data = [at if moves else start for at, moves, start in zip(anchor, along, low, strict=True)]
        px, py = ax.transAxes.inverted().transform(ax.transData.transform(data))
        box = ax.get_position()
        told["at"] = [
            (box.x0 + px * box.width) * size[0],
            (1 - box.y0 - py * box.height) * size[1],
        ]
    elif isinstance(artist, Line2D):
        told["line"] = True
        errors = _find_errors(ax, artist)
        if errors:
            told["errors"] = errors
            label = next(str(x.get_label()) for x in ax.containers if artist in list(x))
    told["name"] = (
        "" if re.match(r"_child\d+$|_nolegend_$", label) else write_plain(label.lstrip("_"))
    )
    return told


def _find_errors(ax: Any, line: Line2D) -> list[list[float]]:
    """Return [x, y, error] of the points of a line with error bars."""
    for one in ax.containers:
        if not (isinstance(one, ErrorbarContainer) and one[0] is line and one[2]):
            continue
        bars: LineCollection = one[2][0]
        xy = np.column_stack([np.asarray(a, float) for a in line.get_data()])
        halves = [abs(s[-1][1] - s[0][1]) / 2 if len(s) else 0.0 for s in bars.get_segments()]
        if len(halves) != len(xy):
            return []
        return [
            [*map(_round, (x, y, half))]
            for (x, y), half in zip(xy, halves, strict=True)
            if np.isfinite([x, y, half]).all() and half > 0
        ]
    return []


def _round(x: float) -> float:
    return float(f"{x:.{_DIGITS}g}")


def _describe_map(ax: Any) -> dict[str, Any] | None:
    """Return the values of a coloured map, of a large one each second or third cell."""
    for artist in ax.get_children():
        if isinstance(artist, AxesImage):
            values = np.ma.filled(np.ma.asarray(artist.get_array(), float), np.nan)
            left, right, bottom, top = artist.get_extent()
            if artist.origin == "upper":
                bottom, top = top, bottom
        elif isinstance(artist, QuadMesh):
            edges = np.asarray(artist.get_coordinates())
            array = np.ma.asarray(artist.get_array(), float)
            values = np.ma.filled(array, np.nan).reshape(edges.shape[0] - 1, edges.shape[1] - 1)
            (left, bottom), (right, top) = edges[0, 0], edges[-1, -1]
        else:
            continue
        if values.ndim != 2:
            return None
        rows, columns = (max(1, -(-n // _CELLS)) for n in values.shape)
        values = values[::rows, ::columns]
        cells = [None if not np.isfinite(x) else float(f"{x:.3g}") for x in values.ravel()]
        return {
            "x": [float(left), float(right)],
            "y": [float(bottom), float(top)],
            "shape": list(values.shape),
            "values": cells,
        }
    return None


def _describe_bars(ax: Any, bars: BarContainer) -> list[list[float]]:
    """Return [left, right, bottom, top] of each bar."""
    boxes = [bar.get_bbox() for bar in bars]
    return [[float(x) for x in (b.x0, b.x1, b.y0, b.y1)] for b in boxes]
