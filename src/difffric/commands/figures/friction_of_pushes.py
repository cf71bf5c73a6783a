"""Each push's own mu_s over the order of the pushes: the picture that a fit and an identification
share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from difffric.commands.figures.style import (
    OPEN_MARKS,
    STYLE,
    group_by_condition,
    make_figure,
    name_curve,
    write_name,
)


def draw_friction_of_pushes(
    conditions: Sequence[str],
    order: NDArray,
    mu_s: NDArray,
    errors: NDArray,
    means: Mapping[str, tuple[float, float]],
    what: str,
) -> Figure:
    """Draw mu_s (n,) with its errors over the order (n,), and bands about the conditions' means.

    `means` has a condition's mean and relative spread where they are known; `what` names them.
    """
    with matplotlib.rc_context(STYLE):
        figure, ax = make_figure(width=7.6, height=3.8)
        for condition, mine, colour, marker in group_by_condition(conditions):
            if condition in means:
                mean, spread = means[condition]
                ends = np.array([order[mine].min() - 0.4, order[mine].max() + 0.4])
                band = mean * (1 - spread), mean * (1 + spread)
                ax.plot(
                    ends, [mean, mean], color=colour, lw=0.8, label=name_curve("mean", condition)
                )
                ax.fill_between(ends, *band, color=colour, alpha=0.15, lw=0)
            ax.errorbar(
                order[mine],
                mu_s[mine],
                errors[mine],
                fmt=marker,
                color=colour,
                **OPEN_MARKS,
                label=write_name(condition) or "each push",
            )
        ax.plot([], [], color="#666", lw=6, alpha=0.3, label=what)
        ax.set_xlabel("order of the pushes")
        ax.set_ylabel(r"$\mu_s$ of each push")
        ax.xaxis.get_major_locator().set_params(integer=True)
        ax.legend(fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure
