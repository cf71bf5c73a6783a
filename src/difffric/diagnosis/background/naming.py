"""Which causes are named, beside a background of small effects, and what they are confused with."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.cause_sets import (
    CauseSet,
    compute_price,
    replace_item,
    weigh_set,
)
from difffric.diagnosis.background.evidence import Evidence, PossibleCause
from difffric.diagnosis.background.joint_fit import measure_left
from difffric.diagnosis.background.placement import predict_start, put_shape, put_small
from difffric.diagnosis.background.search import BackgroundSearch
from difffric.diagnosis.background.small_effects import UNIT_CHANGE
from difffric.diagnosis.conclusion import ALIKE
from difffric.diagnosis.cross_validation import CrossValidation
from difffric.diagnosis.data import DiagnosisData
from difffric.diagnosis.exploration import CandidateCause
from difffric.diagnosis.score_test import compute_p_value, count_looks
from difffric.estimation.ensembles import ensemble, ensemble_refits
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import numbers_of

USUAL_SHARE = 0.4
"""Share of their units by which the small effects of a usual rig scatter: 0.2 % of F_p or d each.
What stays within that is none that matters, however well it is seen."""
UNUSUAL = 0.01
"""A cause is one of the background where any effect of it is as large with this probability: what
noise alone makes has to be much less probable, as one looks at clean rigs again and again."""
BACKGROUND = 0.05
"""Share of their units up to which small effects are none."""
_LIKE_FRICTION = "normal_force"
"""The effect that is one with mu_s where every push has the same mass."""
_HARDLY_TOLD = 5.0
"""Difference of two sets' scores from which on a linear comparison is believed."""
_DOUBTED, _DOUBTED_MOST = 20.0, 3
"""How much more of chi-square linear answers may say that another effect leaves, to be held against
a cause by a fit nevertheless where no background is; and up to how many are held so in all."""
_ROUNDS = 12
"""Steps at most of the fit with the causes alone."""
_CONSIDERED = 3
"""Single causes that are told beside those that are named, and sets that are fitted at most where
linear answers hardly tell them apart."""
_FEW_ROUNDS = 4
"""Steps at most of a fit with one of these."""
_NO_BACKGROUND = 1e-6
"""Share of their units by which other effects scatter in a fit without a background."""
_BETTER = 1.05
"""How many times as much as the joint fit the plain one leaves, where that stands at a poor place.
"""


def find_unseen(data: DiagnosisData, share: float) -> float:
    """Find by how much a small effect that is one with mu_s changes it, relatively, where small
    effects scatter by `share` of their units."""
    share = max(share, USUAL_SHARE) if share > BACKGROUND else share
    return share * UNIT_CHANGE if _LIKE_FRICTION in data.impossible else 0.0


def choose_by_fits(
    task: EnsembleTask, plain: Fits, search: BackgroundSearch, singles: Sequence[CandidateCause]
) -> BackgroundSearch:
    """Return the search with that set as its best whose fit is, where there is no background, which
    these fits have not: of those that linear answers hardly tell apart, and of the `singles`, which
    are fitted already, that explain more than linear answers say of the best."""
    if search.evidence.estimate_share(search.best.items) > BACKGROUND:
        return search
    rivals = _list_rivals(search, search.sets)
    if len(search.best.items) == 1 and search.first is not search.evidence:
        # Where one of them was freed, the others may seem to be worse than they are.
        first = replace(search, evidence=search.first, joint=search.first.at, sets=search.singles)
        first = replace(first, shaped=tuple(x.effect for x in search.first.list_placed()))
        rivals = {**_list_rivals(first, search.singles), **rivals}
    known = _list_better(search, singles, rivals)
    if len(rivals) + len(known) < 2:
        return search
    fits = [(at, fit_causes(task, plain, at, at.best.items)) for at in rivals.values()]
    fits += known
    value = [float(ensemble.criterion(task, fit)[0]) + 2 * at.best.price for at, fit in fits]
    best, fitted = fits[int(np.argmin(value))]
    return replace(best, fitted=fitted)


