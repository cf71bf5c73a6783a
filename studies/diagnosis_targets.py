"""What was asked of diagnoses, beside what a study has found so far and how sure that is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy import stats

from studies import diagnosis_figures as figures
from studies import reliability
from studies.calibration_figures import Share

Everything = Mapping[str, Sequence[dict]]
"""The cases of each group."""
OF_A_STRENGTH = ("s = 4", "s = 6", "s = 10")
BESIDE_A_BACKGROUND = ("background, 3 %", "background, 1 %", "three times, 3 %")
SHOWN = 10.0
"""Strength from which on an effect alone is beyond doubt."""
LEVEL = 0.95
"""Of the intervals of what is found."""
_RESAMPLED = 999


class Found(NamedTuple):
    """A figure with its interval, and its text."""

    value: float
    low: float
    high: float
    text: str


class Target(NamedTuple):
    """What is asked: that a figure lies between two values."""

    what: str
    least: float
    most: float
    find: Callable[[Everything], Found | None]
    """of the cases so far; None: there are none"""
    shown: str = ".0%"
    """how its values are written"""

    def describe(self) -> str:
        """What is asked, in words."""
        least, most = (format(x, self.shown).replace("%", " %") for x in (self.least, self.most))
        if self.least == -np.inf:
            return f"at most {most}"
        return f"at least {least}" if self.most == np.inf else f"{least} to {most}"

    def judge(self, found: Found | None) -> str:
        """`met` or `short` where the whole interval is so; else the cases are too few to tell."""
        if found is None:
            return "not run"
        if self.least <= found.low and found.high <= self.most:
            return "met"
        return "short" if found.high < self.least or found.low > self.most else "open"


def find_share(cases: Iterable[dict], of: Callable[[dict], bool]) -> Found | None:
    """In how many of the cases something is so, with the interval of Clopper and Pearson."""
    counted = figures.share(list(cases), of)
    if not counted.n:
        return None
    interval = stats.binomtest(counted.k, counted.n).proportion_ci(LEVEL)
    return Found(counted.value, interval.low, interval.high, str(counted))


def find_quantile(values: Iterable[float | None], p: float, shown: str = ".3g") -> Found | None:
    """A quantile of the values that are known, with the interval that ranks give, which is not
    bounded where there are too few."""
    known = np.array([x for x in values if x is not None], float)
    if not len(known):
        return None
    value = float(np.quantile(known, p))
    low, high = stats.quantile_test(known, q=value, p=p).confidence_interval(LEVEL)
    low, high = (-np.inf if np.isnan(low) else low), (np.inf if np.isnan(high) else high)
    return Found(value, low, high, f"{value:{shown}} ({len(known)} cases)")


def find_mean(values: Sequence[float]) -> Found | None:
    """A mean over rigs, with the interval of Student's t."""
    if len(values) < 2:
        return None
    mean, error = float(np.mean(values)), float(stats.sem(values))
    half = error * float(stats.t.ppf(0.5 + LEVEL / 2, len(values) - 1))
    return Found(mean, mean - half, mean + half, f"{100 * mean:.1f} % ({len(values)} rigs)")


def find_slope(cases: Sequence[dict]) -> Found | None:
    """The slope of the stated probabilities' log odds, with an interval of resampled cases."""
    p = np.array([x["causes"][0]["probability"] for x in cases if x["causes"]])
    right = np.array([x["causes"][0]["id"] in x["effects"] for x in cases if x["causes"]])
    if len(p) < 2 or right.all():
        return None
    rng, value = np.random.default_rng(0), reliability.slope(p, right)
    drawn = rng.integers(len(p), size=(_RESAMPLED, len(p)))
    low, high = np.quantile([reliability.slope(p[k], right[k]) for k in drawn], [0.025, 0.975])
    return Found(value, low, high, f"{value:.2f} ({len(p)} cases)")


def gather(everything: Everything, groups: Iterable[str]) -> list[dict]:
    """The cases of some groups that were made and diagnosed."""
    return [x for group in groups for x in figures.answered(everything.get(group, ()))]


def list_rated(everything: Everything) -> list[dict]:
    """The cases whose stated probabilities are rated: where all small effects are three times as
    large some of them matter too, and are rightly named."""
    return figures.with_one({k: v for k, v in everything.items() if k != "three times, 3 %"})


def _of_oracle(everything: Everything, scanned: bool) -> Found | None:
    """Of the effects whose own test is sure, how often the first set holds them."""
    cases = [x for x in gather(everything, OF_A_STRENGTH) if figures.is_sure(x)]
    mine = [x for x in cases if bool(set(x["effects"]) & set(figures.SCANNED)) == scanned]
    return find_share(mine, figures.first_right)


def _of_groups(groups: Sequence[str], of: Callable[[dict], bool]) -> Callable:
    return lambda everything: find_share(gather(everything, groups), of)


def _of_shown(group: str) -> Callable:
    """In how many cases of a group the first set is right, of those whose effect data show: what is
    one with mu_s, as a tilt is nearly, may change F_p by 3 % and have no strength at all."""

    def find(everything: Everything) -> Found | None:
        cases = [x for x in gather(everything, [group]) if x["s"] >= SHOWN]
        return find_share(cases, figures.first_right)

    return find


def _of_times(groups: Sequence[str]) -> Callable:
    def find(everything: Everything) -> Found | None:
        return find_quantile((x["seconds"] for x in gather(everything, groups)), 0.5, ".0f")

    return find


