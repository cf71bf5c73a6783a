"""The search for one more cause: which effects, on top of what is there already, explain the most.

Where the misfit is small the score tests choose; where it is large they are not to be trusted, and
sizes of every effect are looked through on a grid: with all pushes of a table, of recordings from
some pushes to all of them. The leaders are refitted together with everything else that is free.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.candidates.effect_search import (
    EffectSearch,
    find_best_of_each,
    make_starts,
    predict_cost,
    predict_criterion,
    start_from_scores,
)
from difffric.diagnosis.candidates.table_scan import scan_table
from difffric.diagnosis.data import choose_subset, move_unseen
from difffric.diagnosis.lack_of_fit import is_misfit_large
from difffric.diagnosis.score_test import SIGNIFICANT, Score, compute_p_value
from difffric.diagnosis.shape_scan import is_within_travel
from difffric.estimation.ensembles import ensemble, ensemble_refits, friction_scan
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.ensembles.own_friction import settle_by_push
from difffric.estimation.extended_model import PRESLIDING
from difffric.rig.catalogue import numbers_of
from difffric.rig.scales import Scales

_LEADERS = 5
"""Effects of the scan that are refitted to all pushes."""
_SCORED = 3
"""Effects that lead by the score test and are refitted too, whatever the scan says of them."""
_TESTED = 10
"""Effects that the score tests choose where the misfit is small."""
_TRIED = 6
"""Steps of a leader's fit where the misfit is small, before it is judged: a lag had a fifteenth of
its gain after three."""
_ROUNDS = 15
"""Steps at most of a leader's refit to all pushes; a fit that has arrived rests."""
_ALWAYS_KEPT = 3
"""Leaders that are refitted to the end, however little they explain by then."""
_HOPELESS, _UNREFINED = 10.0, 3.0
"""How many times the noise bristles may leave once their sizes have been looked for: where bristles
were hidden they left 1.02 to 1.2 times the noise, and elsewhere 40 times at least; and how many
times that before the pushes' own mu_s are looked for."""
_FAIR_SHARE = 0.3
"""Share of what the best explains from which further ones are refitted to the end, too."""
_PURSUED = 20
"""Fits of a scan that are followed beyond their first step."""
_BENT = 0.02
"""The scatter of mu_s from which the pushes' own may hide a strong effect."""
_RESCANNED = 14
"""Fits of a scan whose pushes' own mu_s are looked for afresh."""


@dataclass(frozen=True)
class CandidateCause:
    """One effect, refitted on top of what is there already."""

    effect: str
    fits: Fits
    """an ensemble of one"""
    drop: float
    """of -2 log likelihood, against the fit without it"""
    predicted: float
    """the same as the score test had it"""
    p_value: float
    """of so large a drop by chance, all effects and looks counted"""
    penalised_drop: float
    """less what its numbers would buy in any case"""


def explore(
    task: EnsembleTask,
    base: Fits,
    effects: Sequence[str],
    scales: Scales,
    scores: Mapping[str, Score],
    tell: Callable[[float], object] = lambda share: None,
    far: bool = True,
    most: float = np.inf,
) -> list[CandidateCause]:
    """Return the leading effects, each refitted on top of `base`, the best first. Those are left
    out that leave more than `most` times the noise once they have been looked for.

    `far` says that the misfit is so large that what is linear at an effect's null may be wrong.
    """
    search = EffectSearch(task, base, list(effects), scales, scores, tell, most)
    by_table = not (task.model.recordings or PRESLIDING in effects)
    scan = scan_table if by_table else _search_far
    fits, names = scan(search) if far else _search_near(search)
    before = float(ensemble.criterion(task, base)[0])
    fits, names = _keep_promising(task, fits, names, before, most)
    if not names:
        return []
    fits = _refit_to_the_end(task, fits, far)
    tell(0.95)
    value = ensemble.criterion(task, fits)
    found = []
    for j, effect in enumerate(names):
        if is_within_travel(task, fits.c[j], effect, scales):
            drop = before - float(value[j])
            price = len(numbers_of(effect)) * task.price
            predicted = scores[effect].drop if effect in scores else 0.0
            p_value = compute_p_value(effect, drop, len(effects))
            one = fits.pick([j])
            found.append(CandidateCause(effect, one, drop, predicted, p_value, drop - price))
    return sorted(found, key=lambda cause: -cause.penalised_drop)


def explore_bristles(
    task: EnsembleTask, base: Fits, scales: Scales, looked_for: int
) -> CandidateCause | None:
    """Return bristles on top of `base`, the plain fit, where they explain it and leave no large
    misfit; `looked_for` is the number of effects that are looked for.

    They have no null, and take a program of their own.
    """
    if not is_promising(task, base, PRESLIDING, scales):
        return None
    for one in explore(task, base, [PRESLIDING], scales, {}, far=True, most=_HOPELESS):
        p_value = compute_p_value(PRESLIDING, one.drop, looked_for)
        if p_value <= SIGNIFICANT and not is_misfit_large(task, one.fits):
            return replace(one, p_value=p_value)
    return None


