"""mu_s from one measured quantity: every root in a bracket, or the reason why there is none.

Each crossing is solved by a bracketed Newton iteration on the exact derivative, in log mu_s. Where
the pusher stops at the first loss of contact both F_p and d are monotone in mu_s and one bracket is
enough; with a stroke the model is scanned for the crossings first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.compute import pytrees
from difffric.compute.event_root import HIT
from difffric.errors import InputError
from difffric.identification.crossing import Crossing, find_crossings_in_columns
from difffric.identification.push_models import QUANTITIES, PushModels, Quantity
from difffric.rig.rig import Rig
from difffric.simulation.observables import kind_of_peak
from difffric.simulation.segments import Integrator
from difffric.units import to_um

BRACKET = (1e-3, 2.0)
"""mu_s is sought here unless told otherwise: wider than any dry or oily metal."""

FLAT = 1e-12
"""A relative derivative below this determines nothing: it is rounding."""

_GRID = 96
"""Points over the bracket where a rig with a stroke is scanned first: 8 % of mu_s apart by
`BRACKET`, closer than two regimes of a push lie."""
_CHILDREN, _LEVELS = 12, 6
"""An interval that may hide crossings is divided into so many, so often: to 1e-8 of the bracket."""

_NAMES = {"peak_force": "peak force", "sliding_distance": "sliding distance"}

Root = tuple[float, float]
"""(mu_s, derivative of the quantity by mu_s [N or m])"""


@dataclass(frozen=True)
class Inversion:
    """mu_s from one measured quantity of one push."""

    value: float | None
    """mu_s; None where no mu_s in the bracket gives the measured value"""
    slope: float | None = None
    """derivative of the quantity by mu_s at the value [N or m]"""
    alternatives: tuple[float, ...] = ()
    """every mu_s in the bracket that gives the measured value, where there are several"""
    slopes: tuple[float, ...] = ()
    """the derivative at each alternative [N or m]"""
    reason: str | None = None

    def at(self, index: int) -> Inversion:
        """The same, with another of the alternatives as the value."""
        return replace(self, value=self.alternatives[index], slope=self.slopes[index])


def invert(
    rigs: Rig,
    velocity: ArrayLike,
    target: ArrayLike,
    quantity: Quantity,
    *,
    bracket: tuple[float, float] = BRACKET,
    integrator: Integrator | None = None,
) -> list[Inversion]:
    """mu_s for each of n pushes from the measured quantity [N or m].

    `velocity` [m/s] and `target` have length n; every number of the rig is one value or n, so
    that mass and stroke may differ. NaN in `target`: not measured.

    Raises `InputError` where the lengths differ.
    """
    velocity, target = np.broadcast_arrays(np.atleast_1d(velocity), np.atleast_1d(target))
    n = len(target)
    try:
        rigs = pytrees.replicate(rigs, n)
    except ValueError as error:
        raise InputError(
            f"invert: the rig's numbers must be one value or {n}, one a push"
        ) from error
    models = PushModels.of(rigs, velocity.astype(float), integrator)
    return invert_models(models, target.astype(float), quantity, bracket)


def invert_models(
    models: PushModels, target: NDArray, quantity: Quantity, bracket: tuple[float, float] = BRACKET
) -> list[Inversion]:
    """As `invert`, of n pushes' models and their measured quantity (n,) [N or m].

    Raises `InputError` for an empty bracket.
    """
    return _invert(models, target, np.full(len(target), quantity == "peak_force"), bracket)


def invert_both(
    models: PushModels,
    peak_force: NDArray,
    distance: NDArray,
    bracket: tuple[float, float] = BRACKET,
) -> tuple[list[Inversion], list[Inversion]]:
    """What F_p (n,) [N] and what d (n,) [m] of each push say of mu_s, as `invert_models` of each,
    in one go: both are looked for on the same grid of mu_s."""
    n = len(models)
    twice = models.pick(np.tile(np.arange(n), 2))
    by_force = np.repeat([True, False], n)
    found = _invert(twice, np.concatenate([peak_force, distance]), by_force, bracket)
    return found[:n], found[n:]


def _invert(
    models: PushModels, target: NDArray, by_force: NDArray, bracket: tuple[float, float]
) -> list[Inversion]:
    """What each push's F_p, where `by_force` (n,), or else its d says of mu_s."""
    if not 0 < bracket[0] < bracket[1] < np.inf:
        raise InputError(f"bracket: expected 0 < lower < upper, got {bracket}")
    measured = np.isfinite(target)
    index = np.flatnonzero(measured)
    roots = _solve_all(models.pick(index), target[index], by_force[index], bracket)
    ends: dict[int, tuple[float, float]] = {}
    rootless = np.array([i for i, own in zip(index, roots, strict=True) if not own], int)
    if len(rootless):
        least_most = _find_ends(models.pick(rootless), by_force[rootless], bracket)
        ends = dict(zip(rootless.tolist(), zip(*least_most, strict=True), strict=True))
    names: list[Quantity] = [QUANTITIES[0] if force else QUANTITIES[1] for force in by_force]
    answers = [Inversion(None, reason=f"no {_NAMES[name]} was measured") for name in names]
    for i, own in zip(index.tolist(), roots, strict=True):
        answers[i] = judge_roots(own, float(target[i]), names[i], bracket, ends.get(i))
    return answers


