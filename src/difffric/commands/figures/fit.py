"""Figures of a calibration and of an identification."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from difffric.calibration.data_comparison import PushComparison, TraceComparison, simulate_condition
from difffric.calibration.profiles import Profile
from difffric.calibration.result import Fit
from difffric.commands.figures.friction_of_pushes import draw_friction_of_pushes
from difffric.commands.figures.style import (
    OPEN_MARKS,
    STYLE,
    group_by_condition,
    make_figure,
    name_curve,
    write_name,
)
from difffric.units import to_mm_min, to_um


def draw_pushes(fit: Fit, beside: PushComparison) -> Figure:
    """Draw F_p and d over speed, measured and fitted, and what is left over."""
    v = to_mm_min(beside.velocity)
    labels = ("peak push force $F_p$ [N]", "sliding distance d [µm]")
    scale = np.array([1.0, to_um(1.0)])
    panels = [j for j in (0, 1) if np.isfinite(beside.measured[j]).any()]
    speeds = np.linspace(beside.velocity.min(), beside.velocity.max(), 400)
    slides = fit.kind == "slides"
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(
            len(panels),
            5.2 * len(panels),
            5.6,
            rows=2,
            sharex="col",
            squeeze=False,
            height_ratios=(3, 1.3),
        )
        for condition, mine, colour, marker in group_by_condition(fit.conditions):
            curves = simulate_condition(fit, condition, speeds)
            for ax, j in zip(axes[0], panels, strict=True):
                name = write_name(condition) or "measured"
                ax.errorbar(
                    v[mine],
                    scale[j] * beside.measured[j, mine],
                    scale[j] * np.nan_to_num(beside.standard_error[j, mine]),
                    fmt=marker,
                    color=colour,
                    **OPEN_MARKS,
                    label=name,
                )
                if curves is None:
                    model = scale[j] * beside.model[j, mine]
                    ax.plot(v[mine], model, "+", color="#222", ms=7, mew=1)
                    continue
                y = scale[j] * (curves.peak_force, curves.sliding_distance)[j]
                ax.plot(
                    to_mm_min(speeds), y[:, 1], color=colour, lw=1,
                    label=name_curve("model", condition),
                )  # fmt: skip
                if fit.scatter > 0:
                    ax.fill_between(
                        to_mm_min(speeds), y[:, 0], y[:, 2], color=colour, alpha=0.2, lw=0
                    )
            for ax, j in zip(axes[1], panels, strict=True):
                ax.plot(
                    v[mine], beside.residual[j, mine], marker, color=colour, ms=5, mfc="none",
                    label=name_curve(condition),
                )  # fmt: skip
        for top, bottom, j in zip(*axes, panels, strict=True):
            top.set_ylabel(labels[j])
            positive = beside.measured[j][np.isfinite(beside.measured[j])]
            if j == 1 and positive.max() > 30 * positive.min() > 0:
                top.set_yscale("log")
            if curves is None:
                top.plot([], [], "+", color="#222", ms=7, mew=1, label="model")
            else:
                top.plot([], [], color="#666", lw=1, label="model")
            top.legend(fontsize=8, loc="upper left" if j == 0 else "lower right")
            bottom.axhspan(-2, 2, color="#999", alpha=0.15, lw=0)
            bottom.axhline(0, color="#333", lw=0.8)
            largest = np.nanmax(np.abs(beside.residual[j]), initial=2.4)
            bottom.set_ylim(-1.25 * largest, 1.25 * largest)
            bottom.set_xlabel("release speed [mm/min]" if slides else "pusher speed v [mm/min]")
            bottom.set_ylabel("residual [σ]")
    return figure


def draw_own_friction(fit: Fit, order: NDArray) -> Figure:
    """Draw each push's own mu_s over the order (n,) of the pushes, and the scatter about means."""
    means = {}
    for condition in fit.conditions:
        label = f"mu_s[{condition}]" if f"mu_s[{condition}]" in fit.free else "mu_s"
        if label in fit.free:
            means[condition] = (fit.value(label), fit.scatter)
    return draw_friction_of_pushes(
        fit.conditions, order, fit.mu_s, fit.mu_s_se, means, "mean ± scatter"
    )


def draw_traces(shown: Mapping[str, Mapping[str, TraceComparison]]) -> Figure:
    """Force and position over time, measured and fitted, with the whitened residuals below;
    a column a push."""
    kinds = [k for k in ("force", "position") if any(k in x for x in shown.values())]
    labels = {"force": "force [N]", "position": "position [µm]"}
    scale = {"force": 1.0, "position": to_um(1.0)}
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(
            len(shown),
            3.3 * len(shown) + 0.6,
            3.5 * len(kinds),
            rows=2 * len(kinds),
            squeeze=False,
            height_ratios=(2.6, 1.2) * len(kinds),
        )
        for column, (title, channels) in enumerate(shown.items()):
            axes[0, column].set_title(write_name(title, 40), fontsize=10)
            for row, kind in enumerate(kinds):
                top, bottom = axes[2 * row, column], axes[2 * row + 1, column]
                if kind in channels:
                    _trace(top, bottom, channels[kind], scale[kind], kind == "force")
                bottom.set_xlabel("time [ms]")
                if column == 0:
                    top.set_ylabel(labels[kind])
                    bottom.set_ylabel("residual [σ]")
        axes[0, 0].legend(fontsize=8, loc="upper right", markerscale=1.5)
    return figure


