"""The figures of the study: shares, coverage, and whether they are what was asked for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

LABELS = ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m", "mu_s")
LEVEL = 0.95
SIGNIFICANCE = 0.01
WITHIN, REACHED, CORRELATED = 0.99, 0.99, 0.90
"""Asked for: the share within three standard errors, the share at the right optimum, and the
coverage of 95 % intervals under correlated noise."""
WORSE, APART = 0.1, 0.2
"""A fit is at another optimum than the one started at the truth where its misfit is worse by more
than the first and a parameter lies further away than the second, in standard errors."""
SAYS_SO = "chi-square"
"""what the note on a misfit too large speaks of"""
TITLES = {
    "tables": "tables, standard errors given",
    "recordings": "recordings, white noise",
    "correlated": "recordings, AR(1) noise, 0.9",
    "spreads": "tables, spreads estimated (for information)",
}


class Share(NamedTuple):
    """k of n."""

    k: int
    n: int

    @property
    def value(self) -> float:
        return self.k / self.n if self.n else math.nan

    def __str__(self) -> str:
        return f"{100 * self.value:.1f} % ({self.k} of {self.n})" if self.n else "–"


def answered(lines: Sequence[dict]) -> list[dict]:
    """The cases in which a fit came back."""
    return [line for line in lines if "error" not in line]


def z_scores(lines: Sequence[dict], label: str) -> np.ndarray:
    """(value - truth) / standard error of each case that has one."""
    of = [(line["parameters"][label], line["truth"][label]) for line in answered(lines)]
    return np.array([(p["value"] - true) / p["se"] for p, true in of if p["se"]])


def covered(lines: Sequence[dict], label: str) -> list[bool | None]:
    """Whether the 95 % interval holds the truth, a case each; None where there is no interval."""
    of = [(line["parameters"][label], line["truth"][label]) for line in answered(lines)]
    return [None if p["low"] is None else bool(p["low"] <= true <= p["high"]) for p, true in of]


def within_3(lines: Sequence[dict], labels: Sequence[str] = LABELS) -> Share:
    """Parameters within three standard errors of the truth; a fit that failed has none."""
    z = np.concatenate([z_scores(lines, label) for label in labels] or [np.zeros(0)])
    failed = len(labels) * (len(lines) - len(answered(lines)))
    return Share(int(np.sum(np.abs(z) <= 3)), len(z) + failed)


def coverage(lines: Sequence[dict], labels: Sequence[str] = LABELS) -> tuple[Share, float]:
    """How many intervals hold the truth, and the p-value of that under 95 %.

    Exact binomial for one parameter. Those of one rig are not independent: for several together
    the test is normal, with the binomial variance times what the variance between rigs is of it.
    """
    table = [covered(lines, label) for label in labels]
    rigs = [[x for x in row if x is not None] for row in zip(*table, strict=True)]
    share = Share(sum(map(sum, rigs)), sum(map(len, rigs)))
    if share.n == 0:
        return share, math.nan
    if len(labels) == 1:
        return share, float(stats.binomtest(share.k, share.n, LEVEL).pvalue)
    rate, n = share.value, share.n
    between = sum((sum(row) - rate * len(row)) ** 2 for row in rigs)
    times = between / (n * rate * (1 - rate)) if 0 < rate < 1 else 1.0
    spread = math.sqrt(times * n * LEVEL * (1 - LEVEL))
    return share, float(2 * stats.norm.sf(abs(share.k - LEVEL * n) / spread))


def at_bound(lines: Sequence[dict]) -> dict[str, int]:
    """Label -> in how many cases it went to a bound and has no standard error."""
    good = answered(lines)
    found = {x: sum(line["parameters"][x]["se"] is None for line in good) for x in LABELS}
    return {label: n for label, n in found.items() if n}


def reached(line: dict) -> bool:
    """Whether the fit is at least as good as the one started at the truth, or at its place."""
    if "error" in line:
        return False
    other = line["from_truth"]
    return other is None or not (
        line["misfit"] - other["misfit"] > WORSE and other["apart"] > APART
    )


def said_so(line: dict) -> bool:
    """Whether the fit says that it may not be at the optimum."""
    if "error" in line:
        return True
    return not line["converged"] or any(SAYS_SO in note for note in line["notes"])


def complaints(everything: Mapping[str, Sequence[dict]]) -> list[str]:
    """What was asked for and is not so."""
    out = []
    for kind, lines in everything.items():
        if not lines or kind == "spreads":
            continue
        correlated = kind == "correlated"
        share = within_3(lines)
        if not correlated and share.value < WITHIN:
            out.append(f"{kind}: {share} of the parameters within 3 standard errors")
        for labels in (*((label,) for label in LABELS), LABELS):
            share, p = coverage(lines, labels)
            what = labels[0] if len(labels) == 1 else "all parameters"
            if not correlated and p < SIGNIFICANCE:
                out.append(f"{kind}: 95 % intervals of {what} cover {share}, p = {p:.1g}")
            if correlated and share.value < CORRELATED:
                out.append(f"{kind}: 95 % intervals of {what} cover {share}")
        share = Share(sum(map(reached, lines)), len(lines))
        if share.value < REACHED:
            out.append(f"{kind}: {share} reached the right optimum")
        silent = [line["case"] for line in lines if not reached(line) and not said_so(line)]
        if silent:
            out.append(f"{kind}: at another optimum and do not say so: {silent}")
        failed = [line["case"] for line in lines if "error" in line]
        if failed:
            out.append(f"{kind}: no answer: {failed}")
    return out


def column(lines: Sequence[dict]) -> list[str]:
    """One kind's figures, in the order of `ROWS`."""
    good = answered(lines)
    cells = [str(len(lines)), str(within_3(lines))]
    for labels in (LABELS, *((label,) for label in LABELS)):
        share, p = coverage(lines, labels)
        cells.append(f"{100 * share.value:.1f} % (p = {p:.2g})" if share.n else "–")
    bound = at_bound(lines)
    cells.append(", ".join(f"{label} {n}" for label, n in bound.items()) or "none")
    z = np.concatenate([line["own_mu_s_z"] for line in good] or [np.zeros(0)])
    cells.append(f"{100 * np.mean(np.abs(z) <= 1.96):.1f} %" if len(z) else "–")
    wrong = [line for line in lines if not reached(line)]
    cells.append(str(Share(len(lines) - len(wrong), len(lines))))
    cells.append(f"{sum(map(said_so, wrong))} of {len(wrong)}")
    cells.append(str(sum(not line["converged"] for line in good)))
    cells.append(str(len(lines) - len(good)))
    cells.append(f"{np.median([line['seconds'] for line in good]):.1f} s" if good else "–")
    return cells


ROWS = (
    "rigs",
    "parameters within 3 standard errors",
    "coverage of 95 % intervals, all",
    *(f"of {label}" for label in LABELS),
    "at a bound, without a standard error",
    "each push's own mu_s within 1.96 of its standard errors",
    "reached the right optimum",
    "of the others, say so",
    "not converged",
    "no answer",
    "median time of a fit",
)


def markdown(everything: Mapping[str, Sequence[dict]], code: str) -> str:
    """The figures as a table, a column a kind."""
    there = {kind: lines for kind, lines in everything.items() if lines}
    if not there:
        return "Nothing was run yet."
    head = ["", *(TITLES[kind] for kind in there)]
    columns = [column(lines) for lines in there.values()]
    rows = [[name, *cells] for name, cells in zip(ROWS, zip(*columns, strict=True), strict=True)]
    table = "\n".join("| " + " | ".join(r) + " |" for r in (head, ["---"] * len(head), *rows))
    missed = [f"- {x}" for x in complaints(everything)]
    after = ["Missed:\n\n" + "\n".join(missed)] if missed else ["All figures are met."]
    return "\n\n".join([f"Measured with source `{code}`.", table, *after])
