"""What effects with a shape would change, for shapes on a grid: columns beside the derivatives.

A wave has a length, a patch a place, a fall of friction a speed, a saturation a level: at their
nulls these effects have no derivative by all their numbers. For each shape of a grid the change of
the residuals is taken as it is, by the difference of two answers without derivatives.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.small_effects import UNIT_CHANGE, ask_at, measure_change
from difffric.diagnosis.starting_values import list_starting_values
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import CATALOGUE, numbers_of
from difffric.rig.scales import Scales

WAVES: dict[str, str] = {"friction_waviness": "wavelength_m", "pusher_ripple": "period_m"}
PATCH = "friction_patch"
MOVABLE = (*WAVES, PATCH)
"""Effects whose shape lies somewhere on an axis: a length, a place."""
_SIZED = ("stribeck", "force_saturation", "pusher_duration", "pusher_lag")
"""Effects whose one number has no derivative at its null, or none that steps of finite length find:
a column for each size."""
_SHORTEST = 2e-4
"""The shortest wavelength [m] that is looked for."""
_MOST_WAVES = 60
"""Wavelengths at most."""
_LEAST_TURN = 0.5
"""Turns of a wave within the longest way at least: less of one is any smooth curve."""
_PER_WAY = 2.5
"""Wavelengths that a median way tells apart, for each turn of a wave in it."""
AMPLITUDE = 2e-4
"""Amplitude of a wave whose change is taken: so small that it is linear. A ripple of ten times as
much changes pushes by up to a third more or less than in proportion."""
_OF_PATCH = 0.002
"""The same of a patch."""
_PLACES = 14
"""Places within the shortest way, and again as many beyond it."""
_BESIDE, _NEARBY = 0.7, 9
"""How far beside a shape nearer ones are looked for, in steps of the grid, and how many."""


@dataclass(frozen=True, eq=False)
class Shape:
    """One shape of one effect; q columns: a wave's sine and cosine, or one."""

    effect: str
    points: tuple[dict[int, float], ...]
    """for each column the effect's coordinates, by their numbers, at which the change is taken"""
    amplitude: float
    """the amplitude there, by which a column is divided"""
    typical: float
    """the amplitude that one may meet"""
    along: int | None = None
    """the coordinate of a patch's place"""
    near: tuple[float, float] = (0.0, 0.0)
    """between which of it no other shape of the grid is nearer, and a little beyond"""
    placed: bool = False
    """whether the effect is in the model with this shape: the point is then that without it"""

    @property
    def numbers(self) -> int:
        """How many numbers say how large it is: of a wave those of its sine and its cosine."""
        return 2 if self.effect in WAVES else 1


@dataclass(frozen=True)
class ShapeColumns:
    """Shapes, and what each changes; C columns in all."""

    shapes: tuple[Shape, ...]
    columns: tuple[tuple[int, ...], ...]
    """the numbers of each shape's columns"""
    rows: NDArray
    """(n, R, C) change of the whitened residuals of each push by amplitude 1"""
    unit: NDArray
    """(C,) amplitude of unit size, which all shapes of one effect share"""
    typical: NDArray
    """(C,) the amplitude that one may meet"""

    def pick(self, effects: Collection[str]) -> ShapeColumns:
        """Return the shapes of some effects."""
        kept = [k for k, shape in enumerate(self.shapes) if shape.effect in effects]
        which = [c for k in kept for c in self.columns[k]]
        place = {c: i for i, c in enumerate(which)}
        return ShapeColumns(
            tuple(self.shapes[k] for k in kept),
            tuple(tuple(place[c] for c in self.columns[k]) for k in kept),
            self.rows[..., which],
            self.unit[which],
            self.typical[which],
        )


