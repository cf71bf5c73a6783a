"""The search for the causes that stand out of a background of small effects.

All small effects are fitted at once. What is then left beyond noise is looked for among the effects
that have a shape; the most probable set of causes is freed of the background, everything is fitted
anew, and the sets are compared again there, until the same set comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from difffric.diagnosis.background.cause_sets import CauseSet, find_set, search_sets
from difffric.diagnosis.background.columns.shape_columns import PATCH, limit_waves
from difffric.diagnosis.background.evidence import Evidence, PossibleCause
from difffric.diagnosis.background.growing_horizon import (
    AT_EACH_HORIZON,
    WORTH,
    cut_at,
    fit_first_contact,
    forget_answers,
    list_joint_horizons,
    rate_fit,
    restore_scatter,
)
from difffric.diagnosis.background.joint_fit import (
    WIDE,
    fit_jointly,
    free_causes,
    leaves_noise,
    measure_left,
)
from difffric.diagnosis.background.joint_search import ARRIVED, MOST_EXCESS, JointSearch
from difffric.diagnosis.background.shape_grid import is_near
from difffric.diagnosis.background.size_scan import FROM_AFAR, place_cutting_effects
from difffric.diagnosis.background.small_effects import (
    SmallEffects,
    choose_small_effects,
    measure_units,
)
from difffric.diagnosis.data import DiagnosisData
from difffric.estimation.ensembles import ensemble, ensemble_refits
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits

_COMPARISONS = 3
"""How often the sets are compared, each time where the last one's best set led."""
_MOST_AT_A_HORIZON, _HARDLY_LESS = 6, 0.97
"""How often shapes are placed at a horizon at most, and the share of squares down to which that is
hardly any use."""
_OUT_OF_REACH = 5.0
"""Times the noise that shapes leave at a horizon from which on none are placed at later ones: what
is there has none of the shapes that are known, which left 1.03 at most."""
_PLACE = f"{PATCH}.start_m"
"""Where a patch begins."""
_MOVED = 0.3
"""Share of a size that one may meet by which a fit moves an effect far."""


@dataclass(frozen=True)
class BackgroundSearch:
    """Where the search ended."""

    data: DiagnosisData
    effects: Sequence[str]
    """that were looked for"""
    plain: Fits
    """the fit without any of them (an ensemble of one)"""
    joint: Fits
    """the fit with all small effects, and the shapes that stand out (an ensemble of one)"""
    small: SmallEffects
    evidence: Evidence
    """where it stands"""
    sets: tuple[CauseSet, ...]
    """the most probable first"""
    singles: tuple[CauseSet, ...]
    """the single causes as they were compared first, the best first"""
    first: Evidence
    """where they were compared"""
    shaped: tuple[str, ...]
    """effects with a shape that are in the joint fit"""
    fitted: Fits | None = None
    """the fit with the most probable set and no background (an ensemble of one), once known"""

    @property
    def best(self) -> CauseSet:
        """The most probable set."""
        return self.sets[0]


def search_background(
    data: DiagnosisData, plain: Fits, guess: Fits, effects: Sequence[str], background: bool
) -> BackgroundSearch:
    """Search for causes among the `effects`, on top of the plain fit `plain`; `guess` is the set-up
    as it was given (both ensembles of one). Without a `background` every effect but the causes is
    exactly at its null."""
    return search_from(begin_search(data, plain, guess, effects, background))


def begin_search(
    data: DiagnosisData, plain: Fits, guess: Fits, effects: Sequence[str], background: bool
) -> JointSearch:
    """Begin what `search_background` does: fit all small effects, but for those with a shape."""
    small = choose_small_effects(data.task, plain, effects)
    small = replace(small, reach=limit_waves(data.task, data.scales))
    joint = fit_jointly(data, small, plain)
    search = JointSearch(data, effects, background, small, plain, joint)
    if data.reduction is not None and not leaves_noise(data.task, joint):
        grown = _search_with_growing_horizon(search, replace(guess, extra=plain.extra))
        search = min(search, grown, key=_rate_joint)
    return search


def begins_at_edge(found: BackgroundSearch) -> bool:
    """Whether the joint fit has a patch that begins where the pushes do."""
    (place,) = found.data.task.model.coordinates.values(found.joint.c[0], (_PLACE,))
    return PATCH in found.shaped and place < found.data.scales.first_place