def _list_better(
    search: BackgroundSearch,
    singles: Sequence[CandidateCause],
    rivals: Collection[frozenset[str]],
) -> list[tuple[BackgroundSearch, Fits]]:
    """List of the `singles`, where anything stands out, those that explain more than linear answers
    say of the best set, and are no `rivals` yet: of each the search with it as its best, and its
    fit."""
    better = []
    for one in singles if search.best.items else ():
        mine = next((x for x in search.sets if x.effects == {one.effect}), None)
        more = one.penalised_drop > 2 * search.best.score
        if mine is not None and more and mine.effects not in rivals:
            others = (x for x in search.sets if x is not mine)
            better.append((replace(search, sets=(mine, *others)), one.fits))
    return better


def _list_rivals(
    search: BackgroundSearch, sets: Sequence[CauseSet]
) -> dict[frozenset[str], BackgroundSearch]:
    """List those of the `sets`, the best first, that linear answers hardly tell from the best: of
    each the search with it as its best."""
    rivals: dict[frozenset[str], BackgroundSearch] = {}
    for one in sets:
        if one.score > sets[0].score - _HARDLY_TOLD and len(rivals) < _CONSIDERED:
            others = (other for other in search.sets if other is not one)
            rivals.setdefault(one.effects, replace(search, sets=(one, *others)))
    return rivals


def choose_significant(
    task: EnsembleTask, search: BackgroundSearch, significant: float
) -> tuple[tuple[PossibleCause, ...], list[float]]:
    """Return what `keep_significant` does of the search's best set. A cause by itself is judged by
    its fit too, where that is known: with it a push may arrive whose mu_s linear answers miss."""
    kept, p_values = keep_significant(search.evidence, search.best, significant)
    if kept or search.fitted is None or len(search.best.items) != 1:
        return kept, p_values
    (item,) = search.best.items
    value = ensemble.criterion(task, ensemble.join(search.plain, search.fitted))
    p_value = compute_p_value(item.effect, float(value[0] - value[1]), search.evidence.effects)
    return ((item,), [p_value]) if p_value < significant else ((), [])


def keep_significant(
    evidence: Evidence, best: CauseSet, significant: float
) -> tuple[tuple[PossibleCause, ...], list[float]]:
    """Return those causes of a set that noise hardly makes so large, nor the background, and the
    probabilities that they do; the least sure one is left out first."""
    items = list(best.items)
    while items:
        by_noise = [
            x + np.log(count_looks(item.effect, evidence.effects))
            for x, item in zip(evidence.compute_log_p_values(items), items, strict=True)
        ]
        by_background = compute_log_background_p_values(evidence, items, 0.0)
        unsure = [
            max(a - np.log(significant), b - np.log(UNUSUAL))
            for a, b in zip(by_noise, by_background, strict=True)
        ]
        worst = int(np.argmax(unsure))
        if unsure[worst] < 0:
            both = map(max, by_noise, by_background)
            return tuple(items), [float(np.exp(min(x, 0.0))) for x in both]
        items.pop(worst)
    return (), []


def choose_foreseen(
    validation: CrossValidation,
    search: BackgroundSearch,
    items: Sequence[PossibleCause],
    significant: float,
) -> tuple[BackgroundSearch, dict[PossibleCause, float]]:
    """Return, of the causes that together lead held-out pushes astray, those without which these
    are foreseen better than without any: the search with them as its best set, and their p-values.

    One after the other is left out, that one in whose absence they are foreseen best.
    """
    most = validation.measure_surprise(search.plain)
    while len(items) > 1:
        tried: list[tuple[float, BackgroundSearch, list[float]]] = []
        for gone in items:
            rest = weigh_set(search.evidence, [item for item in items if item is not gone])
            kept, p_values = keep_significant(search.evidence, rest, significant)
            if kept and all(kept != at.best.items for _, at, _ in tried):
                at = replace(search, sets=(weigh_set(search.evidence, kept), *search.sets))
                at = replace(at, fitted=None)
                fits = fit_causes(validation.task, search.plain, at, kept)
                found = validation.measure_surprise(fits)
                tried.append((found, replace(at, fitted=fits), p_values))
        if not tried:
            break
        found, at, p_values = min(tried, key=lambda one: one[0])
        items = at.best.items
        if found < most:
            return at, dict(zip(items, p_values, strict=True))
    none = tuple(one for one in search.sets if not one.items)
    return replace(search, sets=none, fitted=None), {}


