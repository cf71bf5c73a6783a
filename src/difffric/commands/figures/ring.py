"""A measured ring: its surface about the axis, much exaggerated, and what the fit leaves."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from difffric.centering.ring import Ring, evaluate_surface
from difffric.commands.figures.style import STYLE
from difffric.number_text import format_pair
from difffric.units import to_um

_BLUE, _RED, _GREY = "#1f6f8b", "#b4532a", "#777777"


def draw_ring(angle: NDArray, radius: NDArray, ring: Ring) -> Figure:
    """Polar: deviation from the fitted radius, with the offset; beside it the residuals, and the
    lobes that the ring has, over the angle. `angle` [rad], `radius` [m]."""
    usable = np.isfinite(ring.residuals)
    out = np.zeros(len(angle), bool)
    out[ring.outliers] = True
    good = usable & ~out
    turn = np.linspace(-np.pi, np.pi, 721)
    fitted = to_um(evaluate_surface(ring, turn) - ring.radius)
    reach = float(np.abs(fitted).max())
    base = 3 * reach
    # An outlier far off is drawn at the edge: the rest would be a dot beside it.
    edge = base + 1.5 * reach
    deviation = np.clip(to_um(radius - ring.radius), -base, 1.5 * reach)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.5, 4.8), layout="constrained")
        spec = figure.add_gridspec(2, 2, width_ratios=(1, 1.25))
        polar = figure.add_subplot(spec[:, 0], projection="polar")
        polar.plot(
            turn, np.full_like(turn, base), color=_GREY, lw=0.8, ls=":", label="a ring on the axis"
        )
        polar.plot(turn, base + fitted, color=_BLUE, lw=1, label="fitted")
        polar.plot(angle[good], base + deviation[good], ".", color="#333", ms=2.5, label="readings")
        if out.any():
            polar.plot(angle[out], base + deviation[out], "x", color=_RED, ms=5, label="outliers")
        end = to_um(ring.offset)
        polar.annotate(
            "",
            (ring.direction, end),
            (0, 0),
            arrowprops={"arrowstyle": "->", "color": _RED, "lw": 1.8},
        )
        polar.plot([], [], color=_RED, lw=1.8, label="offset of the centre")
        polar.set_ylim(0, edge if out.any() else base + 1.15 * reach)
        polar.set_yticks([base], [])
        polar.set_title(
            "{} ± {} µm towards {} ± {}°".format(
                *format_pair(end, to_um(ring.offset_se)),
                *format_pair(*np.degrees([ring.direction, ring.direction_se])),
            ),
            fontsize=10,
            pad=16,
        )
        polar.legend(loc="upper left", bbox_to_anchor=(-0.2, -0.09), ncols=3, fontsize=8)
        left, below = figure.add_subplot(spec[0, 1]), figure.add_subplot(spec[1, 1])
        degrees = np.degrees(np.angle(np.exp(1j * angle)))
        bound = max(5 * to_um(ring.noise), 1.1 * np.abs(to_um(ring.residuals[good])).max())
        shown = np.clip(to_um(ring.residuals), -bound, bound)
        left.axhspan(
            *(to_um(ring.noise) * s for s in (-1, 1)),
            color=_GREY,
            alpha=0.2,
            lw=0,
            label=f"noise, {to_um(ring.noise):.2g} µm",
        )
        left.plot(degrees[good], shown[good], ".", color="#333", ms=3)
        if out.any():
            label = f"{out.sum()} outliers, at the edge where beyond"
            left.plot(degrees[out], shown[out], "x", color=_RED, ms=5, label=label)
        left.set(ylabel="residual [µm]", xlim=(-180, 180), ylim=(-1.2 * bound, 1.7 * bound))
        left.legend(fontsize=8, loc="upper right", ncols=2)
        _lobes(below, degrees, good, turn, ring)
        for ax in (left, below):
            ax.set_xticks(range(-180, 181, 60))
    return figure


def _lobes(ax, degrees, good, turn, ring: Ring):
    """Draw the form that the fit found, and the readings less all but the form."""
    form = to_um(evaluate_surface(ring, turn) - evaluate_surface(ring, turn, lobes=False))
    at = np.interp(degrees, np.degrees(turn), form)
    ax.plot(
        degrees[good],
        (at + to_um(ring.residuals))[good],
        ".",
        color="#333",
        ms=2.5,
        label="readings less offset and radius",
    )
    ax.plot(np.degrees(turn), form, color=_BLUE, lw=1.2, label="lobes, fitted")
    measured = (at + to_um(ring.residuals))[good]
    span = 1.3 * max(np.abs(measured).max(), to_um(ring.noise))
    ax.set(xlabel="angle [degrees]", ylabel="form [µm]", xlim=(-180, 180), ylim=(-span, 1.4 * span))
    ax.legend(fontsize=8, loc="upper right", ncols=2)
