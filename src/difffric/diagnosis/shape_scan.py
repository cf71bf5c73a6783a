"""Where to start with effects that have a shape: a wavelength and a phase, or a place.

Their amplitude has an exact derivative at the null for each shape: a score test a shape, at the
cost of one evaluation, tells how much it would explain and with which amplitude and phase. A long
push tells wavelengths apart that are close together, and has many of them: the search begins with
pushes that do not reach far, and goes on with all between the best of those.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from difffric.estimation import ensemble, ensemble_refits
from difffric.estimation.ensemble import EnsembleTask, Fits
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
    the model is where it would be beside the effect, to first order.
    """
    key, phase = SHAPED[effect]
    names = [f"{effect}.amplitude", f"{effect}.{key}"]
    names += [] if phase is None else [f"{effect}.{phase}"]
    index = [task.model.coordinates.index(x) for x in names]
    way = scales.ways if effect != "pusher_ripple" else np.full(task.n, scales.travel)
    if phase is None:
        low, high = np.min(way), np.max(way)
        shapes = np.linspace(0.04, 1.0, _PLACES) * low
        shapes = np.append(shapes, np.linspace(low, high, _PLACES)[1:-1])
        drop, starts = _score_shapes(task, base, index, shapes, some, far)
        return starts.pick(_find_peaks(drop)[:_STARTS])
    near = some[np.argsort(way[some], kind="stable")]
    if task.model.recordings and len(near) > _FIRST.stop:  # of a table each push says little
        near = near[_FIRST] if far else near[_FIRST.start : 2 * _FIRST.stop]
    short, long = np.max(way[near]), np.max(way[some])
    step = 1.0 / (3.0 * short)
    last = min(1.0 / SHORTEST, 0.5 / short + MOST * step)
    turns = np.arange(0.5 / short, last + step, step)
    drop, _ = _score_shapes(task, base, index, 1.0 / turns, near, far)
    fine = 1.0 / (6.0 * long)
    spread = np.arange(-0.5 * step, 0.5 * step + 1e-9, fine)
    # A small wave's peak may lie on the side of another's.
    first = _find_peaks(drop)[:_PEAKS] if far else np.argsort(-drop)[:_BINS]
    between = (turns[first, None] + spread).ravel()
    drop, starts = _score_shapes(task, base, index, 1.0 / between[between > 0], some, far)
    return starts.pick(_find_peaks(drop)[:_STARTS])


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
    far: bool,
) -> tuple[NDArray, Fits]:
    """Run a score test for each of the shapes (m,), a wavelength or a place [m].

    `index` are the coordinates of the amplitude, the shape and, where there is one, the phase.
    Returns the predicted drops of chi-square (m,), and fits with the amplitude and phase at which
    they are predicted.
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
    found = ensemble.normal_equations(task, fits)
    known = found.H.shape[1] - len(free)
    drop = np.zeros(m)
    for j in range(m):
        H, g = found.H[j], found.g[j]
        scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
        A, r = H / np.outer(scale, scale), g / scale
        solve = np.linalg.pinv(A[:known, :known], rcond=1e-12)
        X = A[:known, known:]
        S = A[known:, known:] - X.T @ solve @ X
        left = r[known:] - X.T @ solve @ r[:known]
        step = -np.linalg.lstsq(S, left, rcond=1e-6)[0]
        drop[j] = -step @ left
        step = step / scale[known:]
        at[j, [0, *range(2, len(index))]] += step
    size = np.abs(at[:, 0]) if len(index) == 2 else np.hypot(at[:, 0], at[:, 2])
    shrink = np.minimum(1.0, _LARGEST / coordinates.unit[amplitude] / np.maximum(size, 1e-12))
    at[:, [0, *range(2, len(index))]] *= shrink[:, None]
    if far:
        c = c.copy()
        c[:, index] = at
        new = replace(fits, c=c, gram=None, residual=None)
    else:
        new = ensemble_refits.take_step(task, fits, 0.0)
    return drop, replace(new, extra=((*base.extra[0], *index),) * m, residual=None)