def _trace(top, bottom, trace: TraceComparison, scale: float, force: bool) -> None:
    t, in_contact = 1e3 * trace.t, trace.t
    if force:  # from a little before the push to a little after the last contact
        touching = in_contact[trace.model > 0]
        end = touching.max(initial=1e-3)
        first, last = -0.15 * end, 1.3 * end
    else:
        moving = np.abs(trace.model - trace.model[-1]) > 1e-3 * np.ptp(trace.model)
        end = in_contact[moving].max(initial=1e-3)
        first, last = -0.1 * end, 1.2 * end
    seen = (trace.t >= first) & (trace.t <= last)
    size = 4.0 if seen.sum() < 600 else 2.0
    top.plot(
        t[seen],
        scale * trace.measured[seen],
        "o",
        color="#1f6f8b",
        alpha=0.6,
        ms=size,
        mew=0,
        label="measured",
    )
    top.plot(t[seen], scale * trace.model[seen], color="#b4532a", lw=0.8, label="model")
    bottom.axhspan(-2, 2, color="#999", alpha=0.15, lw=0)
    bottom.plot(t[seen], trace.residual[seen], ".", color="#1f6f8b", ms=2, mew=0, label="_residual")
    largest = max(4.0, 1.1 * np.nanmax(np.abs(trace.residual[seen]), initial=0.0))
    bottom.set_ylim(-largest, largest)
    for ax in (top, bottom):
        ax.set_xlim(1e3 * first, 1e3 * last)
    top.tick_params(labelbottom=False)


def draw_correlations(fit: Fit) -> Figure:
    """Draw the correlations of the free parameters."""
    n = len(fit.free)
    with matplotlib.rc_context(STYLE):
        figure, ax = make_figure(width=2.4 + 0.75 * n, height=1.4 + 0.62 * n)
        correlation = fit.correlation
        ax.grid(False)
        shown = ax.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1)
        for i in range(n):
            for j in range(n):
                if i != j:
                    dark = abs(correlation[i, j]) > 0.6
                    ax.text(
                        j,
                        i,
                        f"{correlation[i, j]:+.2f}",
                        ha="center",
                        va="center",
                        fontsize=9,
                        color="white" if dark else "#222",
                    )
        short = [_symbol(x) for x in fit.free]
        ax.set_xticks(range(n), short)
        ax.set_yticks(range(n), short)
        ax.spines[:].set_visible(False)
        figure.colorbar(shown, ax=ax, shrink=0.8, ticks=(-1, -0.5, 0, 0.5, 1))
    return figure


_SYMBOLS = {
    "k_N_per_m": "k",
    "b_N_s_per_m": "b",
    "k_v_N_s_per_m": "$k_v$",
    "mu_s": r"$\mu_s$",
    "mu_k_over_mu_s": r"$\mu_k/\mu_s$",
    "mass_kg": "m",
}
_UNITS = {"k_N_per_m": "N/m", "b_N_s_per_m": "N s/m", "k_v_N_s_per_m": "N s/m", "mass_kg": "kg"}


def _symbol(label: str) -> str:
    name, _, condition = label.partition("[")
    return _SYMBOLS.get(name, name) + (f"\n{write_name(condition[:-1], 16)}" if condition else "")


def draw_profiles(fit: Fit, found: Mapping[str, Profile]) -> Figure:
    """Draw the rise of chi-square with each parameter, beside its standard error's parabola."""
    columns = min(len(found), 3)
    rows = -(-len(found) // columns)
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(columns, 3.6 * columns, 3.1 * rows, rows=rows, squeeze=False)
        for ax, (label, one) in zip(axes.flat, found.items(), strict=False):
            _profile(ax, one, fit.standard_error(label))
            name, _, condition = label.partition("[")
            unit = f" [{_UNITS[name]}]" if name in _UNITS else ""
            which = f", {write_name(condition[:-1])}" if condition else ""
            ax.set_xlabel(f"{_SYMBOLS.get(name, name)}{which}{unit}")
        for ax in axes[:, 0]:
            ax.set_ylabel("rise of chi-square")
        for ax in axes.flat[len(found) :]:
            ax.set_visible(False)
        handles, names = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper center", ncols=2, fontsize=8)
    return figure


def _profile(ax, one: Profile, sigma: float | None) -> None:
    """Draw one panel: the profile up to a little beyond its widest interval."""
    curve = one.curve[np.isfinite(one.curve[:, 1])]
    ends = [x for pair in one.intervals.values() for x in pair if x is not None]
    low, high = (f([*ends, one.value]) for f in (min, max))
    low = curve[0, 0] if any(pair[0] is None for pair in one.intervals.values()) else low
    high = curve[-1, 0] if any(pair[1] is None for pair in one.intervals.values()) else high
    room = 0.06 * (high - low) or 0.1 * abs(one.value)
    ax.plot(*curve.T, "o-", color="#1f6f8b", ms=3, lw=1, label="profile")
    if sigma:
        x = np.linspace(low - room, high + room, 200)
        y = ((x - one.value) / sigma) ** 2
        ax.plot(x, y, "--", color="#888", lw=1, label="standard error")
    for level, (lower, upper) in one.intervals.items():
        if lower is not None or upper is not None:
            sides = (low if lower is None else lower, high if upper is None else upper)
            ax.axvspan(*sides, color="#b4532a", alpha=0.08, lw=0)
        if upper is not None:
            ax.text(
                upper,
                0.98,
                f"{100 * level:.4g} %",
                rotation=90,
                fontsize=7,
                ha="right",
                va="top",
                color="#b4532a",
                transform=ax.get_xaxis_transform(),
            )
    ax.axvline(one.value, color="#333", lw=0.8)
    near = curve[(curve[:, 0] >= low) & (curve[:, 0] <= high), 1]
    ax.set_ylim(0, float(np.clip(1.3 * near.max(initial=0.0), 2.0, 18.0)))
    ax.set_xlim(low - room, high + room)
    ax.ticklabel_format(axis="x", useOffset=False)
    ax.locator_params(axis="x", nbins=4)
