"""Of many rigs' diagnoses: the effects that they share, with their size, and the rigs that differ.

Answers are those that `fleet_rig` keeps, one a rig; a rig whose misfit is unexplained says nothing
of any effect.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from difffric.diagnosis.verdict import UNEXPLAINED
from difffric.fleet.meta_analysis import (
    Pooled,
    holm,
    odd_ones,
    of_probability,
    pooled,
    sharing,
    summed,
)
from difffric.rig.catalogue import CATALOGUE, KEYS, RATIO, numbers_of

SIGNIFICANT = 1e-3
"""A shared effect is found in summed evidence where chance gives as much with less than this."""
ODD = 0.01
"""The same of a rig that differs."""
ALIKE = 2 * np.log(20.0)
"""Drops of -2 log likelihood within this of each other do not tell two effects apart."""
CAUSES, SUM = "causes", "sum"
SIZE, ABSENT, OWN = "size", "absent", "own"
NAMED, POSSIBLE, NEGLIGIBLE, NOT_VISIBLE = "named", "possible", "negligible", "not_visible"
KNOWN = "known"
BLIND = 1.0
"""Standard deviations at its typical size below which a rig's score test of an effect says
nothing."""
_TURNS = "phase_rad"
"""Where a wave starts: nothing that two rigs could share."""


@dataclass(frozen=True)
class Row:
    """One effect over the rigs."""

    effect: str
    marks: dict[str, str]
    """rig -> named, possible (confusable with what is named), negligible, not_visible, or known:
    its set-up has it already"""
    p_values: dict[str, float]
    """rig -> of its own evidence, other effects not counted"""
    chi2: float
    """summed over the rigs that can tell it"""
    freedom: int
    p_value: float
    """that no rig has it, corrected for the number of effects"""
    p_value_two: float
    """that fewer than two have it, likewise"""
    at_least: int
    """rigs that have it, each such claim below `SIGNIFICANT`"""


@dataclass(frozen=True)
class Shared:
    """An effect that two rigs have at least."""

    effect: str
    alike: tuple[str, ...]
    """effects that would do as well in all of these rigs"""
    by: str
    """`causes`: it is named in a rig; `sum`: only all rigs' evidence together shows it"""
    rigs: tuple[str, ...]
    """that have it, those of another size not among them; of a `sum` those that could show it"""
    sizes: dict[str, dict[str, tuple[float, float]]]
    """key -> rig -> (value, standard error) [SI]"""
    parameters: dict[str, Pooled]
    """key -> pooled over `rigs`"""
    odd: dict[str, dict[str, float]]
    """rig of another size -> key -> p-value, corrected"""
    without: tuple[str, ...]
    """rigs in which nothing says that they have it"""
    row: Row
    common: bool = True
    """whether more than half of the rigs that could show it have it"""

    @property
    def range(self) -> tuple[tuple[str, tuple[float, ...]], ...]:
        """Sizes (key -> three) within two standard deviations of the mean of what rigs have."""
        out = []
        for key, one in self.parameters.items():
            away = 2 * float(np.hypot(one.standard_error, one.between))
            # To a hundredth of it: further digits change with whatever is rounded otherwise.
            digits = 2 - int(np.floor(np.log10(away)))
            sizes = (one.value - away, one.value, one.value + away)
            out.append((key, tuple(round(x, digits) for x in sizes)))
        return tuple(out)


@dataclass(frozen=True)
class Combined:
    """What many rigs' diagnoses say together."""

    rows: tuple[Row, ...]
    """of each effect that was looked for, those that most rigs name first"""
    shared: tuple[Shared, ...]
    own: tuple[tuple[str, str], ...] = ()
    """(rig, effect) of causes that no other rig has"""
    unexplained: tuple[str, ...] = ()
    diagnosed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Different:
    """A rig that differs from the others."""

    rig: str
    effect: str | None
    how: str
    """`size`: of a shared effect; `absent`: it does not have one, and would have shown it; `own`:
    it alone has the effect; `unexplained`: nothing of the catalogue explains it"""
    p_value: float | None = None
    """corrected for the number of rigs"""


@dataclass
class _Group:
    effect: str
    alike: tuple[str, ...]
    rigs: list[str] = field(default_factory=list)