def search_beyond_edge(before: BackgroundSearch, guess: Fits) -> BackgroundSearch | None:
    """Return the search done anew with no patch where the pushes begin, if the search `before`
    ended with one and the data are explained as well; `guess` as in `search_background`.

    A patch that nearly all of a push is beyond is another mu_s, but for what sticks at the first
    touch: it takes the place of what was not found, and mu_s with it.
    """
    if not begins_at_edge(before):
        return None
    data = before.data
    model, coordinates = data.task.model, data.task.model.coordinates
    coordinates = replace(coordinates, lowest=((_PLACE, data.scales.first_place),))
    task = replace(data.task, model=replace(model, coordinates=coordinates))
    beyond = replace(data, task=task)
    found = search_background(beyond, before.plain, guess, before.effects, True)
    return found if rate_search(found) < rate_search(before) + task.price else None


def rate_search(found: BackgroundSearch) -> float:
    """-2 log likelihood where a search ended: its causes have any size, the other small effects
    hardly hold it back."""
    causes = {item.columns[0] for item in found.best.items if item.shape is None}
    free = {found.small.index[k] for k in causes}
    task = found.small.assume(found.data.task, WIDE, free)
    return float(ensemble.criterion(task, found.joint)[0])


def _rate_joint(search: JointSearch) -> float:
    """-2 log likelihood where a joint search stands, with what its large effects cost."""
    return rate_fit(search.assume_wide(), search.joint, search.large)


def _search_with_growing_horizon(search: JointSearch, guess: Fits) -> JointSearch:
    """Return the joint search begun from the set-up's own numbers, `guess` (an ensemble of one),
    with the samples up to a horizon that grows.

    Shapes are placed as soon as they matter: what a push does wrong for want of one, it does more
    and more wrong later, until no step helps.
    """
    data, small = search.data, search.small
    first, *later = list_joint_horizons(data)
    at, large = fit_first_contact(data, small, guess, first, WIDE)
    grown, left = replace(search, joint=at, large=large), 0.0
    for k, horizon in enumerate(later, 1):
        grown = replace(grown, data=replace(data, task=cut_at(data.task, horizon)))
        if k == len(later):
            grown.joint = restore_scatter(data.task, grown.joint, guess)
        _follow_horizon(grown)
        if k < len(later) and left < _OUT_OF_REACH:
            left = _arrive_roughly(grown)
    return replace(grown, data=data)


def _follow_horizon(search: JointSearch) -> None:
    """Go on with the samples that a search has now, pushes cut short where that explains much of
    them, before they are fitted or after."""
    task = search.assume_wide()
    at = ensemble.evaluate(task, forget_answers(search.joint))
    for turn in range(2):
        cutting: tuple[str, ...] = ()
        if not leaves_noise(task, at):
            rest = [effect for effect in search.effects if effect not in search.shaped]
            at, cutting = place_cutting_effects(task, at, rest, search.data.scales, FROM_AFAR)
            search.shaped = (*search.shaped, *cutting)
        if turn and not cutting:
            break
        at = ensemble_refits.refit(task, forget_answers(at), AT_EACH_HORIZON, tol=WORTH)
    search.joint = at


def _arrive_roughly(search: JointSearch) -> float:
    """Place shapes until hardly more than noise is left, or none helps much; how many times as
    much as noise that leaves."""
    c = search.plain.c.copy()
    known = list(search.data.task.shared)
    c[0, known] = search.joint.c[0, known]
    plain = replace(search.plain, c=c, mu=search.joint.mu, own=search.joint.own)
    there, task = replace(search, plain=forget_answers(plain)), search.data.task
    left = measure_left(task, search.joint)
    for _ in range(_MOST_AT_A_HORIZON):
        if left < ARRIVED:
            break
        evidence = there.weigh()
        ways = [there.place_shapes, there.place_shapes_anew, there.move_shape]
        if evidence.excess > MOST_EXCESS:
            ways.insert(0, there.add_shape)
        if not any(place(evidence) for place in ways):
            break
        before, left = left, measure_left(task, there.joint)
        if left > _HARDLY_LESS * before:
            break
    search.joint, search.shaped = there.joint, there.shaped
    return left


