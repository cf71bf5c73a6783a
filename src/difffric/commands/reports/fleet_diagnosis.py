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
        columns = ("effect", "rigs", "number", "pooled", "± s.e.", "between rigs", "Q", "p of Q")
        text = (
            "Pooled: the mean weighted by each rig's own error and by how much the rigs differ "
            "(between rigs). p of Q: how often equal sizes would differ as much by chance.",
        )
        sections.append(Section("Shared effects", text, [Table("Shared", columns, rows)]))
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
    tables = [Table("By rig", columns, rows)]
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
    return Report("A fleet's diagnosis", summarise(found), sections)


_CAPTION = (
    "Each rig's evidence for each effect beside those it names, and on top that of all rigs "
    "together, corrected for the number of effects. Detailed answers of each rig lie in "
    f"{RIGS}/."
)
_EVIDENCE = (
    "Chi-squares of all rigs that can tell an effect, summed; every effect by itself, so that one "
    "that is there speaks for those that look like it, too. One rig and two rigs: the probability "
    "that chance gives as much where none has it, and where one at most has."
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
        "χ²",
        "numbers",
        "p, one rig",
        "p, two rigs",
        "rigs at least",
    )
    return Table("Summed over the rigs, the leading effects", columns, rows)


def _draw_matrix(found: FleetDiagnosis):
    words = dict.fromkeys(found.found.unexplained, "unexplained")
    odd = {x.rig for x in found.differ} if len(found.answers) > 1 else set()
    rigs = sorted(found.answers)
    return figures.fleet_diagnosis.draw_matrix(found.found.rows, rigs, words, odd)
