"""Draw the packages, floor by floor, with the way of mu_s from the command line to the event.

    python -m studies.rooms_picture [--image docs/images/rooms.png]

The floors are those of the contract in pyproject.toml: what stands higher imports from below.
"""

from __future__ import annotations

import argparse
import tomllib
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

ROOT = Path(__file__).parents[1]
IMAGE = ROOT / "docs" / "images" / "rooms.png"
SAYS = {
    "commands": "the command line, its reports and figures",
    "studies": "the paper repeated, rival ways",
    "fleet": "many rigs",
    "monitoring": "friction over pushes, alarms",
    "diagnosis": "what the model lacks",
    "identification": "mu_s of a push, every way",
    "calibration": "a rig's parameters from its pushes",
    "estimation": "what every fit stands on",
    "centering": "ring, plan, loop",
    "acquisition": "the card and the recorder",
    "axis": "driven by a recorded force",
    "dispatch": "a rig or an axis",
    "simulation": "equation (2) over a push: F_p, d",
    "measurements": "pushes, recordings, files",
    "rig": "laws, effects, parameters, set-up",
    "compute": "JAX, roots, programs kept",
}
"""What each package is, in a few words."""
WAY = (
    ("commands", 0.35, "the option --mu-s is read"),
    ("rig", 0.35, "and put into the rig, once"),
    ("simulation", 0.58, "F_p, d and their derivatives are asked for"),
    ("rig", 0.81, "friction says mu_s F_N: the part breaks away"),
    ("simulation", 1.04, "it is let go, it rests: F_p and d are read"),
    ("commands", 1.04, "table, report and result.json tell them"),
)
"""Where mu_s comes by in `difffric simulate`: package, place across its box, what happens there."""
BOX, LINE, DARK, WAY_COLOUR = "#eef2f7", "#8796a8", "#1d2733", "#c4451c"


def read_floors() -> list[list[str]]:
    """The packages of each floor, the highest first; modules at the top are left out."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        contracts = tomllib.load(file)["tool"]["importlinter"]["contracts"]
    (layers,) = (c["layers"] for c in contracts if c["type"] == "layers")
    floors = [[name.strip() for name in line.split("|")] for line in layers]
    return [floor for floor in floors if set(floor) <= SAYS.keys()]


def draw(image: Path) -> None:
    """Write the picture."""
    floors = read_floors()
    place: dict[str, float] = {}
    figure, axes = plt.subplots(figsize=(10.0, 0.78 * len(floors) + 0.9))
    for level, floor in enumerate(floors):
        y, width = len(floors) - level, 12.0 / len(floor)
        for k, name in enumerate(floor):
            x = k * width
            place[name] = y
            style = "round,pad=0,rounding_size=0.06"
            box = (x + 0.06, y - 0.36), width - 0.12, 0.72
            axes.add_patch(FancyBboxPatch(*box, boxstyle=style, facecolor=BOX, edgecolor=LINE))
            middle = x + width / 2
            axes.text(middle, y + 0.13, name, ha="center", va="center", weight="bold", color=DARK)
            axes.text(middle, y - 0.15, SAYS[name], ha="center", va="center", size=8, color=DARK)
    draw_way(axes, place)
    axes.set_xlim(-0.1, 12.1)
    axes.set_ylim(-0.75, len(floors) + 0.45)
    axes.axis("off")
    figure.tight_layout(pad=0.3)
    image.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(image, dpi=130)


def draw_way(axes: Axes, place: dict[str, float]) -> None:
    """Draw the way of mu_s through the boxes, numbered, and say below what happens where."""
    points = [(x, place[name]) for name, x, _ in WAY]
    for start, end in pairwise(points):
        arrow = FancyArrowPatch(
            start, end, arrowstyle="-|>", mutation_scale=11, shrinkA=8, shrinkB=8, color=WAY_COLOUR
        )
        axes.add_patch(arrow)
    for number, ((x, y), (_, _, text)) in enumerate(zip(points, WAY, strict=True), 1):
        axes.plot(x, y, "o", color="white", markeredgecolor=WAY_COLOUR, markersize=14)
        axes.text(x, y - 0.01, str(number), ha="center", va="center", size=8, color=WAY_COLOUR)
        column, row = divmod(number - 1, 3)
        below = 0.12 + 6.0 * column, 0.32 - 0.3 * row
        axes.text(*below, f"{number}  {text}", va="center", size=9, color=WAY_COLOUR)


def main() -> None:
    """Draw it where the command line says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--image", type=Path, default=IMAGE)
    draw(parser.parse_args().image)


if __name__ == "__main__":
    main()