def is_promising(task: EnsembleTask, base: Fits, effect: str, scales: Scales) -> bool:
    """Whether one step from any size on an effect's grid promises to be better than `base`, on some
    pushes."""
    some = choose_subset(task)
    fits = ensemble.evaluate(task, make_starts(task, base, effect, scales, some), some)
    _, promised = predict_cost(task, fits)
    return bool(promised.min() < ensemble.sum_squares(task, base, some)[0])


def _refit_to_the_end(task: EnsembleTask, fits: Fits, far: bool) -> Fits:
    """Refit to all pushes, and again where a push's own mu_s turns out to be on another branch."""
    at = friction_scan.rescan_bad_pushes(task, fits) if far else fits
    fits = ensemble_refits.refit(task, at, _ROUNDS)
    bad, loose = friction_scan.rescan_bad_pushes, friction_scan.rescan_loose_pushes
    costly = () if task.model.recordings else (friction_scan.rescan_costly_pushes,)
    for rescan in (*((bad, loose) if far else (loose,)), *costly):
        again = rescan(task, fits)
        fits = fits if again is fits else ensemble_refits.refit(task, again, _ROUNDS)
    return fits


def _search_near(search: EffectSearch) -> tuple[Fits, list[str]]:
    """Return the leaders' fits and names where what is linear at the null is right.

    The score tests choose, and all pushes are looked at, as each may hold what little there is.
    What a score test does not see (a dwell, where nothing sticks at the null) is looked for on a
    grid.
    """
    task = search.task
    fits, behind = start_from_scores(search, search.by_score[:_TESTED])
    parts = [fits] if fits.m else []
    every = np.arange(task.n)
    for effect in filter(search.is_blind, search.effects):
        starts = make_starts(task, search.base, effect, search.scales, every, far=False)
        parts.append(starts)
        behind = [*behind, *[effect] * starts.m]
    fits = ensemble.evaluate(task, ensemble.join(*parts))
    fits = fits if task.model.recordings else settle_by_push(task, fits)
    search.tell(0.3)
    promised = predict_criterion(task, fits)
    keep = []
    for effect in dict.fromkeys(behind):
        mine = np.array([j for j, x in enumerate(behind) if x == effect])
        keep += mine[np.argsort(promised[mine])[:2]].tolist()
    fits, behind = ensemble_refits.refit(task, fits.pick(keep), 1), [behind[j] for j in keep]
    # The leading effects, and those that a score test does not see, of which each may have several
    # fits: by the fits alone three shapes had left out a lag that explained more than any.
    promised = predict_criterion(task, fits)
    order: list[int] = np.argsort(promised).tolist()
    first = sorted(find_best_of_each(promised, behind), key=lambda j: promised[j])
    blind = [j for j in order if search.is_blind(behind[j])]
    keep = sorted({*first[:_TESTED], *blind[:_TESTED]})
    fits, behind = ensemble_refits.refit(task, fits.pick(keep), _TRIED), [behind[j] for j in keep]
    # What shows only where a push sticks is a matter of branches.
    jumps = [j for j, effect in enumerate(behind) if search.is_blind(effect)]
    if jumps:
        branch = friction_scan.rescan_loose_pushes(task, fits.pick(jumps))
        fits = ensemble_refits.replace_fits(
            fits, np.array(jumps), ensemble_refits.refit(task, branch, 3)
        )
    search.tell(0.6)
    cost = ensemble.criterion(task, fits)
    charged = cost + task.price * np.array([len(numbers_of(effect)) for effect in behind])
    best = sorted(find_best_of_each(cost, behind), key=lambda j: charged[j])[: 2 * _LEADERS]
    return fits.pick(best), [behind[j] for j in best]


def _search_far(search: EffectSearch) -> tuple[Fits, list[str]]:
    """Return the leaders' fits and names where the misfit is large: sizes on a grid, from some
    pushes to all of them."""
    task, effects = search.task, search.effects
    # A table's pushes are followed in less time: all of them, by more effects.
    quick = not task.model.recordings
    some = np.arange(task.n) if quick else choose_subset(task)
    fits, owner = _scan_grids(search, some)
    if _is_hopeless(search, fits, some, 1.0):
        return fits.pick([]), []
    most = 2 * _LEADERS if quick else _LEADERS
    leaders = list(np.argsort(ensemble.criterion(task, fits))[:most])
    fits, owner = fits.pick(leaders), owner[leaders]
    starts = _extend_to_all_pushes(search, fits, owner, some)
    behind = np.tile(owner, 2)
    # And from where the score tests lead, whatever became of those effects on the grid.
    scored = dict.fromkeys([*(effects[int(k)] for k in owner), *search.by_score[:_SCORED]])
    near, known = start_from_scores(search, list(scored))
    starts = ensemble.evaluate(task, ensemble.join(starts, near) if near.m else starts)
    behind = np.append(behind, [effects.index(effect) for effect in known]).astype(int)
    first = find_best_of_each(predict_cost(task, starts)[1], behind)
    fits, owner = ensemble_refits.refit(task, starts.pick(first), 2), behind[first]
    return fits, [effects[int(k)] for k in owner]


