"""All sizes of all effects, looked through with a table's pushes, of which each is followed in
little time.

At a size far from nothing a push's own mu_s stands far from what is best for it, and what is linear
there promises what no step keeps. So the own mu_s are followed first, then the rest of the model is
refitted beside each size as it is, and only then is the size free.
"""

from __future__ import annotations

from dataclasses import replace

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
from difffric.estimation.ensembles import ensemble, ensemble_refits, friction_scan
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.ensembles.own_friction import settle_by_push

_BENT = 0.02
"""The scatter of mu_s from which the pushes' own may hide a strong effect."""
_TIGHT = 0.04
"""The scatter that they are allowed at most where they start from equal ones once more: with more
each goes where it likes, and none asks anything of the effect."""
_PROMISING, _AS_THEY_ARE = 4, 2
"""Sizes of each effect that are followed: by what one step promises, and as they stand."""
_HELD = 4
"""Steps of the rest of the model beside a size that is held."""
_BOTH = 2
"""Sizes of each effect that are then free."""
_PURSUED, _RESCANNED = 20, 14
"""Fits that are followed further, and those of which the pushes' own mu_s are looked for afresh."""
_LEADERS, _SCORED = 10, 3
"""Effects that lead in the end, and those by the score test that are begun from where it leads
too, whatever the scan says of them."""


def scan_table(search: EffectSearch) -> tuple[Fits, list[str]]:
    """Return the best fit of each of the leading effects, from all sizes on their grids and from
    where the score tests lead, and the effects' names."""
    task, effects = search.task, search.effects
    fits, owner = _choose_sizes(search)
    search.tell(0.25)
    fits = _refit_held(task, fits, search.base.extra[0])
    fits, owner = _pick_each(fits, owner, predict_criterion(task, fits), _BOTH)
    fits = ensemble_refits.refit(task, fits, 2)
    search.tell(0.5)
    first = np.argsort(predict_criterion(task, fits))[:_PURSUED]
    first = first[np.argsort(ensemble.criterion(task, fits)[first])][:_RESCANNED]
    fits, owner = friction_scan.rescan_bad_pushes(task, fits.pick(first)), owner[first]
    fits = ensemble_refits.refit(task, fits, 2)
    best = find_best_of_each(ensemble.criterion(task, fits), owner)
    fits, owner = ensemble_refits.refit(task, fits.pick(best), 4), owner[best]
    leaders = np.argsort(ensemble.criterion(task, fits))[:_LEADERS]
    fits, owner = fits.pick(leaders), owner[leaders]
    scored = dict.fromkeys([*(effects[int(k)] for k in owner), *search.by_score[:_SCORED]])
    near, known = start_from_scores(search, list(scored))
    if near.m:
        near = settle_by_push(task, ensemble.evaluate(task, near))
        near = ensemble_refits.refit(task, ensemble.estimate_scatters(task, near), 2)
        fits = ensemble.join(fits, near)
        owner = np.append(owner, [effects.index(effect) for effect in known]).astype(int)
    first = find_best_of_each(ensemble.criterion(task, fits), owner)
    search.tell(0.65)
    return fits.pick(first), [effects[int(k)] for k in owner[first]]


def _choose_sizes(search: EffectSearch) -> tuple[Fits, NDArray]:
    """Return the most promising sizes of each effect, each push's own mu_s at what is best for it,
    and the number of each fit's effect."""
    task, base, effects = search.task, search.base, search.effects
    bases = [base]
    if task.mu_free and base.scatter[0] > _BENT:
        # Beside a strong effect the plain fit has bent each push's own: from equal ones too.
        equal = replace(base, own=np.zeros_like(base.own))
        tight = np.minimum(base.scatter, _TIGHT)
        bases += [equal, replace(equal, scatter=tight)]
    every = np.arange(task.n)
    starts = [make_starts(task, at, e, search.scales, every) for at in bases for e in effects]
    origin = np.concatenate([np.full(one.m, k) for k, one in enumerate(starts)])
    fits, owner = ensemble.evaluate(task, ensemble.join(*starts)), origin % len(effects)
    cost, promised = predict_cost(task, fits)
    by_promise = _choose_of_each(owner, promised, _PROMISING)
    keep = np.array(sorted({*by_promise, *_choose_of_each(owner, cost, _AS_THEY_ARE)}))
    return settle_by_push(task, fits.pick(keep)), owner[keep]


def _refit_held(task: EnsembleTask, fits: Fits, known: tuple[int, ...]) -> Fits:
    """Refit all but what the fits have beside `known`, the coordinates that are free without their
    effects; then the scatter, which is held so long, and the answers with all that is free."""
    D = 1 + len(task.shared) + len(known)
    keep = [*range(D), fits.gram.shape[-1] - 1]
    gram = fits.gram[..., keep, :][..., keep]
    held = replace(fits, extra=(known,) * fits.m, gram=gram, damping=None)
    held = ensemble_refits.refit(replace(task, estimate_scatter=False), held, _HELD)
    held = ensemble.estimate_scatters(task, held)
    return ensemble.evaluate(task, replace(held, extra=fits.extra, damping=None))


def _pick_each(fits: Fits, owner: NDArray, value: NDArray, n: int) -> tuple[Fits, NDArray]:
    """The n fits of each owner that have the least value, and their owners."""
    keep = np.array(sorted(_choose_of_each(owner, value, n)))
    return fits.pick(keep), owner[keep]


def _choose_of_each(owner: NDArray, value: NDArray, n: int) -> set[int]:
    """The numbers of the n least values of each owner."""
    out: set[int] = set()
    for k in np.unique(owner):
        mine = np.flatnonzero(owner == k)
        out |= set(mine[np.argsort(value[mine])[:n]].tolist())
    return out
