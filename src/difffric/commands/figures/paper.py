"""The figures of the paper: a push over time, its families of curves, and what it measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from difffric.commands.figures.style import COLOURS, STYLE, make_figure
from difffric.identification.surrogates import PUBLISHED_DISTANCE, PUBLISHED_FORCE
from difffric.simulation.families import Family
from difffric.studies.paper import CONDITIONS, Paper, bound_distance
from difffric.units import to_mm, to_mm_min, to_um

if TYPE_CHECKING:
    from difffric.simulation.trajectory import Trajectory  # it imports JAX

_MARKERS = {"DRY": "o", "OILY": "s"}


def draw_response(trajectories: Mapping[str, Trajectory], what: str) -> Figure:
    """Draw the position (Figure II.3) or the force (Figure II.4) over time; `what` says which."""
    with matplotlib.rc_context(STYLE):
        figure, ax = make_figure()
        for style, (label, trajectory) in zip(("-", "--"), trajectories.items(), strict=False):
            end = float(trajectory.stop_time)
            t = np.linspace(0, end, 4000)
            if what == "force":  # up to a little after the last contact
                touching = t[np.asarray(trajectory.force(t)) > 0]
                end = 1.4 * (touching[-1] if len(touching) else end)
            t = np.linspace(-0.05 * end, 1.05 * end, 4000)
            force, position, _ = (np.asarray(a) for a in trajectory.evaluate(t))
            colour = COLOURS.get(label, "#1f6f8b")
            name = f"{label}, " if label else ""
            if what == "force":
                ax.plot(
                    1e3 * t,
                    force,
                    style,
                    color=colour,
                    label=f"{name}$F_p$ = {float(trajectory.peak_force):.1f} N",
                )
            else:
                ax.plot(1e3 * t, to_mm(position), style, color=colour, label=label)
        ax.set_xlabel("time [ms]")
        ax.set_ylabel("position of the part [mm]" if what == "position" else "contact force [N]")
        if what == "force" or len(trajectories) > 1:
            ax.legend(loc="upper right" if what == "force" else "lower right")
    return figure


def draw_families(family: Family, what: str, measured: Paper | None = None) -> Figure:
    """Draw F_p (Figure II.5) or d (Figure II.6) over speed, a curve for each mu_s.

    The published surrogate (3) or (5) is dashed.
    """
    with matplotlib.rc_context(STYLE):
        figure, ax = make_figure()
        shown = np.unique(np.linspace(0, len(family.mu_s) - 1, 6).round().astype(int))
        v = to_mm_min(family.velocity)
        force = what == "force"
        for n, j in enumerate(shown):
            mu = family.mu_s[j]
            model = family.peak_force[:, j] if force else to_mm(family.sliding_distance[:, j])
            if force:
                printed = PUBLISHED_FORCE.peak_force(family.velocity, mu)
            else:
                printed = to_mm(PUBLISHED_DISTANCE.sliding_distance(family.velocity, mu))
            colour = matplotlib.colormaps["viridis"](n / max(len(shown) - 1, 1) * 0.9)
            ax.plot(v, model, color=colour, label=rf"$\mu_s$ = {mu:.2f}")
            ax.plot(v, printed, color=colour, ls="--", lw=0.8)
        if measured is not None:
            _draw_measured(ax, measured, force)
        ax.plot(
            [], [], color="#666", ls="--", lw=0.8, label="paper's " + ("(3)" if force else "(5)")
        )
        ax.set_xlabel("pusher speed v [mm/min]")
        ax.set_ylabel("peak push force $F_p$ [N]" if force else "sliding distance d [mm]")
        ax.legend(fontsize=8)
    return figure


def _draw_measured(ax, paper: Paper, force: bool):
    p = paper.pushes
    y = p.peak_force if force else to_mm(p.sliding_distance)
    for condition in CONDITIONS:
        mine = np.array([c == condition for c in p.condition])
        ax.plot(
            to_mm_min(p.velocity[mine]),
            y[mine],
            _MARKERS[condition],
            color=COLOURS[condition],
            ms=5,
            mfc="none",
            label=f"measured, {condition}",
        )


def draw_residuals(paper: Paper) -> Figure:
    """Draw what equation (2) gets wrong: measured minus model at the gauge's mu_s, over speed."""
    p, c = paper.pushes, paper.calibration
    v = to_mm_min(p.velocity)
    panels = (
        (p.peak_force - c.peak_force, c.spread_force, "$F_p$ measured − model [N]"),
        (
            to_um(p.sliding_distance - np.nan_to_num(c.sliding_distance)),
            to_um(c.spread_distance),
            "d measured − model [µm]",
        ),
    )
    impossible = p.sliding_distance > bound_distance(p)
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(2, width=9.6)
        for ax, (residual, spread, label) in zip(axes, panels, strict=True):
            ax.axhspan(-spread, spread, color="#999", alpha=0.2, lw=0, label="estimated spread")
            ax.axhline(0, color="#333", lw=0.8)
            for condition in CONDITIONS:
                mine = np.array([x == condition for x in p.condition])
                ax.plot(
                    v[mine],
                    residual[mine],
                    _MARKERS[condition] + "-",
                    color=COLOURS[condition],
                    lw=0.8,
                    ms=5,
                    label=condition,
                )
            ax.set_xlabel("pusher speed v [mm/min]")
            ax.set_ylabel(label)
        axes[1].plot(
            v[impossible],
            panels[1][0][impossible],
            "x",
            color="#c00",
            ms=11,
            mew=1.5,
            label="above the lossless bound:\nno k, b, $k_v$ can give it",
        )
        for ax in axes:
            ax.legend(fontsize=8)
    return figure


def draw_identified(paper: Paper) -> Figure:
    """Draw mu_s of every push by four ways, each speed judged by a calibration without it."""
    rows, combined = paper.list_rows(), paper.list_weighted()
    panels = (
        ("from the force", [r for r in rows if r["quantity"] == "peak_force_N"], "mu_s_model"),
        ("from the distance", [r for r in rows if r["quantity"] != "peak_force_N"], "mu_s_model"),
        ("by equation (7)", combined, "mu_s_model"),
        ("optimal", combined, "mu_s_optimal"),
    )
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(4, width=12.0, height=3.6, sharey=True)
        for ax, (title, of, key) in zip(axes, panels, strict=True):
            for shift, condition in zip((-60, 60), CONDITIONS, strict=True):
                mine = [r for r in of if r["condition"] == condition]
                colour = COLOURS[condition]
                ax.axhline(mine[0]["mu_s_gauge"], color=colour, lw=0.8, ls=":")
                v = np.array([r["velocity_mm_min"] for r in mine]) + shift
                printed = [r["mu_s_surrogate"] for r in mine]
                ax.plot(v, printed, "x", color=colour, ms=5, label=f"{condition}, paper's formula")
                y = np.array([np.nan if r[key] is None else r[key] for r in mine])
                se = [r[f"{key}_standard_error"] or np.nan for r in mine]
                ax.errorbar(
                    v,
                    y,
                    se,
                    fmt=_MARKERS[condition],
                    color=colour,
                    ms=5,
                    lw=1,
                    mfc="none",
                    label=f"{condition}, model",
                )
            ax.set_title(title, fontsize=10)
            ax.set_xlabel("v [mm/min]")
            ax.set_ylim(0, 0.45)
        axes[0].set_ylabel(r"$\mu_s$  (dotted: gauge)")
        axes[-1].legend(fontsize=7)
    return figure
