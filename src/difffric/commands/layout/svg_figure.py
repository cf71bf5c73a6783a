"""A matplotlib figure as SVG inside a page: its text is text, its colours follow the page's scheme,
and each of its panels says what a script needs to zoom it and to read values out."""

from __future__ import annotations

import io
import re
import warnings
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from difffric.commands.layout.dark_colours import to_dark
from difffric.commands.layout.panel_description import describe_panel

_SVG, _XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_STYLE: Any = {"svg.fonttype": "none", "svg.hashsalt": "difffric"}
_COLOUR = re.compile(r"#[0-9a-fA-F]{6}\b")
_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_FONT = re.compile(r"font: ((?:\w+ )*)([\d.]+)px [^;]*")
"""matplotlib's words for a font: weight and slant, size, and the names of a dozen of fonts."""
_DOTS = 400
"""Marks of one line from which on they are drawn as one path: as elements they make a page slow."""


@dataclass(frozen=True)
class SvgFigure:
    """A figure for a page."""

    svg: str
    panels: list[dict]
    """what each panel that can be zoomed shows, for the page's script"""
    colours: dict[str, str]
    """each colour that the drawing uses, and what stands for it on dark ground"""
    width: int
    """in CSS pixels, as it is drawn"""


def draw_svg(figure: Figure, name: str) -> SvgFigure:
    """Return a figure as SVG; `name` begins the names of its parts, and is the page's only one."""
    places = {f"{name}.{i}": ax for i, ax in enumerate(figure.axes) if ax.get_visible()}
    for place, ax in places.items():
        _name_parts(ax, place)
    buffer = io.StringIO()
    with warnings.catch_warnings(), matplotlib.rc_context(_STYLE):
        # A letter that matplotlib's own font lacks is measured as a box, and shown by the browser.
        warnings.filterwarnings("ignore", r"Glyph \d+")
        figure.savefig(buffer, format="svg", facecolor="none", metadata={"Date": None})
    ET.register_namespace("", _SVG)
    root = ET.fromstring(buffer.getvalue())
    width, height = (float(x) for x in root.attrib["viewBox"].split()[2:])
    panels = [
        describe_panel(ax, place, (width, height)) for place, ax in places.items() if _can_zoom(ax)
    ]
    colours = _Colours()
    # What stands on a coloured map keeps its colours, as the map does.
    on_maps = {part["id"] for panel in panels if panel["map"] for part in panel["parts"]}
    _rewrite(root, name, colours, on_maps)
    for key in ("width", "height", "version"):
        root.attrib.pop(key, None)
    for group in root.iter():  # the page has the style of all drawings
        for part in [x for x in group if x.tag in (f"{{{_SVG}}}metadata", f"{{{_SVG}}}style")]:
            group.remove(part)
    return SvgFigure(
        # HTML needs no name space, and the page names no address.
        ET.tostring(root, encoding="unicode").replace(f' xmlns="{_SVG}"', ""),
        panels,
        colours.found,
        round(width / 0.75),
    )


def _can_zoom(ax: Any) -> bool:
    return ax.name == "rectilinear" and ax.get_label() != "<colorbar>"


def _name_parts(ax: Any, place: str) -> None:
    """Give a panel's parts names that `describe_panel` and the page's script know them by."""
    ax.set_gid(place)
    for letter in "xy":
        axis = getattr(ax, f"{letter}axis")
        axis.set_gid(f"{place}.{letter}")
        axis.get_offset_text().set_gid(f"{place}.{letter}.offset")
    for j, artist in enumerate(ax.get_children()):
        if artist.get_gid() is None and artist is not ax.patch:
            artist.set_gid(f"{place}.{j}")


class _Colours:
    """The colours of a drawing, each as a variable that the page sets for light and dark."""

    def __init__(self) -> None:
        self.found: dict[str, str] = {}

    def replace(self, style: str) -> str:
        """Return a style with variables in place of its colours."""
        return _COLOUR.sub(self._name, style)

    def _name(self, match: re.Match) -> str:
        colour = match[0].lower()
        self.found.setdefault(colour, to_dark(colour))
        return f"var(--c{colour[1:]})"


def _rewrite(root: ET.Element, name: str, colours: _Colours, on_maps: set[str]) -> None:
    """Put variables for colours, and names that are the page's only ones, into all elements."""
    groups = (group for group in root.iter(f"{{{_SVG}}}g") if group.get("id") in on_maps)
    kept = {id(part) for group in groups for part in group.iter()}
    for element in root.iter():
        own = element.attrib
        if "style" in own:
            style = _FONT.sub(r"\1font-size: \2px", own["style"])
            own["style"] = style if id(element) in kept else colours.replace(style)
        if id(element) in kept and element.tag == f"{{{_SVG}}}text":
            own["style"] = "fill: #000000; " + own.get("style", "")
        if "clip-path" in own:
            own["clip-path"] = own["clip-path"].replace("url(#", f"url(#{name}-")
        if "id" in own and own["id"].partition(".")[0] != name:
            own["id"] = f"{name}-{own['id']}"
        href = own.pop(f"{{{_XLINK}}}href", None)
        if href is not None:
            own["href"] = f"#{name}-{href[1:]}" if href.startswith("#") else href
        for key in ("d", "x", "y", "transform"):
            if key in own:
                own[key] = _NUMBER.sub(lambda found: f"{float(found[0]):.2f}", own[key])
    _join_dots(root)


def _join_dots(root: ET.Element) -> None:
    """Draw lines of very many round marks as paths of dots."""
    sizes = {
        "#" + mark.attrib["id"]: _find_size(mark.get("d", ""))
        for mark in root.iter(f"{{{_SVG}}}path")
        if "id" in mark.attrib
    }
    for group in root.iter(f"{{{_SVG}}}g"):
        marks = group.findall(f"{{{_SVG}}}use")
        if len(marks) < _DOTS or len({mark.get("href") for mark in marks}) > 1:
            continue
        size = sizes.get(marks[0].get("href", ""), 0.0)
        style = marks[0].get("style", "").replace("stroke:", "edge:").replace("fill:", "stroke:")
        style = style.replace("fill-opacity:", "stroke-opacity:")
        for mark in marks:
            group.remove(mark)
        # In pieces, so that dots of a faint colour still add up where there are many.
        for k in range(8):
            dots = "".join(f"M{mark.get('x')} {mark.get('y')}h0" for mark in marks[k::8])
            look = f"{style}; stroke-width: {size:.2f}; stroke-linecap: round; fill: none"
            ET.SubElement(group, f"{{{_SVG}}}path", {"d": dots, "style": look, "class": "dots"})


def _find_size(path: str) -> float:
    """Return the width of a mark, from its outline."""
    numbers = [float(x) for x in re.findall(r"-?[\d.]+", path)]
    return max(numbers[::2], default=0.0) - min(numbers[::2], default=0.0)
