"""The size of an effect that cuts a push short, where the first contact is fitted already.

Such an effect changes nothing until it sets in, and much at once: no derivative leads to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from difffric.diagnosis.background.small_effects import ask_at
from difffric.diagnosis.starting_values import list_starting_values
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import CUTTING, numbers_of
from difffric.rig.scales import Scales

_SIZES, _ROUNDS = 24, 4
"""Sizes that are tried at once, and how often, each time between the best one's neighbours."""
_BEYOND = 1.02
"""Times the longest way at the slowest speed, a time that cuts no push: the first that is tried."""
_SAME = 1e-9
"""Relative difference up to which squares are the same."""
FROM_AFAR = 0.3
"""The share of the squares that the best size must explain where a fit has far to go."""


def place_cutting_effects(
    task: EnsembleTask, at: Fits, effects: Sequence[str], scales: Scales, share: float
) -> tuple[Fits, tuple[str, ...]]:
    """Return the fit `at` (an ensemble of one) with those of the `effects` free, at their best
    sizes, that explain more than a `share` of the squares by cutting pushes short; and which they
    are."""
    found: list[str] = []
    for effect in effects:
        if effect in CUTTING:
            new = _place_best_size(task, at, effect, scales, share)
            found += [effect] if new is not at else []
            at = new
    return at, tuple(found)


def _place_best_size(
    task: EnsembleTask, at: Fits, effect: str, scales: Scales, share: float
) -> Fits:
    coordinates = task.model.coordinates
    (i,) = coordinates.indices(numbers_of(effect))
    tried = [coordinates.point(value)[0] for value in list_starting_values(effect, scales)]
    uncut = {numbers_of(effect)[0]: float(_BEYOND * scales.ways.max() / scales.slowest)}
    low, high = coordinates.point(uncut)[0], max(tried)
    best, least = 0.0, np.inf
    for _ in range(_ROUNDS):
        sizes = np.geomspace(low, high, _SIZES)
        points = np.repeat(at.c, _SIZES + 1, axis=0)
        points[1:, i] = sizes
        squares = sum_squares_at(task, at, points)
        # Of sizes that cut nothing, the last: beyond it is the one that cuts a little.
        k = int(np.flatnonzero(squares[1:] <= (1 + _SAME) * squares[1:].min())[-1])
        if squares[1 + k] < least:
            least, best = squares[1 + k], sizes[k]
        low, high = float(sizes[max(k - 1, 0)]), float(sizes[min(k + 1, _SIZES - 1)])
    if not least < (1 - share) * squares[0]:
        return at
    c = at.c.copy()
    c[0, i] = best
    extra = (*at.extra[0], i)
    return replace(at, c=c, extra=(extra,), gram=None, residual=None, damping=None)


def sum_squares_at(task: EnsembleTask, at: Fits, points: np.ndarray) -> np.ndarray:
    """The squares (m,) of all residuals at each of the `points` (m, K); infinite where a push could
    not be followed."""
    r, _ = ask_at(task, at, points)
    squares = np.einsum("mnkb,mnkb->m", r, r)
    return np.where(np.isfinite(squares), squares, np.inf)
