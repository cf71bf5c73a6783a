"""The search for one more cause: which effects, on top of what is there already, explain the most.

Where the misfit is small the score tests choose; where it is large they are not to be trusted, and
sizes of every effect are looked through on a grid, from some pushes to all of them. The leaders are
refitted together with everything else that is free.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.data import choose_subset, move_unseen
from difffric.diagnosis.lack_of_fit import is_misfit_large
from difffric.diagnosis.score_test import SIGNIFICANT, Score, compute_p_value, step_off_null
from difffric.diagnosis.shape_scan import SHAPED, is_within_travel, scan_shapes
from difffric.diagnosis.starting_values import list_starting_values
from difffric.estimation.ensembles import ensemble, ensemble_refits, friction_scan
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.extended_model import PRESLIDING
from difffric.rig.catalogue import RATIO, numbers_of
from difffric.rig.scales import Scales

_LEADERS = 5
"""Effects of the scan that are refitted to all pushes."""
_SCORED = 3
"""Effects that lead by the score test and are refitted too, whatever the scan says of them."""
_BLIND = 1.0
"""Standard deviations at its typical size below which an effect's score test sees nothing."""
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


@dataclass(frozen=True)
class _EffectSearch:
    """What the two searches are given."""

    task: EnsembleTask
    base: Fits
    """an ensemble of one: the model that the effects are added to"""
    effects: list[str]
    scales: Scales
    scores: Mapping[str, Score]
    tell: Callable[[float], object]
    """is called with the share that is done"""
    most: float = np.inf
    """times the noise that an effect may leave once it has been looked for"""

    @property
    def by_score(self) -> list[str]:
        """The effects that have a score test, the largest predicted drop first."""
        known = (effect for effect in self.effects if effect in self.scores)
        return sorted(known, key=lambda effect: -self.scores[effect].drop)

    def is_blind(self, effect: str) -> bool:
        """Whether an effect's score test is missing or sees nothing of it."""
        return effect not in self.scores or self.scores[effect].visible < _BLIND


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
    search = _EffectSearch(task, base, list(effects), scales, scores, tell, most)
    fits, names = _search_far(search) if far else _search_near(search)
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
    fits = ensemble.evaluate(task, _make_starts(task, base, effect, scales, some), some)
    _, promised = _predict_cost(task, fits)
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


def _search_near(search: _EffectSearch) -> tuple[Fits, list[str]]:
    """Return the leaders' fits and names where what is linear at the null is right.

    The score tests choose, and all pushes are looked at, as each may hold what little there is.
    What a score test does not see (a dwell, where nothing sticks at the null) is looked for on a
    grid.
    """
    task = search.task
    fits, behind = _start_from_scores(search, search.by_score[:_TESTED])
    parts = [fits] if fits.m else []
    every = np.arange(task.n)
    for effect in filter(search.is_blind, search.effects):
        starts = _make_starts(task, search.base, effect, search.scales, every, far=False)
        parts.append(starts)
        behind = [*behind, *[effect] * starts.m]
    fits = ensemble.evaluate(task, ensemble.join(*parts))
    search.tell(0.3)
    promised = _predict_criterion(task, fits)
    keep = []
    for effect in dict.fromkeys(behind):
        mine = np.array([j for j, x in enumerate(behind) if x == effect])
        keep += mine[np.argsort(promised[mine])[:2]].tolist()
    fits, behind = ensemble_refits.refit(task, fits.pick(keep), 1), [behind[j] for j in keep]
    # The leading effects, and those that a score test does not see, of which each may have several
    # fits: by the fits alone three shapes had left out a lag that explained more than any.
    promised = _predict_criterion(task, fits)
    order: list[int] = np.argsort(promised).tolist()
    first = sorted(_find_best_of_each(promised, behind), key=lambda j: promised[j])
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
    best = sorted(_find_best_of_each(cost, behind), key=lambda j: charged[j])[: 2 * _LEADERS]
    return fits.pick(best), [behind[j] for j in best]


def _search_far(search: _EffectSearch) -> tuple[Fits, list[str]]:
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
    near, known = _start_from_scores(search, list(scored))
    starts = ensemble.evaluate(task, ensemble.join(starts, near) if near.m else starts)
    behind = np.append(behind, [effects.index(effect) for effect in known]).astype(int)
    first = _find_best_of_each(_predict_cost(task, starts)[1], behind)
    fits, owner = ensemble_refits.refit(task, starts.pick(first), 2), behind[first]
    return fits, [effects[int(k)] for k in owner]


def _scan_grids(search: _EffectSearch, some: NDArray) -> tuple[Fits, NDArray]:
    """Return the best fit of each effect to the pushes `some`, from all sizes on its grid, and the
    number of each fit's effect."""
    task, base, effects = search.task, search.base, search.effects
    # Beside a strong effect the plain fit has bent each push's own mu_s: start from equal ones too.
    bent = task.mu_free and base.scatter[0] > _BENT
    bases = [base, replace(base, own=np.zeros_like(base.own))] if bent else [base]
    starts = [_make_starts(task, at, e, search.scales, some) for at in bases for e in effects]
    origin = np.concatenate([np.full(one.m, k) for k, one in enumerate(starts)])
    fits, owner = ensemble.evaluate(task, ensemble.join(*starts), some), origin % len(effects)
    search.tell(0.25)
    cost, promised = _predict_cost(task, fits)
    # Of each effect the best by what one step promises, and the best as it stands.
    chosen = set()
    for k in dict.fromkeys(owner.tolist()):
        mine = np.flatnonzero(owner == k)
        chosen |= {*mine[np.argsort(promised[mine])[: len(bases)]], mine[np.argmin(cost[mine])]}
    keep = np.array(sorted(chosen))
    fits, owner = ensemble_refits.refit(task, fits.pick(keep), 1, some), owner[keep]
    keep = np.argsort(_predict_cost(task, fits)[1])[:_PURSUED]
    fits, owner = ensemble_refits.refit(task, fits.pick(keep), 2, some), owner[keep]
    search.tell(0.5)
    if _is_hopeless(search, fits, some, _UNREFINED):
        return fits, owner
    first = np.argsort(ensemble.profile_cost(task, fits))[:_RESCANNED]
    fits, owner = friction_scan.rescan_bad_pushes(task, fits.pick(first), some), owner[first]
    fits = ensemble_refits.refit(task, fits, 2, some)
    best = _find_best_of_each(ensemble.criterion(task, fits), owner)
    fits, owner = ensemble_refits.refit(task, fits.pick(best), 4, some), owner[best]
    search.tell(0.65)
    return fits, owner


