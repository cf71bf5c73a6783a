"""The figure of a watched machine: mu_s over the pushes, its state, the evidence beneath."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from difffric.commands.figures.style import MARKERS, STYLE, choose_colours, make_figure, write_name
from difffric.monitoring.monitor import Monitor
from difffric.monitoring.records import PushRecord
from difffric.monitoring.shiryaev_roberts import DIRECTIONS

_ALARM, _LINES = "#a3122a", ("#1f6f8b", "#1f6f8b", "#b08a1e", "#b08a1e")
_WORDS = {
    "friction up": "mu_s up",
    "friction down": "mu_s down",
    "contrast up": "contrast up",
    "contrast down": "contrast down",
}


def draw_charts(monitor: Monitor) -> Figure:
    """mu_s of each push and the state's band of two standard errors; what mu_s cannot explain;
    the evidence, in units of its threshold."""
    pushes = monitor.kept
    n = np.array([x.number for x in pushes])
    with matplotlib.rc_context(STYLE):
        figure, axes = make_figure(
            rows=3, width=8.6, height=8.2, sharex=True, height_ratios=(3, 1.6, 2)
        )
        _friction(axes[0], pushes)
        _contrast(axes[1], pushes)
        _evidence(axes[2], pushes)
        first, last = n.min() - 0.5, n.max() + 0.5
        for k, alarm in enumerate(monitor.alarms):
            if alarm.push < first:
                continue
            for ax in axes:
                ax.axvline(alarm.push, color=_ALARM, lw=1.2)
                ax.axvline(alarm.change - 0.5, color=_ALARM, lw=1, ls=":")
            axes[0].annotate(
                f"alarm {k + 1}",
                (alarm.push, 1.0),
                (3, -4),
                ha="left",
                va="top",
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                fontsize=8,
                color=_ALARM,
            )
        axes[-1].set_xlim(first, last)
        axes[-1].set_xlabel("push")
    return figure


def _parts(pushes: Sequence[PushRecord]) -> dict[str, list[PushRecord]]:
    """Return the pushes of each part, by what a person calls the part."""
    found: dict[str, list[PushRecord]] = {}
    for x in pushes:
        if x.mu_s is not None:
            found.setdefault(x.condition or "", []).append(x)
    return found


def _friction(ax, pushes: Sequence[PushRecord]) -> None:
    parts = _parts(pushes)
    colours = choose_colours(list(parts))
    for marker, (name, mine) in zip(MARKERS * len(parts), parts.items(), strict=False):
        n = np.array([x.number for x in mine])
        colour = colours[name]
        ax.plot(
            n,
            [x.mu_s for x in mine],
            marker,
            color=colour,
            ms=3.5,
            mfc="none",
            mew=0.8,
            label=f"{write_name(name)} pushes".strip(),
        )
        state, error = (np.array([getattr(x, k) or np.nan for x in mine]) for k in _STATE)
        ax.plot(
            n,
            state,
            color=colour,
            lw=1.2,
            label=f"{write_name(name)} state ± 2 standard errors".strip(),
        )
        ax.fill_between(n, state - 2 * error, state + 2 * error, color=colour, alpha=0.2, lw=0)
    lost = [x.number for x in pushes if x.mu_s is None]
    if lost:
        at = np.full(len(lost), 0.02)
        ax.plot(
            lost,
            at,
            "x",
            color="#555",
            ms=5,
            transform=ax.get_xaxis_transform(),
            label="not identified",
        )
    ax.set_ylabel("mu_s")
    ax.legend(fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))


_STATE = ("state", "state_se")


def _contrast(ax, pushes: Sequence[PushRecord]) -> None:
    mine = [x for x in pushes if x.z[1] is not None]
    ax.axhspan(-2, 2, color="#999", alpha=0.15, lw=0)
    ax.axhline(0, color="#333", lw=0.8)
    ax.plot(
        [x.number for x in mine],
        [x.z[1] for x in mine],
        "o",
        color=_LINES[2],
        ms=3,
        mfc="none",
        mew=0.8,
    )
    ax.set_ylabel("contrast of force\nand distance [σ]")


def _evidence(ax, pushes: Sequence[PushRecord]) -> None:
    mine = [x for x in pushes if x.log_evidence is not None]
    n = [x.number for x in mine]
    for k, (name, colour) in enumerate(zip(DIRECTIONS, _LINES, strict=True)):
        parts = [x.log_evidence_by[k] for x in mine]
        share = np.exp([np.nan if x is None else x for x in parts])
        ax.semilogy(
            n, share, color=colour, lw=0.9, ls="-" if k % 2 == 0 else "--", label=_WORDS[name]
        )
    ax.semilogy(n, np.exp([x.log_evidence or 0.0 for x in mine]), color="#222", lw=1.1, label="all")
    ax.axhline(1.0, color=_ALARM, lw=1.2, label="threshold")
    ax.set_ylim(1e-4, 1e2)
    ax.set_ylabel("evidence of a change\nover its threshold")
    ax.legend(fontsize=8, ncols=6, loc="lower center", bbox_to_anchor=(0.5, 1.0))
