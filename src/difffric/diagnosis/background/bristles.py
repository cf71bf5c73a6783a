"""Bristles beside a background of small effects, without which a search ends at a patch that begins
where a push does.

They have no null: no derivative leads to them, and their program is one of its own. So the joint
fit is begun anew with bristles of each stiffness in place of what they are taken for.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from difffric.diagnosis.background.columns.shape_columns import PATCH
from difffric.diagnosis.background.evidence import PossibleCause
from difffric.diagnosis.background.joint_fit import WIDE, follow_leaders, measure_left
from difffric.diagnosis.background.joint_search import MOST_EXCESS, JointSearch
from difffric.diagnosis.background.search import (
    BackgroundSearch,
    begins_at_edge,
    rate_search,
    search_from,
)
from difffric.diagnosis.background.shape_grid import leave_out
from difffric.diagnosis.data import DiagnosisData, choose_subset, move_unseen
from difffric.diagnosis.exploration import CandidateCause
from difffric.diagnosis.lack_of_fit import is_misfit_large
from difffric.diagnosis.score_test import compute_p_value
from difffric.diagnosis.starting_values import list_starting_values
from difffric.estimation.ensembles import ensemble, ensemble_refits, friction_scan
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.extended_model import PRESLIDING
from difffric.rig.catalogue import CUTTING, numbers_of

LIKE_BRISTLES = (PATCH, "friction_ratio", "friction_waviness")
"""Effects that bristles are taken for."""
_SCANS = 2
"""How often the pushes' own mu_s are looked for beside each stiffness: where a patch stood for
bristles mu_s was half of what it is."""
_TRIED, _FIRST_ROUNDS = 4, 4
"""Starts that are followed on some of the pushes, and the steps of these fits."""
_HOPELESS, _POOR = 30.0, 3.0
"""How many times as much as the joint fit one with bristles may leave after these steps, and with
all pushes, before shapes are placed beside it: where bristles were hidden it was 1.4 times at most.
"""
_MOST = 10.0
"""Squares per number that it may leave in any case: where bristles were hidden it was 3.4 at most.
"""


def looks_like_bristles(found: BackgroundSearch) -> bool:
    """Whether a search ended poorly, or with a patch that begins where a push does."""
    if found.evidence.excess > MOST_EXCESS:
        return True
    return begins_at_edge(found) and PATCH in found.best.effects


def may_stand_for_bristles(found: BackgroundSearch, items: Collection[PossibleCause]) -> bool:
    """Whether a search ended poorly, or with several causes or one that bristles are taken for."""
    poor = found.evidence.excess > MOST_EXCESS or len(items) > 1
    return poor or any(item.effect in LIKE_BRISTLES for item in items)


def search_beside_bristles(before: BackgroundSearch, plain: Fits) -> BackgroundSearch | None:
    """Return the search with bristles in the model from the start, where they explain the data
    better than what the search `before` ended with, and leave no large misfit; `plain` is the plain
    fit (an ensemble of one)."""
    data, small = before.data, before.small
    fitted = _fit_bristles(before, plain)
    if fitted is None:
        return None
    joint, shaped = fitted
    index = list(data.task.model.coordinates.indices(numbers_of(PRESLIDING)))
    kept = [*data.task.shared, *index]
    c = plain.c.copy()
    c[0, kept] = joint.c[0, kept]
    start = replace(joint, c=c, extra=((*plain.extra[0], *index),), gram=None, residual=None)
    start = ensemble.evaluate(data.task, replace(start, damping=None))
    search = JointSearch(data, before.effects, True, small, start, joint, shaped)
    found = search_from(search)
    more = len(found.joint.extra[0]) - len(before.joint.extra[0])
    if rate_search(before) - rate_search(found) <= data.task.price * max(more, len(index)):
        return None
    return None if is_misfit_large(data.task, found.joint) else found


def weigh_bristles(data: DiagnosisData, whole: Fits, without: Fits) -> CandidateCause:
    """Return bristles as a cause of what the fit `whole` has them for, and what they explain more
    than the joint fit `without` them (both ensembles of one)."""
    value = ensemble.criterion(data.task, ensemble.join(without, whole))
    drop = float(value[0] - value[1])
    p_value = compute_p_value(PRESLIDING, drop, len(data.looked_for))
    price = len(numbers_of(PRESLIDING)) * data.task.price
    return CandidateCause(PRESLIDING, whole, drop, 0.0, p_value, drop - price)


def _fit_bristles(before: BackgroundSearch, plain: Fits) -> tuple[Fits, tuple[str, ...]] | None:
    """Return the joint fit with bristles, and without what they are taken for, and the effects
    whose shapes are in it; None where they leave far more than the joint fit did without them."""
    data = before.data
    task, some = before.small.assume(data.task, WIDE), choose_subset(data.task)
    left = measure_left(data.task, before.joint)
    starts, shaped = _list_starts(task, before, plain)
    fits = ensemble_refits.settle_narrowly(task, starts, some)
    for _ in range(_SCANS):
        again = _recentre(friction_scan.rescan_bad_pushes(task, fits, some), some)
        fits = ensemble_refits.settle_narrowly(task, again, some)
    cost = ensemble.sum_squares(task, fits, some)
    tried = np.argsort(cost)[:_TRIED]
    fits = move_unseen(task, fits, starts, some).pick(tried)
    fits = replace(fits, gram=None, residual=None, damping=None)
    nearer = ensemble_refits.refit(task, fits, _FIRST_ROUNDS, some)
    noise = task.counts[some].sum()
    if ensemble.sum_squares(task, nearer, some).min() > _HOPELESS * left * noise:
        return None
    found, which = follow_leaders(task, move_unseen(task, nearer, fits, some))
    if measure_left(data.task, found) >= min(_POOR * left, _MOST):
        return None
    return found, shaped[tried[which]]


def _list_starts(
    task: EnsembleTask, before: BackgroundSearch, plain: Fits
) -> tuple[Fits, list[tuple[str, ...]]]:
    """List fits with bristles of each stiffness, and the effects whose shapes are in each: in the
    joint fit without what they are taken for, and where the plain fit stands, with no shape but
    those that cut pushes short and all small effects at their nulls: the others may have made up
    for what was taken for bristles."""
    data, coordinates = before.data, task.model.coordinates
    joint = leave_out(task, before.joint, {*before.shaped} & {*LIKE_BRISTLES})
    null = before.small.free(plain)
    cutting = tuple(effect for effect in before.shaped if effect in CUTTING)
    index = coordinates.indices([n for x in cutting for n in numbers_of(x)])
    c = null.c.copy()
    c[0, index] = joint.c[0, index]
    extra = (*null.extra[0], *(i for i in index if i not in null.extra[0]))
    bases = (joint, replace(null, c=c, extra=(extra,)))
    kept = tuple(effect for effect in before.shaped if effect not in LIKE_BRISTLES)
    own, starts, shaped = coordinates.indices(numbers_of(PRESLIDING)), [], []
    for base, effects in zip(bases, (kept, cutting), strict=True):
        for values in list_starting_values(PRESLIDING, data.scales):
            c = base.c.copy()
            c[0, own] = coordinates.point(values)
            extra = ((*base.extra[0], *own),)
            starts.append(replace(base, c=c, extra=extra, gram=None, residual=None, damping=None))
            shaped.append(effects)
    return ensemble.join(*starts), shaped


def _recentre(fits: Fits, some: np.ndarray) -> Fits:
    """Return the fits with the median of the own mu_s of `some` pushes in the mean mu_s: the
    next ones are looked for about that."""
    middle = np.median(fits.own[:, some], axis=1, keepdims=True)
    mu, own = fits.mu + middle, fits.own.copy()
    own[:, some] -= middle
    return replace(fits, mu=mu, own=own, gram=None, residual=None, damping=None)