def list_outstanding(evidence: Evidence, items: Sequence[PossibleCause]) -> frozenset[str]:
    """List those of the causes that are larger than a usual background would make them, too."""
    log = compute_log_background_p_values(evidence, items, USUAL_SHARE)
    return frozenset(item.effect for item, x in zip(items, log, strict=True) if x < np.log(UNUSUAL))


def compute_log_background_p_values(
    evidence: Evidence, items: Sequence[PossibleCause], least_share: float
) -> list[float]:
    """Return the logarithm of the probability, for each cause, that any effect of a background is
    so large, which scatters by the `least_share` of its units at least. An effect has one shape in
    it, wherever that was looked for."""
    if not items:
        return []
    log = evidence.compute_log_p_values(items, least_share)
    return [x + float(np.log(evidence.effects)) for x in log]


def compare_rivals(
    task: EnsembleTask,
    base: Fits,
    search: BackgroundSearch,
    items: Sequence[PossibleCause],
    cause: CandidateCause,
    by_fits: bool,
) -> tuple[CandidateCause, ...]:
    """Return the cause, which is one of the `items` of the fit `base`, and all effects that could
    be in its place, the most probable first; those that may be confused with it are fitted there.

    How much worse they are is predicted from linear answers, and taken from these fits where
    `by_fits`: they have no background in them.
    """
    task_index, evidence = task.model.coordinates.indices, search.evidence
    mine = next(item for item in items if item.effect == cause.effect)
    most, paid = weigh_set(evidence, items).score, compute_price(evidence, items)
    rivals, starts, fitted = [], [], []
    gone = task_index(numbers_of(cause.effect))
    for one in replace_item(evidence, items, mine):
        worse = 2 * (most - one.score)
        effect = one.items[-1].effect
        rivals.append(
            replace(
                cause, effect=effect, penalised_drop=cause.penalised_drop - worse, predicted=0.0
            )
        )
        if worse < ALIKE or (by_fits and worse < _DOUBTED and len(fitted) < _DOUBTED_MOST):
            c = base.c.copy()
            c[0, gone] = search.small.null[gone]
            _put(c, task, search, one.items[-1], one.sizes[-len(one.items[-1].columns) :])
            own = task_index(numbers_of(effect))
            extra = (*(i for i in base.extra[0] if i not in gone), *own)
            bare = {"extra": (extra,), "gram": None, "residual": None, "damping": None}
            starts.append(replace(base, c=c, **bare))
            # It may fit with plain parameters and mu_s that are far from those of the cause.
            linear = predict_start(evidence, one.items, _NO_BACKGROUND)
            rest = [i for i in range(c.shape[1]) if i not in (*task.shared, *extra)]
            c = linear.c.copy()
            c[0, rest] = search.small.null[rest]
            starts.append(replace(base, c=c, mu=linear.mu, own=linear.own, **bare))
            fitted.append((len(rivals) - 1, 2 * (one.price - paid)))
    if starts:
        rounds = _ROUNDS if by_fits else _FEW_ROUNDS
        least = float(ensemble.profile_cost(task, base)[0])
        fits = ensemble_refits.refit(task, ensemble.join(*starts), rounds, rival=least)
        worse = ensemble.criterion(task, fits) - ensemble.criterion(task, base)[0]
        for j, (k, dearer) in enumerate(fitted):
            better = 2 * j + int(np.argmin(worse[2 * j : 2 * j + 2]))
            rivals[k] = replace(rivals[k], fits=fits.pick([better]))
            if by_fits:
                found = cause.penalised_drop - float(worse[better]) - dearer
                rivals[k] = replace(rivals[k], penalised_drop=found)
    return (cause, *sorted(rivals, key=lambda one: -one.penalised_drop))


