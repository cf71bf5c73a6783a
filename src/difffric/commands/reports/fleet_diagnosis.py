"""The answer and report of `difffric diagnose ARCHIVE`."""

from __future__ import annotations

from difffric.commands import figures
from difffric.commands.reports.page import Picture, Report, Section, Table
from difffric.fleet.diagnose_archive import RIGS
from difffric.fleet.identify_archive import escape
from difffric.fleet.shared_effects import (
    CAUSES,
    KNOWN,
    NAMED,
    NEGLIGIBLE,
    NOT_VISIBLE,
    POSSIBLE,
    Row,
    Shared,
)
from difffric.fleet.verdict import (
    LINES,
    FleetDiagnosis,
    describe_difference,
    describe_effect,
    summarise,
)
from difffric.number_text import format_number, format_pair


def describe_fleet_diagnosis(found: FleetDiagnosis) -> dict:
    """Return the fleet's diagnosis as result.json holds it.

    Nothing in it says how often a run was interrupted: an interrupted one ends in the same bytes.
    """
    rigs = []
    for rig, a in sorted(found.answers.items()):
        causes = a["diagnosis"]["causes"]
        rigs.append(
            {
                "rig": rig,
                **{key: a[key] for key in ("files", "files_used", "pushes", "recordings")},
                "verdict": a["diagnosis"]["verdict"],
                "causes": [c["id"] for c in causes],
                "differs": [describe_difference(found, x) for x in found.differ if x.rig == rig],
                "left_out": a["left_out"],
                "result": f"{RIGS}/{escape(rig)}/result.json",
            }
        )
    return {
        "lines": summarise(found),
        "shared": [_describe_shared(found, one) for one in found.found.shared],
        "differ": [
            {
                "rig": x.rig,
                "effect": x.effect,
                "how": x.how,
                "p_value": x.p_value,
                "text": describe_difference(found, x),
            }
            for x in found.differ
        ],
        "rigs": rigs,
        "effects": [_describe_effect(row) for row in found.found.rows],
        "bad": [{"rig": rig, "reason": why} for rig, why in found.bad],
    }


def _describe_effect(row: Row) -> dict:
    def find_marked(mark):
        return sorted(rig for rig, x in row.marks.items() if x == mark)

    return {
        "id": row.effect,
        **{mark: find_marked(mark) for mark in (NAMED, POSSIBLE, NEGLIGIBLE, NOT_VISIBLE, KNOWN)},
        "chi2": row.chi2,
        "degrees_of_freedom": row.freedom,
        "p_value": row.p_value,
        "p_value_two_rigs": row.p_value_two,
        "at_least": row.at_least,
        "p_values": dict(sorted(row.p_values.items())),
    }


def _describe_shared(found: FleetDiagnosis, one: Shared) -> dict:
    return {
        "id": one.effect,
        "text": describe_effect(one.effect),
        "by": one.by,
        "confusable_with": list(one.alike),
        "rigs": sorted(one.rigs),
        "at_least": one.row.at_least,
        "parameters": {
            key: {
                "value": x.value,
                "standard_error": x.standard_error,
                "between_rigs": x.between,
                "q": x.q,
                "p_value": x.p_value,
                "rigs": x.n,
                "of": {
                    rig: {"value": v, "standard_error": s}
                    for rig, (v, s) in sorted(one.sizes[key].items())
                },
            }
            for key, x in one.parameters.items()
        },
        "without": [
            {"rig": rig, "excess": found.excess.get((one.effect, rig))}
            for rig in sorted(one.without)
        ],
    }


