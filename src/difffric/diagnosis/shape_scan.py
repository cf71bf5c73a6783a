"""Where to start with effects that have a shape: a wavelength and a phase, or a place.

For a given shape the amplitude has an exact derivative at its null. So each shape has a score test
of its own, which tells at the cost of one evaluation how much the effect would explain, and with
which amplitude and phase.

Two waves differ in a push by as many wavelengths as it is long: a long push tells apart wavelengths
that are close together, and so asks for a fine grid of many. The scan therefore has two passes: a
coarse one with pushes that do not reach far, and a fine one with all pushes about the best
wavelengths of the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.estimation.ensembles import ensemble, ensemble_refits
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.scales import Scales

SHAPED = {
    "friction_waviness": ("wavelength_m", "phase_rad"),
    "pusher_ripple": ("period_m", "phase_rad"),
    "friction_patch": ("start_m", None),
}
"""id -> keys of its shape and of its phase"""
SHORTEST = 2e-4
"""The shortest wavelength [m] that is looked for."""
MOST = 50
"""Shapes in the first pass."""
_AMPLITUDE = 1e-3
"""Coordinate of the sine where derivatives are taken: at the null the cosine has none."""
_LARGEST = 0.7
"""The largest amplitude that a start has, relative to what waves: a prediction beyond it is no
longer linear."""
_PEAKS = 3
"""Peaks of the first pass that the second looks about, where the misfit is large."""
_BINS = 6
"""Wavelengths of the first pass that the second looks about, where it is small."""
_STARTS = 4
"""Shapes at most from which an effect is fitted."""
_FIRST = slice(1, 4)
"""Of the pushes by how far they reach, those that begin: not the slowest, which take longest."""
_WAYS = 2.0
"""A wave is no longer than so many of the longest ways."""
_PLACES = 14
"""Places within the shortest way, and again as many beyond it."""


def scan_shapes(
    task: EnsembleTask, base: Fits, effect: str, scales: Scales, some: NDArray, far: bool
) -> Fits:
    """Return starts of a search for one effect on top of `base` (an ensemble of one): the shapes
    that would explain most.

    `some` numbers the pushes that the scan looks at. Unless the misfit is large (`far`) the rest of
    the model is where it would be beside the effect, to first order; of a table, which is followed
    in less time, there are starts of both kinds.
    """
    key, phase = SHAPED[effect]
    names = [f"{effect}.amplitude", f"{effect}.{key}"]
    names += [] if phase is None else [f"{effect}.{phase}"]
    index = task.model.coordinates.indices(names)
    if phase is None:
        drop, alone, beside = _scan_places(task, base, index, scales, some)
    else:
        way = scales.ways if effect != "pusher_ripple" else np.full(task.n, scales.travel)
        drop, alone, beside = _scan_waves(task, base, index, way, some, far)
    best = _find_peaks(drop)[:_STARTS]
    if far and not task.model.recordings:
        return ensemble.join(alone.pick(best), beside.pick(best))
    return (alone if far else beside).pick(best)


def _scan_places(
    task: EnsembleTask, base: Fits, index: Sequence[int], scales: Scales, some: NDArray
) -> tuple[NDArray, Fits, Fits]:
    """Score places [m] along the pushes' ways; see `_score_shapes`."""
    low, high = np.min(scales.ways), np.max(scales.ways)
    places = np.linspace(scales.first_place, low, _PLACES)
    places = np.append(places, np.linspace(low, high, _PLACES)[1:-1])
    return _score_shapes(task, base, index, places, some)


def _scan_waves(
    task: EnsembleTask, base: Fits, index: Sequence[int], way: NDArray, some: NDArray, far: bool
) -> tuple[NDArray, Fits, Fits]:
    """Score wavelengths [m], coarsely and then about the best of these finely; see
    `_score_shapes`."""
    near = some[np.argsort(way[some], kind="stable")]
    if task.model.recordings and len(near) > _FIRST.stop:  # of a table each push says little
        near = near[_FIRST] if far else near[_FIRST.start : 2 * _FIRST.stop]
    short, long = np.max(way[near]), np.max(way[some])
    step = 1.0 / (3.0 * short)
    last = min(1.0 / SHORTEST, 0.5 / short + MOST * step)
    turns = np.arange(0.5 / short, last + step, step)  # a metre
    drop = _score_shapes(task, base, index, 1.0 / turns, near)[0]
    fine = 1.0 / (6.0 * long)
    spread = np.arange(-0.5 * step, 0.5 * step + 1e-9, fine)
    # A small wave's peak may lie on the side of another's.
    first = _find_peaks(drop)[:_PEAKS] if far else np.argsort(-drop)[:_BINS]
    between = (turns[first, None] + spread).ravel()
    return _score_shapes(task, base, index, 1.0 / between[between > 0], some)