def join_columns(*parts: ShapeColumns) -> ShapeColumns:
    """Return the columns of all shapes, one part's behind the other's."""
    columns, before = [], 0
    for part in parts:
        columns += [tuple(c + before for c in own) for own in part.columns]
        before += part.rows.shape[-1]
    return ShapeColumns(
        tuple(shape for part in parts for shape in part.shapes),
        tuple(columns),
        np.concatenate([part.rows for part in parts], axis=2),
        np.concatenate([part.unit for part in parts]),
        np.concatenate([part.typical for part in parts]),
    )


def list_shapes(task: EnsembleTask, effects: Sequence[str], scales: Scales) -> list[Shape]:
    """List the shapes of those of the `effects` that have any, but for waves."""
    coordinates, found = task.model.coordinates, []
    for effect in effects:
        if effect == PATCH:
            found += _list_patches(task, scales)
        elif effect in _SIZED:
            for value in list_starting_values(effect, scales):
                point = dict(
                    zip(coordinates.indices(list(value)), coordinates.point(value), strict=True)
                )
                found.append(Shape(effect, (point,), 1.0, 1.0))
    return found


def list_nearby(shapes: Sequence[Shape]) -> list[Shape]:
    """List the patches that lie near each of the `shapes` on the grid; others as they are."""
    found = []
    for one in shapes:
        if one.along is None:
            found.append(one)
            continue
        low, high = one.near
        for at in np.linspace(low, high, _NEARBY):
            points = tuple({**point, one.along: float(at)} for point in one.points)
            found.append(replace(one, points=points))
    return found


def list_placed(task: EnsembleTask, at: Fits, effects: Sequence[str]) -> list[Shape]:
    """List the shapes that those of the `effects` have that are in the fit `at` (an ensemble of
    one)."""
    coordinates, found = task.model.coordinates, []
    for effect in effects:
        index = coordinates.indices(numbers_of(effect))
        names = [coordinates.names[i] for i in index]
        sizes = [x for x, name in zip(at.c[0, index], names, strict=True) if _is_size(name)]
        without = dict.fromkeys(index, 0.0)
        # Of a speed, a level, a duration no size is typical: what it changes says how large it is.
        typical = 1.0 if effect in _SIZED else 1.0 / max(float(np.linalg.norm(sizes)), 1e-6)
        found.append(Shape(effect, (without,), 1.0, typical, placed=True))
    return found


def _is_size(name: str) -> bool:
    """Whether a number says how large an effect is, and not of what shape."""
    return name.partition(".")[2] not in ("wavelength_m", "period_m", "start_m")


def get_ways(effect: str, scales: Scales) -> NDArray:
    """The ways (n,) [m] along which a wave of this effect lies: the tip's, or those of the part."""
    return scales.tips if effect == "pusher_ripple" else scales.ways


def divide_turns(ways: NDArray) -> NDArray:
    """Divide the turns [1/m] of waves into cells, of each of which the best wave is compared: their
    ascending edges, as close as a median way tells them apart."""
    step = 1.0 / (_PER_WAY * np.median(ways))
    first = _LEAST_TURN / np.max(ways) + 0.5 * step
    middles = np.arange(first, min(1.0 / _SHORTEST, first + _MOST_WAVES * step), step)
    return np.append(first - 0.5 * step, middles + 0.5 * step)


def number_wave(task: EnsembleTask, effect: str) -> tuple[int, int, int]:
    """The coordinates of a wave's sine, its length and its cosine."""
    names = (f"{effect}.amplitude", f"{effect}.{WAVES[effect]}", f"{effect}.phase_rad")
    sine, length, cosine = task.model.coordinates.indices(names)
    return sine, length, cosine


def limit_waves(task: EnsembleTask, scales: Scales) -> tuple[tuple[int, float], ...]:
    """The coordinates of the waves' lengths, and how large they may be."""
    coordinates, found = task.model.coordinates, []
    for effect in WAVES:
        _, length, _ = number_wave(task, effect)
        longest = float(get_ways(effect, scales).max()) / _LEAST_TURN
        found.append((length, (longest - coordinates.null[length]) / coordinates.unit[length]))
    return tuple(found)


