"""The plain fit as a diagnosis needs it: the best there is, though a strong effect bends it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from difffric.diagnosis.exploration import Candidate
from difffric.diagnosis.lack_of_fit import far
from difffric.estimation import ensemble as en
from difffric.estimation import ensemble_refits
from difffric.estimation.ensemble import Fits, Task
from difffric.rig.catalogue import numbers_of

_ROUNDS = 20
_BETTER, _SHARE = 1.0, 0.01
"""Of -2 log likelihood, and of what the effect explains: a fit without an effect that is better by
so much is another optimum."""


def best_base(task: Task, start: Fits, guess: Fits) -> Fits:
    """The best of the fits that start from `start`; where that leaves a large misfit, also from
    there with equal mu_s, and from the set-up's own numbers (all ensembles of one)."""
    fits = ensemble_refits.refitted(task, start, _ROUNDS)
    if not far(task, fits):
        again = ensemble_refits.resettled(task, fits)
        return fits if again is fits else ensemble_refits.refitted(task, again, _ROUNDS)
    level = replace(start, own=np.zeros_like(start.own))
    every = [fits, *(ensemble_refits.refitted(task, x, _ROUNDS) for x in (level, guess))]
    best = min(every, key=lambda x: float(en.criterion(task, x)[0]))
    return _reowned(task, best)


def relieved(task: Task, base: Fits, found: Sequence[Candidate]) -> Fits | None:
    """A better fit without any of the leading effects, from where they led: what an effect of no
    size explains was the fit's own failure. None: there is none."""
    before = float(en.criterion(task, base)[0])
    for candidate in found[:2]:
        index = task.model.coordinates.indices(numbers_of(candidate.effect))
        c = candidate.fits.c.copy()
        c[0, index] = base.c[0, index]
        bare = replace(candidate.fits, c=c, extra=base.extra, gram=None, damping=None)
        bare = _reowned(task, ensemble_refits.refitted(task, bare, _ROUNDS))
        worth = max(_BETTER, _SHARE * candidate.drop)
        if float(en.criterion(task, bare)[0]) < before - worth:
            return bare
    return None


def _reowned(task: Task, fits: Fits) -> Fits:
    again = ensemble_refits.reowned(task, fits)
    if again is fits:
        return fits
    again = ensemble_refits.refitted(task, again, _ROUNDS)
    better = float(en.criterion(task, again)[0]) < float(en.criterion(task, fits)[0])
    return again if better else fits