def is_within_travel(task: EnsembleTask, c: NDArray, effect: str, scales: Scales) -> bool:
    """Whether a wave at the coordinates c (K,) is short enough for the pushes to show a good part
    of it; a longer one stands for anything that bends. True of an effect that does not wave."""
    if effect not in SHAPED or SHAPED[effect][1] is None:
        return True
    name = f"{effect}.{SHAPED[effect][0]}"
    return task.model.coordinates.values(c, [name])[0] < _WAYS * float(np.max(scales.ways))


def _find_peaks(values: NDArray) -> NDArray:
    """Return the indices of local maxima, the largest first."""
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    top = np.flatnonzero((values >= padded[:-2]) & (values > padded[2:]))
    return top[np.argsort(-values[top])]


def _score_shapes(
    task: EnsembleTask,
    base: Fits,
    index: Sequence[int],
    shapes: NDArray,
    pushes: NDArray,
) -> tuple[NDArray, Fits, Fits]:
    """Run a score test for each of the shapes (m,), a wavelength or a place [m].

    `index` are the coordinates of the amplitude, the shape and, where there is one, the phase.
    Returns the predicted drops of chi-square (m,), and fits with the amplitude and phase at which
    they are predicted: the rest of the model as it was, and where it would be beside them.
    """
    coordinates, m = task.model.coordinates, len(shapes)
    amplitude, shape = index[:2]
    free = [amplitude, *index[2:]]
    unit = coordinates.unit[shape]
    at = np.zeros((m, len(index)))
    at[:, 0] = _AMPLITUDE if len(index) > 2 else 0.0
    at[:, 1] = (shapes - coordinates.null[shape]) / unit
    c = np.repeat(base.c, m, axis=0)
    c[:, index] = at
    whole = base.pick(np.zeros(m, int))
    fits = replace(whole, extra=((*base.extra[0], *free),) * m, c=c, gram=None, residual=None)
    fits = ensemble.evaluate(task, replace(fits, damping=None), pushes)
    drop, step = _predict_step(task, fits, len(free))
    moving = [0, *range(2, len(index))]  # all but the shape
    at[:, moving] += step
    size = np.abs(at[:, 0]) if len(index) == 2 else np.hypot(at[:, 0], at[:, 2])
    shrink = np.minimum(1.0, _LARGEST / coordinates.unit[amplitude] / np.maximum(size, 1e-12))
    at[:, moving] *= shrink[:, None]
    beside = ensemble_refits.take_step(task, fits, 0.0)
    c = c.copy()
    c[:, index] = at
    alone = replace(fits, c=c, gram=None)
    extra = ((*base.extra[0], *index),) * m
    alone, beside = (replace(one, extra=extra, residual=None) for one in (alone, beside))
    return drop, alone, beside


def _predict_step(task: EnsembleTask, fits: Fits, free: int) -> tuple[NDArray, NDArray]:
    """Return the predicted drops of chi-square (m,) that the last `free` numbers of the fits make,
    and their steps (m, free), all within bounds.

    A patch may hold k_v at zero: what a negative one would explain as well is no patch.
    """
    found, now = ensemble.normal_equations(task, fits), ensemble_refits.gather_point(task, fits)
    limits = ensemble_refits.find_limits(task, fits)

    def solve(P: int) -> tuple[NDArray, NDArray]:
        H, g = found.H[:, :P, :P], found.g[:, :P]
        step = ensemble_refits.solve_within(H, g, now[:, :P], *(x[:, :P] for x in limits))
        return -np.einsum("mp,mp->m", step, 2 * g + np.einsum("mpq,mq->mp", H, step)), step

    whole, step = solve(now.shape[1])
    return np.maximum(whole - solve(now.shape[1] - free)[0], 0.0), step[:, -free:]