def _put(
    c: NDArray,
    task: EnsembleTask,
    search: BackgroundSearch,
    item: PossibleCause,
    sizes: Sequence[float],
) -> None:
    """Put an effect of these sizes into coordinates c (1, K)."""
    index = task.model.coordinates.indices(numbers_of(item.effect))
    if item.shape is None:
        put_small(c, task, search.small, item, sizes[0])
    elif item.shape.placed:
        c[0, index] = search.joint.c[0, index]
    else:
        put_shape(c, item, sizes)


def fit_causes(
    task: EnsembleTask, plain: Fits, search: BackgroundSearch, items: Sequence[PossibleCause]
) -> Fits:
    """Return the best fit with these causes and no background, begun from the joint fit, and from
    the plain one with the causes as that has them and as the comparison does (all ensembles of
    one)."""
    best = search.best.items
    if search.fitted is not None and len(items) == len(best):  # none was left out since
        return search.fitted
    if not items and measure_left(task, plain) < _BETTER * measure_left(task, search.joint):
        return plain
    index = task.model.coordinates.indices([n for x in items for n in numbers_of(x.effect)])
    at = search.joint.c.copy()
    gone = [i for i in search.joint.extra[0] if i not in (*index, *plain.extra[0])]
    at[0, gone] = plain.c[0, gone]
    extra = ((*plain.extra[0], *(i for i in index if i not in plain.extra[0])),)
    there = plain.c.copy()
    there[0, index] = at[0, index]
    linear, columns = plain.c.copy(), [c for item in items for c in item.columns]
    sizes = search.evidence.compare([columns]).best_size(0).tolist() if items else []
    for item in items:
        _put(linear, task, search, item, sizes[: len(item.columns)])
        sizes = sizes[len(item.columns) :]
    bare = {"extra": extra, "gram": None, "residual": None, "damping": None}
    starts = [replace(search.joint, c=at, **bare)]
    starts += [replace(plain, c=c, **bare) for c in (there, linear)]
    fits = ensemble_refits.refit_past_jumps(task, ensemble.join(*starts), _ROUNDS)
    return fits.pick(int(np.argmin(ensemble.criterion(task, fits))))


def fit_singles(task: EnsembleTask, plain: Fits, search: BackgroundSearch) -> list[CandidateCause]:
    """Return the causes that lead by themselves, each fitted on top of the plain fit alone."""
    found = []
    for one in search.singles:
        item = one.items[0]
        if len(found) < _CONSIDERED and all(item.effect != x[0].effect for x in found):
            found.append((item, one))
    if not found:
        return []
    starts = []
    for item, one in found:
        index = task.model.coordinates.indices(numbers_of(item.effect))
        c = plain.c.copy()
        _put(c, task, search, item, one.sizes)
        extra = (*plain.extra[0], *(i for i in index if i not in plain.extra[0]))
        starts.append(replace(plain, c=c, extra=(extra,), gram=None, residual=None, damping=None))
    fits = ensemble_refits.refit(task, ensemble.join(*starts), _FEW_ROUNDS)
    drops = float(ensemble.criterion(task, plain)[0]) - ensemble.criterion(task, fits)
    astray = np.flatnonzero(drops < 0)
    if len(astray):  # linear sizes were no guide: from none of it
        null = replace(ensemble.join(*starts), c=np.repeat(plain.c, len(starts), axis=0))
        again = ensemble_refits.refit(task, null.pick(astray), _FEW_ROUNDS)
        fits = ensemble_refits.replace_fits(fits, astray, again)
        drops = float(ensemble.criterion(task, plain)[0]) - ensemble.criterion(task, fits)
    out = []
    for j, (item, one) in enumerate(found):
        price = 2 * compute_price(search.first, [item])
        (log,) = search.first.compute_log_p_values([item], 0.0)
        p_value = float(
            np.exp(min(log + np.log(count_looks(item.effect, search.first.effects)), 0.0))
        )
        out.append(
            CandidateCause(
                item.effect,
                fits.pick([j]),
                float(drops[j]),
                2 * (one.score + one.price),
                p_value,
                float(drops[j]) - price,
            )
        )
    return sorted(out, key=lambda x: -x.penalised_drop)
