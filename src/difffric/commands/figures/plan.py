"""Figures of plans and of centred rings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from difffric.centering.loop import Centering
from difffric.centering.planning import Known, Plan
from difffric.commands.figures.style import make_figure
from difffric.units import to_mm_min, to_um

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BLUE, _RED, _GREY = "#1f6f8b", "#b4532a", "0.55"


def draw_speeds(found: Plan, known: Known) -> Figure:
    """Draw what the push to the target would be at each speed."""
    first, step = found.options, found.next
    v = to_mm_min(first.velocity)
    figure, (top, middle, bottom) = make_figure(rows=3, width=7.6, height=6.0, sharex=True)
    top.plot(v, first.probability[0], "o-", color=_BLUE, label="_probability")
    top.axhline(0.99, color=_GREY, ls=":", lw=1)
    top.set_ylabel(f"probability of landing\nwithin {to_um(known.within):g} µm")
    top.set_ylim(-0.03, 1.05)
    spread = {"mu_s": _middle(first.landing[0]), **{k: s[0] for k, s in first.rest.items()}}
    for (name, s), style in zip(spread.items(), ("-", "--", ":", "-."), strict=False):
        middle.plot(v, to_um(np.asarray(s)), style, color=_BLUE, label=name)
    middle.set_ylabel("standard deviation of\nthe landing, by source [µm]")
    middle.set_yscale("log")
    middle.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    bottom.plot(v, to_um(first.stroke[0]), "o-", color=_BLUE, label="_stroke")
    bottom.set_ylabel("stroke of the tip [µm]")
    bottom.set_xlabel("speed [mm/min]")
    bottom.set_xscale("log")
    ticks = [t for t in (100, 200, 500, 1000, 2000, 5000, 10000) if v[0] <= t <= v[-1] * 1.001]
    bottom.set_xticks(ticks, [str(t) for t in ticks])
    bottom.minorticks_off()
    for ax in (top, middle, bottom):
        ax.axvline(to_mm_min(step.velocity), color=_RED, lw=1.2)
    top.annotate(
        "taken",
        (to_mm_min(step.velocity), 0.0),
        xytext=(4, 2),
        textcoords="offset points",
        color=_RED,
    )
    return figure


def _middle(landing):
    """Return half the width of the middle 68 % of quantiles, which lie along the last axis."""
    n = landing.shape[-1]
    k = round(0.26 * n)  # the quantiles at 0.13 and 0.87, 1.13 deviations away
    return np.abs(landing[..., n - 1 - k] - landing[..., k]) / 2.26


def draw_run(centering: Centering, known: Known, truth: NDArray) -> Figure:
    """Draw one centred ring as a strip: how far it was off after each push, as it was known and in
    `truth` (pushes + 1, 2) [m], where each push was expected to land, what was known of mu_s."""
    figure, (left, right) = make_figure(columns=2, width=8.4, height=3.8, width_ratios=(2, 1))
    pushes, n = centering.pushes, len(centering.pushes)
    within = to_um(known.within)
    first = pushes[0].before if n else centering.offset
    seen = to_um(np.array([np.hypot(*first), *(np.hypot(*p.after) for p in pushes)]))
    true = to_um(np.hypot(*truth.T))
    left.axhspan(0, within, color=_BLUE, alpha=0.12, lw=0, label=f"within {within:g} µm")
    for i, p in enumerate(pushes, 1):
        step = p.plan.next
        miss = to_um(step.deviations["all"])
        goal = abs(to_um(p.plan.target - step.aim))
        label = "expected, one deviation" if i == 1 else None
        left.plot(
            [i, i],
            [max(goal - miss, 0.05), goal + miss],
            color=_GREY,
            lw=6,
            alpha=0.5,
            solid_capstyle="butt",
            label=label,
        )
        push = f"{to_mm_min(step.velocity):.0f} mm/min\n{to_um(step.stroke):.0f} µm"
        text = f"{push}\nP {step.probability:.2f}"
        left.annotate(
            text,
            (i - 0.5, 0.97),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="top",
            fontsize=8,
            color="0.3",
        )
    left.plot(range(n + 1), true, "s", color=_RED, ms=7, mfc="none", label="truth")
    left.plot(range(n + 1), seen, "o-", color=_BLUE, ms=4, label="as it is known")
    left.set_yscale("symlog", linthresh=2.5, linscale=0.8)
    left.set_ylim(0, 6 * max(true.max(), seen.max(), 2 * within))
    left.set_xticks(range(n + 1))
    left.set_xlabel("pushes made")
    left.set_ylabel("offset of the ring's centre [µm]")
    left.legend(fontsize=8, loc="lower left")
    mean = [p.known_mu_s for p in pushes]
    at = np.arange(1, n + 1)
    right.errorbar(
        at,
        [m for m, _ in mean],
        [m * s for m, s in mean],
        fmt="o",
        color=_BLUE,
        capsize=3,
        label="mean, one deviation",
    )
    own = [(i, p.mu_s) for i, p in enumerate(pushes, 1) if p.mu_s is not None]
    right.plot(*zip(*own, strict=True) if own else ([], []), "x", color=_RED, label="each push")
    right.set_xticks(at)
    right.set_xlabel("pushes made")
    right.set_ylabel("$\\mu_s$, as it is known")
    right.legend(fontsize=8)
    return figure


def draw_times(ways: Mapping[str, Sequence[float]]) -> Figure:
    """Draw how long each way took to centre the rings [s]; infinite where it did not."""
    figure, ax = make_figure(width=7.0, height=3.6)
    colours = (_BLUE, _RED, "#5b7f3b", "#7a4f9a", "#b08a1e", "#555555")
    every = np.concatenate([np.asarray(t, float) for t in ways.values()])
    last = 1.05 * every[np.isfinite(every)].max(initial=1.0)
    for (name, seconds), colour in zip(ways.items(), colours, strict=False):
        t = np.sort(np.asarray(seconds, float))
        done = t[np.isfinite(t)]
        share = np.arange(len(done) + 1) / len(t)
        ax.step(
            [0.0, *done, last],
            [*share, share[-1]],
            where="post",
            color=colour,
            lw=2.2 if colour == _BLUE else 1.4,
            label=name.replace("_", " "),
        )
    ax.set_xlim(0, last)
    ax.set_xlabel("time until the loop ends [s]")
    ax.set_ylabel("share of the rings centred")
    ax.set_ylim(0, 1.03)
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9)
    return figure