def _is_hopeless(search: _EffectSearch, fits: Fits, some: NDArray, times: float) -> bool:
    """Whether all `fits` to the pushes `some` leave so many `times` as much as they may."""
    noise = search.task.counts[some].sum()
    return bool(ensemble.profile_cost(search.task, fits).min() > times * search.most * noise)


def _make_starts(
    task: EnsembleTask, base: Fits, effect: str, scales: Scales, some: NDArray, far: bool = True
) -> Fits:
    """Return starts for one effect on top of `base` (an ensemble of one), at each of the sizes that
    it may have."""
    if effect in SHAPED:
        return scan_shapes(task, base, effect, scales, some, far)
    coordinates = task.model.coordinates
    values = list_starting_values(effect, scales, closely=True)
    rows = np.array([coordinates.point(one) for one in values])
    fits = _place_effect(task, base, effect, rows)
    if effect == RATIO:  # what slides stays as it is, and mu_s with what sticks moves
        mine = coordinates.indices(numbers_of(effect))
        fits = replace(fits, mu=fits.mu - (rows - base.c[:, mine]))
    return fits


def _start_from_scores(search: _EffectSearch, effects: Iterable[str]) -> tuple[Fits, list[str]]:
    """Return starts where the score tests lead, the rest of the model where it would be beside
    each effect; and the names of their effects, which are those that explain anything."""
    task, base, scores = search.task, search.base, search.scores
    known = [effect for effect in effects if effect in scores and scores[effect].drop > 0]
    if not known:
        return base.pick(np.zeros(0, int)), known
    parts = []
    for effect in known:
        index = task.model.coordinates.indices(numbers_of(effect))
        at_null = _place_effect(task, base, effect, base.c[:, index])
        parts.append(step_off_null(task, at_null))
    fits = ensemble.evaluate(task, ensemble.join(*parts))
    return replace(ensemble_refits.take_step(task, fits, 0.0), residual=None), known


def _place_effect(task: EnsembleTask, base: Fits, effect: str, rows: NDArray) -> Fits:
    """Repeat `base` with the coordinates of an effect, which are free, at each of `rows`
    (m, numbers)."""
    index = task.model.coordinates.indices(numbers_of(effect))
    fits = base.pick(np.zeros(len(rows), int))
    c = fits.c.copy()
    c[:, index] = rows
    extra = ((*base.extra[0], *index),) * len(rows)
    return replace(fits, extra=extra, c=c, gram=None, residual=None, damping=None)


def _keep_promising(
    task: EnsembleTask, fits: Fits, names: Sequence[str], before: float, most: float
) -> tuple[Fits, list[str]]:
    """Keep those that explain a fair share of what the best does by now or with the next step, and
    the first few, but for those that leave more than `most` times the noise.

    A contact that hardens takes another k and b: after two steps it had a fifth of its gain.
    """
    left = ensemble.profile_cost(task, fits) / task.counts.sum()
    value = ensemble.criterion(task, fits)
    gain = before - np.minimum(value, _predict_criterion(task, fits))
    order: list[int] = np.argsort(-gain).tolist()
    keep = [
        j
        for k, j in enumerate(order)
        if (k < _ALWAYS_KEPT or gain[j] > _FAIR_SHARE * gain[order[0]]) and left[j] <= most
    ]
    return fits.pick(keep), [names[j] for j in keep]


def _extend_to_all_pushes(search: _EffectSearch, fits: Fits, owner: NDArray, some: NDArray) -> Fits:
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


def _predict_cost(task: EnsembleTask, fits: Fits) -> tuple[NDArray, NDArray]:
    """Return the (m,) costs as they stand, and what one step promises that they would be."""
    cost = ensemble.normal_equations(task, fits).cost
    return cost, cost - np.maximum(ensemble_refits.predict_gain(task, fits), 0.0)


def _predict_criterion(task: EnsembleTask, fits: Fits) -> NDArray:
    """Return the (m,) -2 log likelihoods that one step promises: an effect that leaves less scatter
    may leave no smaller squares."""
    z = ensemble.normal_equations(task, fits).z
    return _predict_cost(task, fits)[1] + ensemble.compute_volume(task, fits, z)


def _find_best_of_each(cost: NDArray, owner: Iterable[Hashable]) -> list[int]:
    """Return the number of the least cost of each owner, in the order in which owners come."""
    best: dict[Hashable, int] = {}
    for j, k in enumerate(owner):
        if k not in best or cost[j] < cost[best[k]]:
            best[k] = j
    return list(best.values())
