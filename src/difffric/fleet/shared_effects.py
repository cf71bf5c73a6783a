"""The effects that the rigs of a fleet share, with their sizes, and the rigs that differ.

All of it comes from the rigs' answers, as `fleet.member` keeps them, one a rig. A rig whose misfit
is unexplained says nothing of any effect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from difffric.diagnosis.verdict import UNEXPLAINED
from difffric.fleet.meta_analysis import (
    Pooled,
    correct_by_holm,
    count_sharing,
    find_odd_ones,
    pool,
    sum_evidence,
    to_chi_square,
)
from difffric.rig.catalogue import CATALOGUE, KEYS, RATIO, numbers_of

SIGNIFICANT = 1e-3
"""Probability that chance gives as much, below which summed evidence shows a shared effect."""
ODD = 0.01
"""Probability that chance gives as much, below which a rig is said to differ."""
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
"""The key of where a wave starts: nothing that two rigs could share."""

Turn = Callable[[float, float], tuple[float, float]]
"""Converts a value and its standard error."""


@dataclass(frozen=True)
class Row:
    """What all rigs together say of one effect."""

    effect: str
    marks: dict[str, str]
    """rig -> named, possible (confusable with what is named), negligible, not_visible, or known:
    its set-up has it already"""
    p_values: dict[str, float]
    """rig -> p-value of its own evidence, not corrected for the number of effects"""
    chi2: float
    """chi-square, summed over the rigs that can tell the effect from others"""
    freedom: int
    """degrees of freedom of `chi2`"""
    p_value: float
    """of the evidence, where no rig had the effect; corrected for the number of effects"""
    p_value_two: float
    """the same where fewer than two rigs had it"""
    at_least: int
    """how many rigs have it at least, each such claim with a p-value below `SIGNIFICANT`"""


@dataclass(frozen=True)
class Shared:
    """An effect that at least two rigs have."""

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
        """(key, three sizes) each: the pooled size, and two standard deviations to either side."""
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
class _CauseGroup:
    """Rigs whose causes one effect explains."""

    effect: str
    alike: tuple[str, ...]
    rigs: list[str] = field(default_factory=list)


def combine(answers: Iterable[Mapping]) -> Combined:
    """Find what rigs share, from their answers."""
    every = {a["rig"]: a for a in answers}
    good = {rig: a for rig, a in every.items() if a["diagnosis"]["verdict"] != UNEXPLAINED}
    rows = {row.effect: row for row in _make_rows(good)}
    groups, own = _group_causes(good)
    shared = [_describe_group(good, group, rows[group.effect]) for group in groups]
    taken = {e for one in shared for e in (one.effect, *one.alike)}
    weak = _find_weak(good, [row for e, row in rows.items() if e not in taken])
    if weak is not None:
        shared.append(weak)
        own = [(rig, e) for rig, e in own if e != weak.effect]
    ordered = sorted(rows.values(), key=_sort_key)
    return Combined(
        rows=tuple(ordered),
        shared=tuple(shared),
        own=tuple(own),
        unexplained=tuple(rig for rig in every if rig not in good),
        diagnosed=tuple(every),
    )


def find_different(
    found: Combined, excess: Mapping[tuple[str, str], float]
) -> tuple[Different, ...]:
    """Find the rigs that differ from the others; one rig alone differs in nothing.

    `excess` holds, of an effect and a rig without it, by how much the rig's -2 log likelihood grows
    at least where it is given the effect as the others have it.
    """
    if len(found.diagnosed) < 2:
        return ()
    out = []
    for one in found.shared:
        out += [Different(rig, one.effect, SIZE, min(p.values())) for rig, p in one.odd.items()]
        asked = [rig for rig in one.without if (one.effect, rig) in excess]
        away = [max(excess[one.effect, rig], 0.0) for rig in asked]
        p = correct_by_holm(scipy.stats.chi2.sf(away, len(numbers_of(one.effect))))
        out += [
            Different(rig, one.effect, ABSENT, float(x))
            for rig, x in zip(asked, p, strict=True)
            if x < ODD and one.common
        ]
    out += [Different(rig, effect, OWN) for rig, effect in found.own]
    return (*out, *(Different(rig, None, UNEXPLAINED) for rig in found.unexplained))


def _sort_key(row: Row) -> tuple:
    """Sorts effects: first those named in most rigs, then possible in most, then by evidence."""
    marks = list(row.marks.values())
    evidence = row.chi2 / max(row.freedom, 1)
    return -marks.count(NAMED), -marks.count(POSSIBLE), row.p_value, not row.freedom, -evidence


def _make_rows(answers: Mapping[str, Mapping]) -> list[Row]:
    """Make the row of every effect that was looked for in some rig."""
    looked_for = dict.fromkeys(e for a in answers.values() for e in a["evidence"])
    return [_make_row(answers, e, len(looked_for)) for e in (*CATALOGUE, RATIO) if e in looked_for]


def _make_row(answers: Mapping[str, Mapping], effect: str, candidates: int) -> Row:
    """Make the row of one effect; `candidates` is how many effects were looked for."""
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
            drops.append(to_chi_square(one["p_value"], one["numbers"]))
            numbers.append(one["numbers"])
    p = [min(1.0, candidates * sum_evidence(drops, numbers, u)) if drops else 1.0 for u in (1, 2)]
    level = SIGNIFICANT / candidates
    return Row(
        effect=effect,
        marks=marks,
        p_values=p_values,
        chi2=float(sum(drops)),
        freedom=int(sum(numbers)),
        p_value=p[0],
        p_value_two=p[1],
        at_least=count_sharing(drops, numbers, level),
    )


def _mark(diagnosis: Mapping, effect: str) -> str | None:
    """Return what a rig's diagnosis says of an effect, None where it does not speak of it."""
    causes = diagnosis["causes"]
    if any(c["id"] == effect for c in causes):
        return NAMED
    if any(effect in c["confusable_with"] for c in causes):
        return POSSIBLE
    if any(c["id"] == effect for c in diagnosis["negligible"]):
        return NEGLIGIBLE
    return NOT_VISIBLE if effect in diagnosis["not_visible"] else None