def combined(answers: Iterable[Mapping]) -> Combined:
    """All rigs' answers together."""
    every = {a["rig"]: a for a in answers}
    good = {rig: a for rig, a in every.items() if a["diagnosis"]["verdict"] != UNEXPLAINED}
    rows = {row.effect: row for row in _rows(good)}
    groups, own = _groups(good)
    shared = [_of_causes(good, group, rows[group.effect]) for group in groups]
    taken = {e for one in shared for e in (one.effect, *one.alike)}
    weak = _of_sum(good, [row for e, row in rows.items() if e not in taken])
    if weak is not None:
        shared.append(weak)
        own = [(rig, e) for rig, e in own if e != weak.effect]
    ordered = sorted(rows.values(), key=_leading)
    return Combined(
        tuple(ordered), tuple(shared), tuple(own),
        tuple(rig for rig in every if rig not in good), tuple(every),
    )  # fmt: skip


def differing(found: Combined, excess: Mapping[tuple[str, str], float]) -> tuple[Different, ...]:
    """The rigs that differ. `excess`: of an effect and a rig without it, by how much -2 log
    likelihood grows at least where the rig has it as the others do. One rig alone differs in
    nothing."""
    if len(found.diagnosed) < 2:
        return ()
    out = []
    for one in found.shared:
        out += [Different(rig, one.effect, SIZE, min(p.values())) for rig, p in one.odd.items()]
        asked = [rig for rig in one.without if (one.effect, rig) in excess]
        away = [max(excess[one.effect, rig], 0.0) for rig in asked]
        p = holm(scipy.stats.chi2.sf(away, len(numbers_of(one.effect))))
        out += [
            Different(rig, one.effect, ABSENT, float(x))
            for rig, x in zip(asked, p, strict=True)
            if x < ODD and one.common
        ]
    out += [Different(rig, effect, OWN) for rig, effect in found.own]
    return (*out, *(Different(rig, None, UNEXPLAINED) for rig in found.unexplained))


def _leading(row: Row) -> tuple:
    """Before whom an effect comes: named in most rigs, possible in most, by the evidence."""
    marks = list(row.marks.values())
    evidence = row.chi2 / max(row.freedom, 1)
    return -marks.count(NAMED), -marks.count(POSSIBLE), row.p_value, not row.freedom, -evidence


def _rows(answers: Mapping[str, Mapping]) -> list[Row]:
    """Every effect that some rig was looked for."""
    looked_for = dict.fromkeys(e for a in answers.values() for e in a["evidence"])
    return [_row(answers, e, len(looked_for)) for e in (*CATALOGUE, RATIO) if e in looked_for]


def _row(answers: Mapping[str, Mapping], effect: str, candidates: int) -> Row:
    marks, p_values, drops, numbers = {}, {}, [], []
    for rig, answer in answers.items():
        mark = KNOWN if effect in answer["known"] else _mark(answer["diagnosis"], effect)
        if mark:
            marks[rig] = mark
        one = answer["evidence"].get(effect)
        if one is None:
            continue
        p_values[rig] = one["p_value"]
        # Beside a cause that it looks like, and where it leaves no trace, a rig cannot tell it.
        if mark != POSSIBLE and one.get("visible", BLIND) >= BLIND:
            drops.append(of_probability(one["p_value"], one["numbers"]))
            numbers.append(one["numbers"])
    p = [min(1.0, candidates * summed(drops, numbers, u)) if drops else 1.0 for u in (1, 2)]
    level = SIGNIFICANT / candidates
    return Row(
        effect, marks, p_values, float(sum(drops)), int(sum(numbers)), p[0], p[1],
        sharing(drops, numbers, level),
    )  # fmt: skip


def _mark(diagnosis: Mapping, effect: str) -> str | None:
    causes = diagnosis["causes"]
    if any(c["id"] == effect for c in causes):
        return NAMED
    if any(effect in c["confusable_with"] for c in causes):
        return POSSIBLE
    if any(c["id"] == effect for c in diagnosis["negligible"]):
        return NEGLIGIBLE
    return NOT_VISIBLE if effect in diagnosis["not_visible"] else None


def _groups(answers: Mapping[str, Mapping]) -> tuple[list[_Group], list[tuple[str, str]]]:
    """(effects that explain the causes of two rigs or more, the causes that are left)."""
    left = [(rig, c) for rig, a in answers.items() for c in a["diagnosis"]["causes"]]
    groups = []
    while True:
        found: dict[str, list] = {}
        for rig, cause in left:
            for e in (cause["id"], *cause["confusable_with"]):
                found.setdefault(e, []).append((rig, cause))
        # Most rigs, then most that name it, then the most that it explains.
        ranked = sorted(
            found,
            key=lambda e: (
                -len({rig for rig, _ in found[e]}),
                -sum(c["id"] == e for _, c in found[e]),
                -sum(c["chi2_drop"] for _, c in found[e]),
                e,
            ),
        )
        if not ranked or len({rig for rig, _ in found[ranked[0]]}) < 2:
            return groups, [(rig, c["id"]) for rig, c in left]
        best = ranked[0]
        sets = [{c["id"], *c["confusable_with"]} for _, c in found[best]]
        alike = sorted(set.intersection(*sets) - {best})
        rigs = list(dict.fromkeys(rig for rig, _ in found[best]))
        groups.append(_Group(best, tuple(alike), rigs))
        mine = [id(c) for _, c in found[best]]
        left = [(rig, c) for rig, c in left if id(c) not in mine]