def _solve_all(
    models: PushModels, target: NDArray, by_force: NDArray, bracket: tuple[float, float]
) -> list[list[Root]]:
    """Every root of each push."""
    n = len(models)
    if models.rigs.pusher.stroke is None:
        ends = np.log(bracket)
        found = np.arange(n), np.full(n, ends[0]), np.full(n, ends[1]), by_force
    else:
        listed = _find_crossings(models, target, by_force, bracket) if n else []
        found = tuple(np.array(column) for column in zip(*listed, strict=True))
    roots: list[list[Root]] = [[] for _ in range(n)]
    if found and n:
        which, lower, upper, rising = found
        interval = (np.exp(lower), np.exp(upper))
        solved = _solve_many(models.pick(which), target[which], interval, rising, by_force[which])
        columns = (x.tolist() for x in (which, solved.mu_s, solved.slope, solved.solved))
        for i, mu_s, slope, good in zip(*columns, strict=True):
            if good:
                roots[i].append((mu_s, slope))
    return roots


def judge_roots(
    roots: Sequence[Root],
    target: float,
    quantity: Quantity,
    bracket: tuple[float, float],
    ends: tuple[float, float] | None,
) -> Inversion:
    """What the roots of one push's measured quantity (`target` [N or m]) say of mu_s.

    `ends` are the least and the most that the model gives over the bracket; they are asked for
    only where there is no root.
    """
    if len(roots) == 1 and abs(roots[0][1] * roots[0][0]) > FLAT * target:
        return Inversion(*roots[0])
    if any(abs(slope * mu_s) <= FLAT * target for mu_s, slope in roots):
        what = "F_p" if quantity == "peak_force" else "d"
        set_by = ": the peak is b v at touch, or set by the stroke" if what == "F_p" else ""
        return Inversion(None, reason=f"{what} does not depend on mu_s here{set_by}")
    if roots:
        distinct = _sort_distinct(roots)
        every = tuple(mu_s for mu_s, _ in distinct), tuple(slope for _, slope in distinct)
        return Inversion(*distinct[0], *(every if len(distinct) > 1 else ((), ())))
    assert ends is not None
    return Inversion(None, reason=_explain_no_root(target, quantity, bracket, *ends))


def _explain_no_root(
    target: float, quantity: Quantity, bracket: tuple[float, float], least: float, most: float
) -> str:
    where = f"for mu_s from {bracket[0]:g} to {bracket[1]:g}"

    def show(value: float) -> str:
        return f"{value:.4g} N" if quantity == "peak_force" else f"{to_um(value):.4g} µm"

    name = "F_p" if quantity == "peak_force" else "d"
    if np.isnan(most):
        return f"the part is never released {where}"
    if target > most:
        bound = f"the most the model gives {where}: {show(most)}"
        return f"{name} = {show(target)} is above {bound}"
    if target < least:
        bound = f"the least the model gives {where}: {show(least)}"
        return f"{name} = {show(target)} is below {bound}"
    return f"{name} = {show(target)} falls in a jump of the model {where}"


def _sort_distinct(roots: Sequence[Root]) -> list[Root]:
    """Roots in rising order, each once."""
    out: list[Root] = []
    for root in sorted(roots):
        if not out or root[0] > out[-1][0] * (1 + 1e-9):
            out.append(root)
    return out


