"""The cases of the study of diagnoses that went wrong, one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from studies import diagnosis_figures as figures


def list_missed(everything: Mapping[str, Sequence[dict]]) -> list[str]:
    """Hidden effects that are not in the first set, a line each."""
    out = []
    for group in figures.ONE:
        for x in figures.answered(everything.get(group, ())):
            if not figures.first_right(x):
                hidden = ", ".join(x["effects"])
                out.append(f"{group} {x['case']}: {hidden}, s = {x['s']:.3g}: {_tell(x)}")
    return out


def list_misplaced(everything: Mapping[str, Sequence[dict]]) -> list[str]:
    """What is outside the catalogue, and is not said to be so or not where it is, a line each."""
    out = []
    for group in (x for x in everything if x.startswith("outsiders")):
        for x in figures.answered(everything[group]):
            if not (figures.is_unexplained(x) and figures.is_located(x)):
                out.append(f"{group} {x['case']}: {', '.join(x['outsider'])}: {_tell(x)}")
    return out


def list_alarms(everything: Mapping[str, Sequence[dict]]) -> list[str]:
    """Rigs without a cause in which something is named, or `unexplained`, a line each."""
    out = []
    for group in ("clean", "clean tables", "background"):
        for x in figures.answered(everything.get(group, ())):
            if not figures.is_adequate(x):
                out.append(f"{group} {x['case']}: {_tell(x)}")
    return out


def _tell(line: dict) -> str:
    """What was said: the causes, or the component, or that there is nothing."""
    if line["causes"]:
        return ", ".join(cause["id"] for cause in line["causes"])
    return f"{line['verdict']} {line['location'] or ''}".strip()


def markdown(everything: Mapping[str, Sequence[dict]]) -> str:
    """All of them, under what they are."""
    lists = {
        "Not in the first set:": list_missed(everything),
        "Outside the catalogue, and not found there:": list_misplaced(everything),
        "Nothing hidden, and something said:": list_alarms(everything),
    }
    parts = [
        f"{title}\n\n" + "\n".join(f"- {x}" for x in some) for title, some in lists.items() if some
    ]
    return "\n\n".join(parts)
