"""The answer and report of `difffric centre`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from difffric.centering.planning import Known
from difffric.commands import figures
from difffric.commands.reports.page import Picture, Report, Section, Table
from difffric.commands.reports.plan import describe_push
from difffric.number_text import format_number
from difffric.studies.centering_runs import OURS, CenteringRun, summarize_ways
from difffric.studies.other_centering import RIVALS
from difffric.units import to_um


def describe_centering(found: Sequence[CenteringRun], known: Known, seed: int) -> dict:
    """Return all runs as result.json holds them."""
    return {
        "within_m": known.within,
        "seed": seed,
        "ways": summarize_ways(found, known.within),
        "calibration": assess_probabilities(
            *_pair_outcomes([r for r in found if r.way == OURS], known)
        ),
        "runs": [_describe_run(r, known) for r in found],
    }


def _describe_run(r: CenteringRun, known: Known) -> dict:
    c = r.centering
    return {
        "way": r.way,
        "offset_m": float(np.hypot(*r.ring.offset)),
        "mu_s": r.ring.mu_s,
        "centred": r.is_centred(known.within),
        "left_m": float(np.hypot(*r.path[-1])),
        "probability": c.probability,
        "time_s": c.time,
        "measurements": c.measurements,
        "reason": c.reason,
        "notes": list(c.notes),
        "pushes": [
            {
                **describe_push(p.plan.next),
                "peak_force_N": _drop_nan(p.readings.peak_force),
                "sliding_distance_m": _drop_nan(p.readings.sliding_distance),
                "displacement_m": p.readings.displacement,
                "mu_s_identified": p.mu_s,
                "mu_s_known": p.known_mu_s[0],
                "mu_s_known_relative_standard_error": p.known_mu_s[1],
                "within": bool(inside),
                "left_m": float(np.hypot(*at)),
            }
            for p, inside, at in zip(c.pushes, r.within(known.within), r.path[1:], strict=True)
        ],
    }


def _drop_nan(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None


def assess_probabilities(stated: NDArray, landed: NDArray) -> dict:
    """Hold stated probabilities (n,) of landing against whether the rings landed (n,), 1 or 0.

    Returns the slope of a straight line through the outcomes, which is 1 where the probabilities
    are right, its standard error, and the shares in bins of probability.
    """
    out: dict = {"pushes": len(stated), "slope": None, "slope_standard_error": None, "bins": []}
    if len(stated) > 10 and np.ptp(stated) > 0:
        A = np.stack([np.ones_like(stated), stated], axis=1)
        beta, *_ = np.linalg.lstsq(A, landed, rcond=None)
        bread = np.linalg.inv(A.T @ A)
        meat = (A * ((landed - A @ beta) ** 2)[:, None]).T @ A  # outcomes differ in variance
        out["slope"] = float(beta[1])
        out["slope_standard_error"] = float(np.sqrt((bread @ meat @ bread)[1, 1]))
    edges = np.array([0, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 0.97, 0.99, 0.999, 1.0000001])
    for lo, hi in pairwise(edges):
        here = (stated >= lo) & (stated < hi)
        if here.any():
            p, y = stated[here], landed[here]
            out["bins"].append({"pushes": int(here.sum()), "stated": p.mean(), "seen": y.mean()})
    return out


def _pair_outcomes(found: Sequence[CenteringRun], known: Known):
    """(the stated probability of each push, whether it landed)."""
    stated = [p.plan.next.probability for r in found for p in r.centering.pushes]
    landed = [inside for r in found for inside in r.within(known.within)]
    return np.array(stated), np.array(landed, float)


def report_centering(
    answer: dict, found: Sequence[CenteringRun], known: Known, pictures: bool
) -> Report:
    """Return the report of all runs; with figures where there are to be pictures."""
    ways, ours = answer["ways"], answer["ways"][OURS]
    within = f"{to_um(known.within):g} µm"
    summary = [
        f"In the end {100 * ours['centred']:.1f} % of {ours['rings']} rings are within {within} of "
        "the axis.",
        f"A ring takes {ours['time_median_s']:.2f} s in the median, with {ours['pushes_mean']:.2f} "
        f"pushes and {ours['measurements_mean']:.2f} measurements on average.",
    ]
    rows = [
        [
            RIVALS.get(way, "difffric: exact model, landing probabilities"),
            f"{100 * w['centred']:.1f}",
            f"{w['time_median_s']:.2f}",
            f"{w['time_mean_s']:.2f}",
            f"{w['pushes_mean']:.2f}",
            f"{w['measurements_mean']:.2f}",
        ]
        for way, w in ways.items()
    ]
    columns = (
        "way", "centred [%]", "median time [s]", "mean time [s]", "pushes", "measurements",
    )  # fmt: skip
    tables = [Table("Ways to centre the same rings", columns, rows)]
    bins = answer["calibration"]["bins"]
    slope, error = answer["calibration"]["slope"], answer["calibration"]["slope_standard_error"]
    if bins:
        caption = "How often rings landed, by the probability that was stated before"
        if slope is not None:
            caption += (
                f"; the slope of the outcomes over it is {slope:.3f} ± {error:.3f}, 1 is right"
            )
        rows = [[str(b["pushes"]), f"{b['stated']:.4f}", f"{b['seen']:.4f}"] for b in bins]
        tables.append(Table(caption, ("pushes", "stated probability", "share that landed"), rows))
    notes = sorted({note for r in found for note in r.centering.notes if r.way == OURS})
    first = next(r for r in found if r.way == OURS)
    tables.append(_tabulate_ring(first, known))
    drawn = []
    if pictures:
        drawn = [
            Picture(
                "run",
                "The first ring, centred by difffric: its offset after each push, where it was "
                "expected to be, and what was known of mu_s.",
                figures.plan.draw_run(first.centering, known, first.path),
            ),
            Picture(
                "times",
                "The share of the rings that each way has centred after a time. A curve that does "
                "not reach 1 did not centre all of them.",
                figures.plan.draw_times(
                    {way: _find_times([r for r in found if r.way == way], known) for way in ways}
                ),
            ),
        ]
    text = (
        "The machine is simulated. Its friction is hidden, and scatters from push to push. A "
        "measurement takes 2 s, a push its own time and 1 s. Each way meets the same rings, noise "
        "and scatter.",
        *notes,
    )
    advice = [
        "Use difffric plan for the next push of a real part, with the set-up that was tried here."
    ]
    return Report("Rings centred", summary, [Section("Rings", text, tables, drawn)], advice)


def _find_times(found: Sequence[CenteringRun], known: Known) -> list[float]:
    """Return the time of each run [s], infinite where its ring was not centred."""
    return [r.centering.time if r.is_centred(known.within) else np.inf for r in found]


def _tabulate_ring(r: CenteringRun, known: Known) -> Table:
    rows = []
    for i, (p, at) in enumerate(zip(r.centering.pushes, r.path[1:], strict=True), 1):
        s = p.plan.next
        rows.append(
            [
                str(i),
                format_number(60e3 * s.velocity, 4),
                format_number(to_um(s.stroke), 5),
                format_number(to_um(s.aim), 5),
                f"{s.probability:.3f}",
                format_number(p.mu_s, 4),
                format_number(to_um(float(np.hypot(*at))), 3),
            ]
        )
    columns = (
        "push",
        "speed [mm/min]",
        "stroke [µm]",
        "aim [µm]",
        "probability to land",
        "mu_s found",
        "true offset left [µm]",
    )
    return Table(
        f"The first ring, which was {to_um(float(np.hypot(*r.ring.offset))):.1f} µm off, with a "
        f"true mu_s of {r.ring.mu_s:.4f}",
        columns,
        rows,
    )