def _of_known(of: Callable[[dict], float | None], p: float) -> Callable:
    """A quantile over all cases with one effect or two."""
    groups = (*figures.ONE, "pairs")
    return lambda everything: find_quantile((of(x) for x in gather(everything, groups)), p)


def _of_intervals(groups: Sequence[str]) -> Callable:
    def find(everything: Everything) -> Found | None:
        return find_mean([x["mu_s_within"] for x in gather(everything, groups)])

    return find


def _is_anything_named(line: dict) -> bool:
    return bool(line["causes"])


def _locate(everything: Everything, group: str) -> Found | None:
    outside = [x for x in gather(everything, [group]) if figures.is_unexplained(x)]
    return find_share(outside, figures.is_located)


_IN_CATALOGUE = ("clean", "background", *figures.ONE, "pairs", "strong")
_ALL = np.inf
TARGETS = (
    Target("s = 4, 6 and 10: first set right, of those whose own test is sure",
           0.97, _ALL, partial(_of_oracle, scanned=False)),
    Target("the same, effects that are scanned", 0.93, _ALL, partial(_of_oracle, scanned=True)),
    Target("clean rigs: something named", -_ALL, 0.01, _of_groups(["clean"], _is_anything_named)),
    Target("nothing but a background: something named",
           -_ALL, 0.01, _of_groups(["background"], _is_anything_named)),
    Target("background, a cause of 3 %: named first",
           0.95, _ALL, _of_groups(["background, 3 %"], figures.first_right)),
    Target("the same, where the cause alone has s = 10 or more",
           0.95, _ALL, _of_shown("background, 3 %")),
    Target("background, a cause of 1 %: named first",
           0.80, _ALL, _of_groups(["background, 1 %"], figures.first_right)),
    Target("the same, where the cause alone has s = 10 or more",
           0.80, _ALL, _of_shown("background, 1 %")),
    Target("three times the background, 3 %: named first",
           0.85, _ALL, _of_groups(["three times, 3 %"], figures.first_right)),
    Target("the same, where the cause alone has s = 10 or more",
           0.85, _ALL, _of_shown("three times, 3 %")),
    Target("a cause beside a background: 95 % intervals of mu_s hold it",
           0.93, 0.97, _of_intervals(BESIDE_A_BACKGROUND)),
    Target("outsiders: `unexplained`",
           0.90, _ALL, _of_groups(["outsiders"], figures.is_unexplained)),
    Target("outsiders: the right component, of those",
           0.85, _ALL, partial(_locate, group="outsiders")),
    Target("outsiders of 3 % beside a background: `unexplained`",
           0.90, _ALL, _of_groups(["outsiders, background"], figures.is_unexplained)),
    Target("the right component, of those",
           0.85, _ALL, partial(_locate, group="outsiders, background")),
    Target("falsely `unexplained`",
           -_ALL, 0.03, _of_groups(_IN_CATALOGUE, figures.is_unexplained)),
    Target("pairs: both named", 0.90, _ALL, _of_groups(["pairs"], figures.are_all_named)),
    Target("pairs: a spurious third", -_ALL, 0.03, _of_groups(["pairs"], figures.spurious)),
    Target("stated probabilities: slope of log odds",
           0.9, 1.1, lambda everything: find_slope(list_rated(everything)), ".1f"),
    Target("held-out gain by the true model's, median",
           0.95, _ALL, _of_known(figures.gained, 0.5), ".2f"),
    Target("the same, 5th percentile", 0.80, _ALL, _of_known(figures.gained, 0.05), ".2f"),
    Target("error of mu_s by the true model's, median",
           -_ALL, 1.2, _of_known(figures.compare_friction, 0.5), ".1f"),
    Target("the same, 95th percentile",
           -_ALL, 2.0, _of_known(figures.compare_friction, 0.95), ".1f"),
    Target("seconds, nothing hidden, median", -_ALL, 3.0, _of_times(["clean"]), ".0f"),
    Target("seconds, one cause (s = 6, 10 and 30), median",
           -_ALL, 8.0, _of_times(["s = 6", "s = 10", "s = 30"]), ".0f"),
    Target("seconds, two causes or an outsider, median",
           -_ALL, 15.0, _of_times(["pairs", "outsiders"]), ".0f"),
)  # fmt: skip
"""The figures of recordings; tables are in the groups' own."""


def tabulate(everything: Everything) -> str:
    """All targets, a row each."""
    rows = ["| figure | asked | found | 95 % interval | |", "| --- | --- | --- | --- | --- |"]
    for target in TARGETS:
        found = target.find(everything)
        text = "–" if found is None else found.text
        between = "–" if found is None else _write_interval(target, found)
        rows.append(
            f"| {target.what} | {target.describe()} | {text} | {between} | {target.judge(found)} |"
        )
    return "\n".join(rows)


def _write_interval(target: Target, found: Found) -> str:
    """The interval of a figure, open where no rank bounds it."""
    shown = ".1%" if "%" in target.shown else ".3g"
    low, high = (format(x, shown).replace("%", " %") for x in (found.low, found.high))
    if np.isinf(found.low):
        return "–" if np.isinf(found.high) else f"up to {high}"
    return f"from {low}" if np.isinf(found.high) else f"{low} to {high}"


def count_cases(everything: Everything, sizes: Mapping[str, int]) -> Share:
    """How many cases have run, those included that could not be made, of all."""
    return Share(sum(len(everything.get(x, ())) for x in sizes), sum(sizes.values()))