def search_from(search: JointSearch) -> BackgroundSearch:
    """Search for causes from where a joint search stands."""
    data, small, plain = search.data, search.small, search.plain
    evidence = search.arrive()
    drawn = search.draw_near()
    # The plain fit may be far from here, and what is small there need not be so here.
    far = not is_near(data.task, plain, search.joint)
    if far:
        search.small = measure_units(data.task, search.joint, small)
    if drawn or far:
        evidence = search.weigh()
    sets = search_sets(evidence, evidence.items)
    first = _end(search, evidence, sets, None)
    freed: frozenset[str] = frozenset()
    ended = [(freed, first)]
    for _ in range(_COMPARISONS - 1):
        if sets[0].effects == freed:
            break
        freed = sets[0].effects
        search.free(evidence, sets[0].items, sets[0].sizes)
        evidence = search.weigh()
        sets = search_sets(evidence, evidence.items)
        ended.append((freed, _end(search, evidence, sets, first)))
    # Where they go to and fro a linear comparison is no guide: what was fitted counts.
    found = ended[-1][1] if sets[0].effects == freed else _choose_fitted(ended)
    return _compare_moved(search, first, found)


def _end(
    search: JointSearch,
    evidence: Evidence,
    sets: Sequence[CauseSet],
    first: BackgroundSearch | None,
) -> BackgroundSearch:
    """The search where it stands; the single causes are those of the `first` comparison."""
    singles = tuple(one for one in sets if len(one.items) == 1) if first is None else first.singles
    return BackgroundSearch(
        search.data,
        search.effects,
        search.plain,
        search.joint,
        search.small,
        evidence,
        tuple(sets),
        singles,
        evidence if first is None else first.evidence,
        search.shaped,
    )


def _compare_moved(
    search: JointSearch, first: BackgroundSearch, found: BackgroundSearch
) -> BackgroundSearch:
    """Return the search without those causes that a fit had to move far to make them causes, where
    others, as they were, are more probable.

    A linear comparison promises of a tilt of half the friction that all else is then smaller; there
    the tilt has the surest of errors. But the data are as well explained where it was.
    """
    small, before, after = found.small, first.joint.c[0], found.joint.c[0]
    moved = {
        effect
        for k, effect in enumerate(small.effects)
        if abs(after[small.index[k]] - before[small.index[k]]) > _MOVED * small.typical[k]
    } & found.best.effects
    if not moved:
        return found
    others = [item for item in first.evidence.items if item.effect not in moved]
    sets = search_sets(first.evidence, others)
    if _rate(first.evidence, sets[0]) <= _rate(found.evidence, found.best):
        return found
    search.joint, search.shaped = first.joint, first.shaped
    search.free(first.evidence, sets[0].items, sets[0].sizes)
    evidence = search.weigh()
    fitted = find_set(evidence, sets[0].effects)
    if fitted is None or _rate(evidence, fitted) <= _rate(found.evidence, found.best):
        return found
    others = [item for item in evidence.items if item.effect not in moved]
    sets = [fitted, *search_sets(evidence, others)]
    return _end(search, evidence, sets, first)


def _rate(evidence: Evidence, one: CauseSet) -> float:
    """The log probability of a set of causes where a fit stands, but for what all fits share."""
    return evidence.log_likelihood + one.score


def _choose_fitted(ended: Sequence[tuple[frozenset[str], BackgroundSearch]]) -> BackgroundSearch:
    """Choose the search in which the set of effects that its fit had as causes is the most
    probable, and let that set be its best."""
    best, most = ended[0][1], -np.inf
    for effects, one in ended:
        found = find_set(one.evidence, effects)
        if found is not None and _rate(one.evidence, found) > most:
            most = _rate(one.evidence, found)
            best = replace(one, sets=(found, *one.sets))
    return best


def fit_beside_background(
    data: DiagnosisData, found: BackgroundSearch, items: Sequence[PossibleCause]
) -> tuple[EnsembleTask, Fits]:
    """Return the fit with the `items` at any size and the other small effects beside them, and the
    task of it."""
    search = JointSearch(data, (), True, found.small, found.joint, found.joint, found.shaped)
    kept = {item.effect for item in items}
    if kept != found.best.effects or any(x.shape and not x.shape.placed for x in items):
        columns = [c for item in items for c in item.columns]
        sizes = found.evidence.compare([columns]).best_size(0).tolist() if items else []
        search.free(found.evidence, items, sizes)
    return free_causes(data.task, found.small, found.evidence, items), search.joint