def _scan_grids(search: EffectSearch, some: NDArray) -> tuple[Fits, NDArray]:
    """Return the best fit of each effect to the pushes `some`, from all sizes on its grid, and the
    number of each fit's effect."""
    task, base, effects = search.task, search.base, search.effects
    # Beside a strong effect the plain fit has bent each push's own mu_s: start from equal ones too.
    bent = task.mu_free and base.scatter[0] > _BENT
    bases = [base, replace(base, own=np.zeros_like(base.own))] if bent else [base]
    starts = [make_starts(task, at, e, search.scales, some) for at in bases for e in effects]
    origin = np.concatenate([np.full(one.m, k) for k, one in enumerate(starts)])
    fits, owner = ensemble.evaluate(task, ensemble.join(*starts), some), origin % len(effects)
    search.tell(0.25)
    cost, promised = predict_cost(task, fits)
    # Of each effect the best by what one step promises, and the best as it stands.
    chosen = set()
    for k in dict.fromkeys(owner.tolist()):
        mine = np.flatnonzero(owner == k)
        chosen |= {*mine[np.argsort(promised[mine])[: len(bases)]], mine[np.argmin(cost[mine])]}
    keep = np.array(sorted(chosen))
    fits, owner = ensemble_refits.refit(task, fits.pick(keep), 1, some), owner[keep]
    keep = np.argsort(predict_cost(task, fits)[1])[:_PURSUED]
    fits, owner = ensemble_refits.refit(task, fits.pick(keep), 2, some), owner[keep]
    search.tell(0.5)
    if _is_hopeless(search, fits, some, _UNREFINED):
        return fits, owner
    first = np.argsort(ensemble.profile_cost(task, fits))[:_RESCANNED]
    fits, owner = friction_scan.rescan_bad_pushes(task, fits.pick(first), some), owner[first]
    fits = ensemble_refits.refit(task, fits, 2, some)
    best = find_best_of_each(ensemble.criterion(task, fits), owner)
    fits, owner = ensemble_refits.refit(task, fits.pick(best), 4, some), owner[best]
    search.tell(0.65)
    return fits, owner


def _is_hopeless(search: EffectSearch, fits: Fits, some: NDArray, times: float) -> bool:
    """Whether all `fits` to the pushes `some` leave so many `times` as much as they may."""
    noise = search.task.counts[some].sum()
    return bool(ensemble.profile_cost(search.task, fits).min() > times * search.most * noise)


def _keep_promising(
    task: EnsembleTask, fits: Fits, names: Sequence[str], before: float, most: float
) -> tuple[Fits, list[str]]:
    """Keep those that explain a fair share of what the best does by now or with the next step, and
    the first few, but for those that leave more than `most` times the noise.

    A contact that hardens takes another k and b: after two steps it had a fifth of its gain.
    """
    left = ensemble.profile_cost(task, fits) / task.counts.sum()
    value = ensemble.criterion(task, fits)
    gain = before - np.minimum(value, predict_criterion(task, fits))
    order: list[int] = np.argsort(-gain).tolist()
    keep = [
        j
        for k, j in enumerate(order)
        if (k < _ALWAYS_KEPT or gain[j] > _FAIR_SHARE * gain[order[0]]) and left[j] <= most
    ]
    return fits.pick(keep), [names[j] for j in keep]


def _extend_to_all_pushes(search: EffectSearch, fits: Fits, owner: NDArray, some: NDArray) -> Fits:
    """Make starts for all pushes of fits to the pushes `some`, two of each.

    First the fits as they are, the own mu_s of each push that they have not seen as far beyond
    theirs as in `base`; then `base` with nothing but the effects' numbers taken over. `owner`
    numbers each fit's effect.
    """
    task, base = search.task, search.base
    bare = replace(fits, gram=None, residual=None, damping=None)
    whole = move_unseen(task, bare, base, some)
    back = base.pick(np.zeros(fits.m, int))
    c = back.c.copy()
    for j, k in enumerate(owner):
        index = task.model.coordinates.indices(numbers_of(search.effects[int(k)]))
        c[j, index] = fits.c[j, index]
    alone = replace(back, extra=fits.extra, c=c, gram=None, residual=None, damping=None)
    return ensemble.join(whole, alone)
