"""`difffric identify ARCHIVE`: what result.json and the report say of a fleet."""

from __future__ import annotations

import numpy as np

from difffric.commands import figures
from difffric.commands.reports.page import NO_STROKE, Picture, Report, Section, Table
from difffric.fleet.identify_archive import DATA_SET, Fleet
from difffric.number_text import format_number, format_pair

_LISTED = 50
"""Lines of a report's list of what was left out; the rest is in bad.csv."""
_APART = 3.0
"""Standard errors between force and distance from which a push is counted as `apart`."""


def describe_fleet(fleet: Fleet) -> dict:
    """Counts, and each rig's summary, as `difffric identify ARCHIVE` writes it. Nothing in it says
    how often a run was interrupted."""
    per_rig = {row["rig"]: row for row in _summarise(fleet, "rig")}
    bad = [rig for rig, _, _ in fleet.bad]
    left_out = [rig for rig, _, _ in fleet.skipped]
    rigs = []
    for rig, files in sorted(fleet.files.items()):
        row = per_rig.get(rig, _NOTHING)
        counts = {
            "files": files,
            "bad_files": bad.count(rig),
            "skipped_pushes": left_out.count(rig),
        }
        rigs.append({"rig": rig, **counts, **{k: row[k] for k in _NOTHING}})
    total = {
        key: sum(row[key] for row in rigs)
        for key in ("files", "bad_files", "skipped_pushes", "pushes", "identified", "apart")
    }
    return {
        "data_set": DATA_SET,
        **total,
        "rigs": rigs,
        "bad": [{"rig": rig, "file": file, "reason": why} for rig, file, why in fleet.bad],
        "skipped": [{"rig": rig, "file": file, "reason": why} for rig, file, why in fleet.skipped],
    }


_NOTHING = {
    "pushes": 0,
    "identified": 0,
    "apart": 0,
    "mu_s_mean": None,
    "mu_s_standard_error": None,
    "spread": None,
    "first_date": None,
    "last_date": None,
}


def _summarise(fleet: Fleet, *by: str) -> list[dict]:
    """A row a group: how many pushes, how mu_s lies. In NumPy, whose sums are always the same."""
    columns = ("rig", "date", "mu_s", "disagreement")
    parts = fleet.pushes.select(columns).collect().partition_by(*by, maintain_order=True)
    rows = []
    for part in parts:
        mu = part["mu_s"].drop_nulls().to_numpy()
        n, mean = len(mu), float(np.mean(mu)) if len(mu) else None
        std = float(np.std(mu, ddof=1)) if n > 1 else None
        rows.append(
            {
                "rig": part["rig"][0],
                "date": part["date"][0],
                "pushes": len(part),
                "identified": n,
                "apart": int((part["disagreement"].abs() > _APART).sum()),
                "mu_s_mean": mean,
                "mu_s_standard_error": None if std is None else std / n**0.5,
                "spread": None if std is None or not mean else std / mean,
                "first_date": part["date"].min(),
                "last_date": part["date"].max(),
            }
        )
    return rows


def report_fleet(fleet: Fleet, answer: dict, pictures: bool) -> Report:
    """The fleet for a person."""
    drawn = []
    days: dict[str, list[dict]] = {}
    for row in _summarise(fleet, "rig", "date") if pictures else ():
        if row["identified"]:
            days.setdefault(row["rig"], []).append(row)
    if days:
        drawn.append(
            Picture(
                "mu_s_by_date",
                "mu_s of each rig, a point for the mean of each day's pushes; the bars are one "
                "standard deviation between them. Rigs beyond the twelve with most days are grey.",
                figures.fleet.draw_by_date(days),
            )
        )
    text = (
        "mu_s of a push is the optimal combination of what force and distance tell, and that of a "
        "free slide what its release speed and distance tell. Means count each push once. Their "
        "standard errors come from how the pushes differ; the calibration's error, which all "
        "pushes share, is not in them.",
    )
    sections = [Section("Rigs", text, [_tabulate_rigs(answer)], drawn)]
    left_out = [
        [x["rig"], x["file"], what, x["reason"]]
        for key, what in (("bad", "file"), ("skipped", "push"))
        for x in answer[key]
    ]
    if left_out:
        rest = len(left_out) - _LISTED
        note = (f"The first {_LISTED} of {len(left_out)}; all stand in bad.csv.",) * (rest > 0)
        table = Table("What could not be used, and why", _COLUMNS, left_out[:_LISTED])
        sections.append(Section("Left out", note, [table]))
    advice = []
    if answer["apart"]:
        advice.append("Run difffric diagnose on the archive: it looks for what the model lacks.")
    if answer["bad_files"] or answer["skipped_pushes"]:
        advice.append("See bad.csv for the files and pushes that could not be used, and why.")
    if not advice:
        advice.append(f"Read {DATA_SET}, which holds all pushes, with any tool for Parquet.")
    return Report("A fleet's friction", _write_summary(fleet, answer), sections, advice)


_COLUMNS = ("rig", "file", "what", "reason")


def _write_summary(fleet: Fleet, answer: dict) -> list[str]:
    rigs = [row for row in answer["rigs"] if row["pushes"]]
    lines = [
        f"{answer['pushes']} pushes in {answer['files'] - answer['bad_files']} files of "
        f"{len(rigs)} rigs; {answer['identified']} give mu_s."
    ]
    if answer["bad_files"] or answer["skipped_pushes"]:
        lines.append(
            f"{answer['bad_files']} files and {answer['skipped_pushes']} pushes of other files "
            "could not be used: they are listed below and in bad.csv."
        )
    if answer["apart"]:
        lines.append(
            f"In {answer['apart']} pushes force and distance differ by more than three standard "
            "errors: the model or the set-up is not right for them."
        )
    if fleet.without_stroke:
        lines.append(f"{len(fleet.without_stroke)} rigs: {NO_STROKE}")
    return lines


def _tabulate_rigs(answer: dict) -> Table:
    rows = []
    for row in answer["rigs"]:
        mean, error = format_pair(row["mu_s_mean"], row["mu_s_standard_error"])
        spread = None if row["spread"] is None else 100 * row["spread"]
        days = " to ".join(dict.fromkeys(x for x in (row["first_date"], row["last_date"]) if x))
        counts = (str(row[k]) for k in ("files", "bad_files", "pushes", "identified", "apart"))
        rows.append([row["rig"], *counts, mean, error, format_number(spread, 3), days or "–"])
    columns = (
        "rig",
        "files",
        "bad files",
        "pushes",
        "with mu_s",
        "force and distance contradict",
        "mean mu_s",
        "standard error",
        "spread [%]",
        "dates",
    )
    return Table("The rigs", columns, rows)