def report_fleet_diagnosis(found: FleetDiagnosis, pictures: bool) -> Report:
    """Return the report of a fleet's diagnosis; with figures where there are to be pictures."""
    sections = []
    if found.found.shared:
        rows = [row for one in found.found.shared for row in _list_shared(one)]
        columns = (
            "effect",
            "rigs",
            "parameter",
            "pooled value",
            "standard error",
            "spread between rigs",
            "Q",
            "p-value of Q",
        )
        text = (
            "The pooled value is the mean, weighted by each rig's own error and by the spread "
            "between the rigs. The p-value of Q says how often rigs with equal sizes would differ "
            "as much by chance.",
        )
        sections.append(
            Section("Shared effects", text, [Table("Effects that rigs share", columns, rows)])
        )
    drawn = []
    if pictures and found.found.rows:
        drawn.append(Picture("effects", _CAPTION, _draw_matrix(found)))
    rows = [
        [
            rig,
            f"{a['files_used']} of {a['files']}",
            str(a["pushes"]),
            a["diagnosis"]["verdict"],
            ", ".join(c["id"] for c in a["diagnosis"]["causes"]) or "–",
            "; ".join(x.how for x in found.differ if x.rig == rig) or "–",
        ]
        for rig, a in sorted(found.answers.items())
    ]
    columns = ("rig", "files", "pushes", "verdict", "causes", "differs by")
    tables = [Table("The rigs", columns, rows)]
    if len(found.differ) > LINES:
        every = [[x.rig, describe_difference(found, x)] for x in found.differ]
        tables.append(Table("Rigs that differ", ("rig", "how"), every))
    sections.append(Section("Rigs", (), tables, drawn))
    sections.append(Section("Evidence", (_EVIDENCE,), [_tabulate_evidence(found)]))
    left_out = [[a["rig"], x] for _, a in sorted(found.answers.items()) for x in a["left_out"]]
    left_out = [[rig, why] for rig, why in found.bad] + left_out
    if left_out:
        table = Table("What could not be used, or was left out", ("rig", "why"), left_out)
        sections.append(Section("Left out", (), [table]))
    advice = ["Look first at the rigs that differ, then at what all of them share."]
    if found.bad:
        advice.append("See below which rigs could not be diagnosed, and why.")
    return Report("A fleet's diagnosis", summarise(found), sections, advice)


_CAPTION = (
    "The evidence of each rig for each effect, beside those that it names. The row on top is that "
    "of all rigs together, corrected for the number of effects. The answers of each rig lie in "
    f"{RIGS}/."
)
_EVIDENCE = (
    "For each effect the chi-squares of all rigs that can tell it are summed. Every effect stands "
    "by itself, so that one that is there speaks for those that look like it, too. The p-values "
    "say how often chance gives as much where no rig has the effect, and where one at most has it."
)


def _list_shared(one: Shared) -> list[list[str]]:
    name = " or ".join((one.effect, *one.alike))
    start = [name, str(len(one.rigs)) if one.by == CAUSES else f"≥ {one.row.at_least}"]
    rows = [
        [
            *start,
            key,
            *format_pair(x.value, x.standard_error),
            format_number(x.between, 2),
            format_number(x.q, 3),
            format_number(x.p_value, 2),
        ]
        for key, x in one.parameters.items()
    ]
    return rows or [[*start, "–", "–", "–", "–", "–", "–"]]


def _tabulate_evidence(found: FleetDiagnosis, most: int = 12) -> Table:
    rows = [
        [
            row.effect,
            *(str(sum(x == mark for x in row.marks.values()) or "–") for mark in (NAMED, POSSIBLE)),
            format_number(row.chi2, 3),
            str(row.freedom),
            format_number(row.p_value, 2),
            format_number(row.p_value_two, 2),
            str(row.at_least or "–"),
        ]
        for row in found.found.rows[:most]
    ]
    columns = (
        "effect",
        "named",
        "possible",
        "chi-square",
        "degrees of freedom",
        "p-value for any rig",
        "p-value for two rigs",
        "rigs that have it, at least",
    )
    return Table("Summed over the rigs, the leading effects", columns, rows)


def _draw_matrix(found: FleetDiagnosis):
    words = dict.fromkeys(found.found.unexplained, "unexplained")
    odd = {x.rig for x in found.differ} if len(found.answers) > 1 else set()
    rigs = sorted(found.answers)
    return figures.fleet_diagnosis.draw_matrix(found.found.rows, rigs, words, odd)
