"""The figures of the paper: a push over time, its families of curves, and what it measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import matplotlib
import matplotlib.ticker
import numpy as np
from matplotlib.figure import Figure

from difffric.commands.figures.style import COLOURS, STYLE, make_figure, name_curve
from difffric.identification.surrogates import PUBLISHED_DISTANCE, PUBLISHED_FORCE
from difffric.rig import parameters
from difffric.simulation.columns import observe_columns
from difffric.simulation.families import Family
from difffric.studies.paper import Paper
from difffric.studies.published_tables import CONDITIONS
from difffric.units import to_mm, to_mm_min, to_um

if TYPE_CHECKING:
    from difffric.simulation.trajectory import Trajectory  # it imports JAX

_MARKERS = {"DRY": "o", "OILY": "s"}
_SHOWN = 100.0
"""Errors beyond this [%] are drawn at the edge."""


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
            paper = name_curve("the paper", f"mu_s = {mu:.2f}")
            ax.plot(v, printed, color=colour, ls="--", lw=0.8, label=paper)
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


def draw_explained(paper: Paper) -> Figure:
    """Draw F_p and d over speed: as measured, by equation (2) as printed, by the extended model."""
    p = paper.pushes
    v = np.geomspace(p.velocity.min(), p.velocity.max(), 60)
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(2, width=9.6)
        for name, fit, style in (
            ("equation (2)", paper.plain.fit, ":"),
            ("extended", paper.extended.fit, "-"),
        ):
            for condition in CONDITIONS:
                gauge = float(p.mu_s_gauge[p.condition.index(condition)])
                seen = observe_columns(parameters.with_values(fit.rig, {"mu_s": gauge}), v)
                given = {"color": COLOURS[condition], "ls": style, "lw": 1.2}
                label = f"{name}, {condition}"
                axes[0].plot(to_mm_min(v), seen.peak_force, label=label, **given)
                axes[1].plot(to_mm_min(v), to_um(seen.sliding_distance), label=label, **given)
        for condition in CONDITIONS:
            mine = np.array([c == condition for c in p.condition])
            for ax, y in ((axes[0], p.peak_force), (axes[1], to_um(p.sliding_distance))):
                ax.plot(
                    to_mm_min(p.velocity[mine]),
                    y[mine],
                    _MARKERS[condition],
                    color=COLOURS[condition],
                    mfc="none",
                    ms=6,
                    label=f"measured, {condition}",
                )
        for ax, label in zip(axes, ("$F_p$ [N]", "d [µm]"), strict=True):
            ax.set(xscale="log", yscale="log", xlabel="pusher speed v [mm/min]", ylabel=label)
            ax.legend(fontsize=8)
            if label == "$F_p$ [N]":
                ax.yaxis.set_major_locator(matplotlib.ticker.FixedLocator([50, 100, 200, 300]))
            for axis in (ax.xaxis, ax.yaxis):
                axis.set_major_formatter(matplotlib.ticker.StrMethodFormatter("{x:.0f}"))
            ax.xaxis.set_major_locator(matplotlib.ticker.FixedLocator([500, 1000, 2000, 5000]))
            ax.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
            ax.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    return figure


def draw_errors(paper: Paper) -> Figure:
    """Draw the error of mu_s over speed by three ways, each speed judged without itself."""
    rows, combined = paper.list_rows(), paper.list_weighted()
    panels = (
        ("from the force", [r for r in rows if r["quantity"] == "peak_force_N"]),
        ("from the distance", [r for r in rows if r["quantity"] != "peak_force_N"]),
        ("by equation (7)", combined),
    )
    ways = (
        ("mu_s_surrogate", "paper's formula", {"marker": "x", "ls": "none"}, 0.93),
        ("mu_s_plain", "equation (2)", {"ls": ":", "mfc": "none"}, 1.0),
        ("mu_s_model", "extended", {"ls": "-"}, 1.07),
    )
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(3, width=11.0, height=3.8, sharey=True)
        for ax, (title, of) in zip(axes, panels, strict=True):
            ax.axhline(0, color="#333", lw=0.8)
            for condition in CONDITIONS:
                mine = [r for r in of if r["condition"] == condition]
                v = np.array([r["velocity_mm_min"] for r in mine])
                for key, name, style, shift in ways:
                    error = [
                        np.nan if r[key] is None else 100 * (r[key] / r["mu_s_gauge"] - 1)
                        for r in mine
                    ]
                    ax.plot(
                        v * shift,
                        np.clip(error, -_SHOWN, _SHOWN),
                        **{"marker": _MARKERS[condition], **style},
                        color=COLOURS[condition],
                        ms=5,
                        lw=0.8,
                        label=f"{name}, {condition}",
                    )
            ax.set_title(title, fontsize=10)
            ax.set(xscale="log", xlabel="v [mm/min]", ylim=(-1.05 * _SHOWN, 1.05 * _SHOWN))
            ax.xaxis.set_major_locator(matplotlib.ticker.FixedLocator([500, 1000, 2000, 5000]))
            ax.xaxis.set_major_formatter(matplotlib.ticker.StrMethodFormatter("{x:.0f}"))
            ax.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
        axes[0].set_ylabel(r"error of $\mu_s$ [%]")
        axes[-1].legend(fontsize=7, loc="upper right")
    return figure


def draw_slopes(paper: Paper) -> Figure:
    """Draw dF_p/dmu_s over speed: what (3) says, and what three models make of it."""
    names = {"forces": "no damping on approach", "plain": "equation (2)", "extended": "extended"}
    with matplotlib.rc_context(STYLE):
        figure, ax = make_figure()
        ax.axhline(PUBLISHED_FORCE.C_mu, color="#666", ls="--", lw=0.9, label="paper's (3)")
        for s in paper.compare_slopes():
            ax.plot(s["velocity_mm_min"], s["slope_N"], label=names[s["model"]])
        ax.set(xlabel="pusher speed v [mm/min]", ylabel=r"$dF_p/d\mu_s$ [N]", ylim=(0, None))
        ax.legend(fontsize=8)
    return figure
