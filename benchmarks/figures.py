"""The figures of the page on performance, from the benchmarks' results."""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SCALING = "9. From one push to a million, per push"
BATCH = "2. A batch: the same, per push; the pusher stops at the first loss of contact"
LIMIT = "the limit"
FIGURES = {
    "performance_scaling.png": "Time per push against the number of pushes",
    "performance_accuracy.png": "Worst error against time per push",
}
_STYLES = {
    "difffric, two cores": ("#c0392b", "-", "o"),
    "difffric, one core": ("#c0392b", "--", "o"),
    "numba by hand, two cores": ("#2c6fbb", "-", "s"),
    "numba by hand, one core": ("#2c6fbb", "--", "s"),
    "CasADi, two cores": ("#7d3c98", "-", "^"),
    "diffrax by hand": ("#1e8449", "-", "D"),
    "scipy DOP853, central differences": ("#b9770e", "-", "v"),
}


def draw(results: dict, folder: Path) -> list[Path]:
    """The figures of those comparisons that are among the results."""
    folder.mkdir(parents=True, exist_ok=True)
    groups: dict[str, list[dict]] = {}
    for row in results["benchmarks"]:
        groups.setdefault(row["group"], []).append(row)
    drawn = []
    tasks = zip(FIGURES, (SCALING, BATCH), (_scaling, _accuracy), strict=True)
    for name, group, plot in tasks:
        if group not in groups:
            continue
        figure, axes = plt.subplots(figsize=(8.0, 5.0), layout="constrained")
        plot(axes, groups[group])
        axes.grid(which="major", color="0.88", linewidth=0.7)
        axes.spines[["top", "right"]].set_visible(False)
        figure.savefig(folder / name, dpi=110)
        plt.close(figure)
        drawn.append(folder / name)
    return drawn


def _per_push(row):
    """Median time per push [µs]."""
    return row["stats"]["median"] / row["extra_info"]["points"] * 1e6


def _scaling(axes, rows):
    lines: dict[str, list[tuple[int, float]]] = {}
    for row in rows:
        info = row["extra_info"]
        lines.setdefault(info["contender"], []).append((info["points"], _per_push(row)))
    for name, line in lines.items():
        sizes, times = zip(*sorted(line), strict=True)
        if name.startswith(LIMIT):
            axes.axhline(times[-1], color="0.35", linewidth=1.2, linestyle=":")
            axes.annotate(
                f"{name}: {times[-1]:.2g} µs",
                (max(sizes), times[-1]),
                xytext=(0, -11),
                textcoords="offset points",
                ha="right",
                fontsize=9,
                color="0.35",
            )
            continue
        colour, dashes, marker = _STYLES.get(name, ("0.5", "-", "."))
        axes.plot(
            sizes,
            times,
            dashes,
            color=colour,
            marker=marker,
            markersize=4.5,
            linewidth=1.5,
            label=name,
        )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="pushes in one call",
        ylabel="time per push [µs]",
        title="F_p, d and their derivatives by mu_s, NumPy arrays in and out",
    )
    axes.legend(frameon=False, fontsize=9)


def _accuracy(axes, rows):
    for number, row in enumerate(sorted(rows, key=_per_push)):
        info = row["extra_info"]
        worst = max(info.get("errors") or [0.0])
        name = re.sub(r",? [\d ]+ pushes", "", info["contender"])
        name = name.replace("the same", "difffric, observe_batch")
        if not worst:  # its own reference's twin
            continue
        colour, marker = ("#c0392b", "o") if "difffric" in name else (f"C{number}", "s")
        fill = "none" if "own jit" in name else "full"
        axes.plot(_per_push(row), worst, marker, color=colour, fillstyle=fill, label=name)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="time per push [µs]",
        ylabel="worst relative error of F_p, d and their derivatives",
        title="Accuracy beside speed, one contact (lower left is better)",
    )
    axes.legend(frameon=False, fontsize=8, loc="upper left")