def list_waves(task: EnsembleTask, effect: str, turns: NDArray) -> list[Shape]:
    """List waves of so many turns [1/m]."""
    coordinates, (sine, length, cosine) = task.model.coordinates, number_wave(task, effect)
    size, found = AMPLITUDE / coordinates.unit[sine], []
    for at in ((1.0 / turns) - coordinates.null[length]) / coordinates.unit[length]:
        both = ({sine: size, cosine: 0.0, length: at}, {sine: 0.0, cosine: size, length: at})
        found.append(Shape(effect, both, AMPLITUDE, _find_typical(effect)))
    return found


def _list_patches(task: EnsembleTask, scales: Scales) -> Iterator[Shape]:
    """Yield patches that begin at places along the pushes' ways."""
    coordinates = task.model.coordinates
    amplitude, start = coordinates.indices(numbers_of(PATCH))
    low, high = np.min(scales.ways), np.max(scales.ways)
    places = np.linspace(scales.first_place, low, _PLACES)
    size, typical = _OF_PATCH / coordinates.unit[amplitude], _find_typical(PATCH)
    for place in np.append(places, np.linspace(low, high, _PLACES)[1:-1]):
        ends = place + np.array([0.0, -_BESIDE, _BESIDE]) * low / _PLACES
        at, *near = (ends - coordinates.null[start]) / coordinates.unit[start]
        yield Shape(PATCH, ({amplitude: size, start: at},), _OF_PATCH, typical, start, tuple(near))


def _find_typical(effect: str) -> float:
    """The amplitude of an effect that one may meet."""
    return next(key.typical for key in CATALOGUE[effect].keys if key.name == "amplitude")


def compute_columns(task: EnsembleTask, at: Fits, shapes: Sequence[Shape]) -> ShapeColumns:
    """Compute what each of the shapes changes where the fit `at` (an ensemble of one) stands;
    shapes that change nothing, or cannot be followed, are left out."""
    points = np.repeat(at.c, 1 + sum(len(one.points) for one in shapes), axis=0)
    row = 1
    for one in shapes:
        for point in one.points:
            points[row, list(point)] = list(point.values())
            row += 1
    r, model = ask_at(task, at, points)
    moved = (r[1:] - r[0]).reshape(len(points) - 1, task.n, r[0].size // task.n)
    with np.errstate(invalid="ignore", divide="ignore"):
        change = measure_change(model[1:] / model[0] - 1)
    signs = np.array([1.0 - 2.0 * one.placed for one in shapes for _ in one.points])
    moved *= signs[:, None, None]
    good = np.isfinite(moved).all(axis=(1, 2)) & (moved != 0).any(axis=(1, 2))
    kept, which, row = [], [], 0
    for one in shapes:
        mine = list(range(row, row + len(one.points)))
        row += len(mine)
        if good[mine].all():
            which += mine
            kept.append(one)
    sizes = np.array([one.amplitude for one in kept for _ in one.points])
    rows = np.moveaxis(moved[which], 0, 2) / sizes if which else np.zeros((*moved.shape[1:], 0))
    return make_columns(kept, rows, change[which] / sizes if which else sizes)


def make_columns(shapes: Sequence[Shape], rows: NDArray, change: NDArray) -> ShapeColumns:
    """Make the columns of shapes from what amplitude 1 of each changes: `rows` (n, R, C), and of
    F_p or d `change` (C,)."""
    columns, unit, typical, first = [], [], [], 0
    for one in shapes:
        mine = range(first, first + len(one.points))
        first += len(mine)
        columns.append(tuple(mine))
        number = 1 if one.placed else sum(other.effect == one.effect for other in shapes)
        size = min(one.typical, UNIT_CHANGE / max(change[mine].max(), 1e-12))
        unit += [size / np.sqrt(number)] * len(mine)
        typical += [one.typical] * len(mine)
    return ShapeColumns(tuple(shapes), tuple(columns), rows, np.array(unit), np.array(typical))