def _of_causes(answers: Mapping[str, Mapping], group: _Group, row: Row) -> Shared:
    sizes: dict[str, dict[str, tuple[float, float]]] = {}
    for rig in group.rigs:
        for cause in answers[rig]["diagnosis"]["causes"]:
            if cause["id"] != group.effect:
                continue
            for key, x in cause["parameters"].items():
                if key != _TURNS and x["value"] is not None and x["standard_error"]:
                    sizes.setdefault(key, {})[rig] = x["value"], x["standard_error"]
    without = [rig for rig in answers if rig not in group.rigs and row.marks.get(rig) != KNOWN]
    able = [rig for rig in without if row.marks.get(rig) != NOT_VISIBLE]
    able = [rig for rig in able if group.effect in answers[rig]["evidence"]]
    common = len(group.rigs) > len(able)
    return _shared(group.effect, group.alike, CAUSES, group.rigs, sizes, without, row, common)


def _of_sum(answers: Mapping[str, Mapping], rows: Sequence[Row]) -> Shared | None:
    """The effect that the evidence of all rigs shows together, where two rigs have it at least.
    Each effect was tested alone, and one that is there speaks for others too: the first is told."""
    found = [row for row in rows if row.at_least >= 2]
    if not found:
        return None
    best = max(found, key=lambda row: row.chi2 - row.freedom)
    alike = [row.effect for row in found if row is not best and best.chi2 - row.chi2 < ALIKE]
    sizes: dict[str, tuple[float, float]] = {}
    for rig, answer in answers.items():
        one = answer["evidence"].get(best.effect, {})
        if best.marks.get(rig) != POSSIBLE and one.get("visible", 0.0) >= BLIND:
            sizes[rig] = one["at"], 1.0 / one["visible"]
    able = [rig for rig in answers if best.effect in answers[rig]["evidence"]]
    rigs = [rig for rig in able if best.marks.get(rig) not in (POSSIBLE, NOT_VISIBLE)]
    return _shared(
        best.effect, alike, SUM, rigs, {"": sizes} if sizes else {}, [], best, True, written=True
    )


def _shared(effect, alike, by, rigs, sizes, without, row, common, written=False) -> Shared:
    """With the rigs of another size taken out, and what is left pooled. `written`: the sizes are
    coordinates, and are written as files have them once that is done."""
    odd: dict[str, dict[str, float]] = {}
    for key, of in sizes.items():
        x, s = (np.array([one[k] for one in of.values()]) for k in (0, 1))
        for i, p in odd_ones(x, s, ODD / len(sizes)).items():
            odd.setdefault(list(of)[i], {})[key] = min(1.0, p * len(sizes))
    parameters = {}
    for key, of in sizes.items():
        kept = [one for rig, one in of.items() if rig not in odd]
        if kept:
            parameters[key] = pooled([x for x, _ in kept], [s for _, s in kept])
    if written and sizes:
        name, turn = _as_written(effect)
        sizes = {name: {rig: turn(*one) for rig, one in sizes[""].items()}}
        odd = {rig: {name: of[""]} for rig, of in odd.items()}
        parameters = {name: _turned(parameters[""], turn)}
    kept = tuple(rig for rig in rigs if rig not in odd)
    return Shared(
        effect, tuple(alike), by, kept, sizes, parameters, odd, tuple(without), row, common
    )


def _turned(one: Pooled, turn) -> Pooled:
    value, error = turn(one.value, one.standard_error)
    between = turn(one.value, one.between)[1]
    return Pooled(value, error, one.q, one.p_value, between, one.n)


def _as_written(effect: str):
    """(the key of an effect with one number, (coordinate, its error) -> as files write it)."""
    if effect == RATIO:  # the logarithm
        return "ratio", lambda x, s: (float(np.exp(x)), float(np.exp(x) * s))
    (name,) = [n for n, (e, key) in KEYS.items() if e.id == effect and not key.fixed]
    key = KEYS[name][1]
    null = float(np.clip(key.to_law(key.null), -1e6, 1e6))
    unit = abs(key.to_law(key.typical) - null) or 1.0

    def turn(x, s):
        number = float(null + unit * x)
        if not key.inverse:
            return number, float(unit * s)
        number = max(number, 1e-9)
        return 1.0 / number, float(unit * s / number**2)

    return key.name, turn