def _group_causes(
    answers: Mapping[str, Mapping],
) -> tuple[list[_CauseGroup], list[tuple[str, str]]]:
    """Group causes by effects that explain those of two rigs or more, the largest group first.

    Returns the groups, and (rig, effect) of the causes that are in none.
    """
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
        groups.append(_CauseGroup(best, tuple(alike), rigs))
        mine = [id(c) for _, c in found[best]]
        left = [(rig, c) for rig, c in left if id(c) not in mine]


def _describe_group(answers: Mapping[str, Mapping], group: _CauseGroup, row: Row) -> Shared:
    """Return the effect that explains a group of causes, with the sizes in their rigs."""
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
    return _make_shared(group.effect, group.alike, CAUSES, group.rigs, sizes, without, row, common)


def _find_weak(answers: Mapping[str, Mapping], rows: Sequence[Row]) -> Shared | None:
    """Return the effect that the evidence of all rigs shows together, where at least two have it.

    Each effect was tested alone, and one that is there speaks for others too, so only the one with
    the most evidence is returned.
    """
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
    return _make_shared(
        best.effect, alike, SUM, rigs, {"": sizes} if sizes else {}, [], best, True, written=True
    )


def _make_shared(
    effect: str,
    alike: Sequence[str],
    by: str,
    rigs: Sequence[str],
    sizes: dict[str, dict[str, tuple[float, float]]],
    without: Sequence[str],
    row: Row,
    common: bool,
    written: bool = False,
) -> Shared:
    """Make a shared effect: take out the rigs of another size, and pool what is left.

    With `written` the sizes are coordinates of the diagnosis, under the key "", and are converted
    to what files hold once that is done.
    """
    odd: dict[str, dict[str, float]] = {}
    for key, of in sizes.items():
        x, s = (np.array([one[k] for one in of.values()]) for k in (0, 1))
        for i, p in find_odd_ones(x, s, ODD / len(sizes)).items():
            odd.setdefault(list(of)[i], {})[key] = min(1.0, p * len(sizes))
    parameters = {}
    for key, of in sizes.items():
        kept = [one for rig, one in of.items() if rig not in odd]
        if kept:
            parameters[key] = pool([x for x, _ in kept], [s for _, s in kept])
    if written and sizes:
        name, turn = _find_written_form(effect)
        sizes = {name: {rig: turn(*one) for rig, one in sizes[""].items()}}
        odd = {rig: {name: of[""]} for rig, of in odd.items()}
        parameters = {name: _convert(parameters[""], turn)}
    kept = tuple(rig for rig in rigs if rig not in odd)
    return Shared(
        effect, tuple(alike), by, kept, sizes, parameters, odd, tuple(without), row, common
    )


def _convert(one: Pooled, turn: Turn) -> Pooled:
    """Convert a pooled coordinate to what files hold."""
    value, error = turn(one.value, one.standard_error)
    between = turn(one.value, one.between)[1]
    return Pooled(value, error, one.q, one.p_value, between, one.n)


def _find_written_form(effect: str) -> tuple[str, Turn]:
    """Return the key of an effect with one number, and the function that converts its coordinate
    and the coordinate's error to what files hold."""
    if effect == RATIO:  # the logarithm
        return "ratio", lambda x, s: (float(np.exp(x)), float(np.exp(x) * s))
    (name,) = [n for n, (e, key) in KEYS.items() if e.id == effect and not key.fixed]
    key = KEYS[name][1]
    null = float(np.clip(key.to_law(key.null), -1e6, 1e6))
    unit = abs(key.to_law(key.typical) - null) or 1.0

    def turn(x: float, s: float) -> tuple[float, float]:
        number = float(null + unit * x)
        if not key.inverse:
            return number, float(unit * s)
        number = max(number, 1e-9)
        return 1.0 / number, float(unit * s / number**2)

    return key.name, turn