def _solve_many(
    models: PushModels,
    target: NDArray,
    bracket: tuple[NDArray, NDArray],
    rising: NDArray,
    by_force: NDArray,
) -> Crossing:
    """The crossing of each push in its bracket."""
    if not models.compiled:
        return find_crossings_in_columns(
            models.rigs, models.velocity, target, by_force, bracket, rising
        )
    from difffric.identification.compiled_models import solve_batch

    def solve_chunk(models, target, by_force, bracket, rising):
        return solve_batch(
            models.rigs, models.velocity, models.integrator, target, by_force, bracket, rising
        )

    return models.call_in_chunks(solve_chunk, target, by_force, bracket, rising)


def _grid(bracket: tuple[float, float]) -> NDArray:
    return np.linspace(np.log(bracket[0]), np.log(bracket[1]), _GRID)


def _find_ends(
    models: PushModels, by_force: NDArray, bracket: tuple[float, float]
) -> tuple[NDArray, NDArray]:
    """The least and the most the model gives over the bracket, for each push."""
    grid = np.broadcast_to(_grid(bracket), (len(models), _GRID))
    value, _, _ = models.observe_distinct_rows(np.arange(len(models)), grid, by_force)
    nowhere = np.isnan(value).all(axis=1)
    least = np.where(nowhere, np.nan, np.min(np.where(np.isnan(value), np.inf, value), axis=1))
    most = np.where(nowhere, np.nan, np.max(np.where(np.isnan(value), -np.inf, value), axis=1))
    return least, most


def _find_crossings(
    models: PushModels, target: NDArray, by_force: NDArray, bracket: tuple[float, float]
) -> list[tuple[int, float, float, bool]]:
    """Intervals (push, lower, upper, rising) of log mu_s in which the model crosses the target.

    Intervals in which the kind of the push changes, the value ceases to exist, or the slope
    turns towards the target are subdivided, six levels deep: to 1e-8 of the bracket.
    """
    found = []
    which = np.arange(len(target))
    points = np.broadcast_to(_grid(bracket), (len(target), _GRID))
    for level in range(_LEVELS):
        value, slope, kind = models.observe_distinct_rows(which, points, by_force[which])
        kind = np.where(by_force[which, None], kind_of_peak(kind), kind)
        excess = value / target[which, None] - 1.0
        a, b = excess[:, :-1], excess[:, 1:]
        sa, sb = slope[:, :-1], slope[:, 1:]
        exists = np.isfinite(a) & np.isfinite(b)
        crosses = exists & ((a < 0) != (b < 0))
        # Same sign at both ends, but heading for zero from both: it may touch between.
        left, right = np.sign(a), np.sign(b)  # products of large numbers would overflow
        dips = exists & (left * right > 0) & (left * sa < 0) & (right * sb > 0)
        edge = (kind[:, :-1] != kind[:, 1:]) & (np.isfinite(a) | np.isfinite(b))
        divide = (edge | dips) if level < _LEVELS - 1 else np.zeros_like(edge)
        for row, column in np.argwhere(np.abs(excess) <= HIT):
            point = points[row, column]
            found.append((which[row], point, point, True))
        for row, column in np.argwhere(crosses & ~divide):
            interval = (points[row, column], points[row, column + 1])
            found.append((which[row], *interval, bool(a[row, column] < 0)))
        rows, columns = np.nonzero(divide)
        if not len(rows):
            break
        lower, upper = points[rows, columns], points[rows, columns + 1]
        which = which[rows]
        share = np.linspace(0.0, 1.0, _CHILDREN + 1)
        points = lower[:, None] + share * (upper - lower)[:, None]
    return found


def choose_by_force(
    models: PushModels, distance: Sequence[Inversion], peak_force: NDArray
) -> list[Inversion]:
    """The inversions of n distances, each with the one of its alternatives as the value whose
    model comes nearest to the measured peak force (n,) [N]."""
    chosen = list(distance)
    several = [i for i, x in enumerate(distance) if x.alternatives and not np.isnan(peak_force[i])]
    if not several:
        return chosen
    which = np.repeat(several, [len(distance[i].alternatives) for i in several])
    mu_s = np.concatenate([distance[i].alternatives for i in several])
    (force, _), _, _ = models.pick(which).observe_rows(np.log(mu_s)[:, None])
    away = np.abs(force[:, 0] - peak_force[which])
    for i in several:
        chosen[i] = distance[i].at(int(np.argmin(away[which == i])))
    return chosen
