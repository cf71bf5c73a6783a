"""Stated probabilities beside how often the first cause was the truth."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy import optimize, stats

BINS = (0.0, 0.5, 0.8, 0.95, 0.99, 1.0)
"""Of stated probabilities."""


def tabulate(lines: Sequence[dict]) -> list[str]:
    """Stated probabilities beside how often the first cause was the truth."""
    there = [x for x in lines if x["causes"]]
    p = np.array([x["causes"][0]["probability"] for x in there])
    right = np.array([x["causes"][0]["id"] in x["effects"] for x in there])
    out = ["| stated | cases | mean stated | right |", "| --- | --- | --- | --- |"]
    for low, high in pairwise(BINS):
        mine = (p > low) & (p <= high)
        if mine.any():
            out.append(
                f"| {low:g} to {high:g} | {mine.sum()} | {p[mine].mean():.3f} "
                f"| {right[mine].mean():.3f} |"
            )
    if len(p) > 20 and not right.all():
        out.append(f"\nSlope of log odds (asked: 0.9 to 1.1): {slope(p, right):.2f}.")
    return out


def slope(p: np.ndarray, right: np.ndarray) -> float:
    """b of logit P(right) = b logit p, by maximum likelihood; p is held within 1e-4 of 0 and 1."""
    q = np.clip(p, 1e-4, 1 - 1e-4)
    odds = np.log(q / (1 - q))

    def cost(b):
        return np.logaddexp(0, np.where(right, -b, b) * odds).sum()

    return float(optimize.minimize_scalar(cost, bounds=(0, 10), method="bounded").x)


def draw(lines: Sequence[dict], path: Path) -> None:
    """Stated probabilities against how often the first cause was the truth, as a picture."""
    from matplotlib.figure import Figure

    lines = [x for x in lines if x["causes"]]
    if not lines:
        return
    p = np.array([x["causes"][0]["probability"] for x in lines])
    right = np.array([x["causes"][0]["id"] in x["effects"] for x in lines])
    axes = (figure := Figure(figsize=(5, 5), layout="constrained")).add_subplot()
    axes.plot([0, 1], [0, 1], color="0.6", lw=1)
    for i, (low, high) in enumerate(pairwise(BINS)):
        mine = (p > low) & (p <= high)
        if n := int(mine.sum()):
            k, at = int(right[mine].sum()), p[mine].mean()
            limits = stats.beta.ppf(
                [0.025, 0.975], [max(k, 0.5), k + 1], [n - k + 1, max(n - k, 0.5)]
            )
            axes.plot([at, at], limits, color="C0")
            axes.plot(at, k / n, "o", color="C0")
            beside = (-6, 4 if i % 2 else -12)  # the last two bins are close together
            axes.annotate(
                f"{n}", (at, k / n), xytext=beside, textcoords="offset points", ha="right"
            )
    axes.set_xlabel("probability stated of the first cause")
    axes.set_ylabel("share in which it was the truth")
    figure.savefig(path, dpi=110)
