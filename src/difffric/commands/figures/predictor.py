"""How well an exported predictor does over its box, and where it answers from which reading."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from difffric.commands.figures.style import STYLE
from difffric.identification.controller.fitting import Exported, compute_readings
from difffric.identification.controller.predictor import BY_DISTANCE, BY_FORCE, DETERMINED, Box
from difffric.rig.rig import Rig
from difffric.units import to_mm_min

_USE = {
    0: ("neither", "#d9d9d9"),
    BY_FORCE: ("$F_p$ only", "#b4532a"),
    BY_DISTANCE: ("d only", "#1f6f8b"),
    BY_FORCE + BY_DISTANCE: ("both", "#5b7f3b"),
}


def draw_predictor(exported: Exported, rig: Rig) -> Figure:
    """Draw the errors of mu_s from F_p and from d over the box, and which is used where."""
    p, n = exported.predictor, 180 if rig.affine else 60
    box: Box = p.box
    v = np.linspace(box.slowest, box.fastest, n)
    mu_s = np.linspace(box.least_mu_s, box.most_mu_s, n)
    both = np.meshgrid(v, mu_s, indexing="ij")
    seen = compute_readings(rig, *(axis.ravel() for axis in both))
    found = p.predict(both[0].ravel(), seen["force"][0], seen["distance"][0])
    truth = both[1].ravel()
    extent = (to_mm_min(box.slowest), to_mm_min(box.fastest), box.least_mu_s, box.most_mu_s)
    with matplotlib.rc_context({**STYLE, "axes.grid": False}):
        figure = Figure(figsize=(12.5, 4.0), layout="constrained")
        axes = figure.subplots(1, 3, sharey=True)
        figure.set_layout_engine("constrained", wspace=0.06)
        limit = 100 * p.max_error
        for ax, name, value, code in (
            (axes[0], "from $F_p$", found.mu_s_force, found.force),
            (axes[1], "from d", found.mu_s_distance, found.distance),
        ):
            error = np.where(code == DETERMINED, 100 * (value / truth - 1), np.nan)
            ax.set_facecolor("#d9d9d9")
            shown = ax.imshow(
                error.reshape(n, n).T,
                origin="lower",
                extent=extent,
                aspect="auto",
                cmap="RdBu_r",
                vmin=-limit,
                vmax=limit,
            )
            ax.set_title(f"{name} (grey: no answer)", fontsize=10)
        figure.colorbar(shown, ax=axes[:2], label="error of $\\mu_s$ [%]", pad=0.01)
        use = BY_FORCE * (found.force == DETERMINED) + BY_DISTANCE * (found.distance == DETERMINED)
        axes[2].imshow(
            use.reshape(n, n).T,
            origin="lower",
            extent=extent,
            aspect="auto",
            cmap=ListedColormap([colour for _, colour in _USE.values()]),
            norm=BoundaryNorm([-0.5, 0.5, 1.5, 2.5, 3.5], 4),
            interpolation="nearest",
        )
        for code, (label, colour) in _USE.items():
            if (use == code).any():
                axes[2].plot([], [], "s", color=colour, label=label)
        axes[2].set_title("which readings tell $\\mu_s$", fontsize=10)
        axes[2].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        for ax in axes:
            ax.set_xlabel("pusher speed v [mm/min]")
        axes[0].set_ylabel("$\\mu_s$")
    return figure
