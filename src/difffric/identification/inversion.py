"""mu_s from one measured quantity: every root in a bracket, or the reason why there is none.

Each crossing is solved by a bracketed Newton iteration on the exact derivative (optimistix), in
log mu_s. Where the pusher stops at the first loss of contact both F_p and d are monotone in
mu_s and one bracket is enough; with a stroke the model is scanned for the crossings first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from difffric.compute import pytrees
from difffric.compute.event_root import HIT
from difffric.compute.program_cache import kept
from difffric.compute.pytrees import pick
from difffric.errors import InputError
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.observables import observe
from difffric.units import to_um

Quantity = Literal["peak_force", "sliding_distance"]

BRACKET = (1e-3, 2.0)
"""mu_s is sought here unless told otherwise: wider than any dry or oily metal."""

FLAT = 1e-12
"""A relative derivative below this determines nothing."""

_GRID, _CHILDREN, _LEVELS = 96, 12, 6
_CHUNK = 256


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
    rigs: Rig, velocity, target, quantity: Quantity, *, bracket=BRACKET, integrator=None
) -> list[Inversion]:
    """mu_s for each of n pushes from the measured quantity [N or m].

    `velocity` [m/s] and `target` have length n; every number of the rig is one value or n, so
    that mass and stroke may differ. NaN in `target`: not measured.

    Raises `InputError` where the lengths differ.
    """
    if not 0 < bracket[0] < bracket[1] < np.inf:
        raise InputError(f"bracket: expected 0 < lower < upper, got {bracket}")
    velocity, target = np.broadcast_arrays(np.atleast_1d(velocity), np.atleast_1d(target))
    velocity, target = velocity.astype(float), target.astype(float)
    n = len(target)
    try:
        rigs = pytrees.replicate(rigs, n)
    except ValueError as error:
        raise InputError(
            f"invert: the rig's numbers must be one value or {n}, one a push"
        ) from error
    measured = np.isfinite(target)
    safe = np.where(measured, target, 1.0)
    if rigs.pusher.stroke is None:
        ends = np.log(bracket)
        rising = np.full(n, quantity == "peak_force")
        found = np.arange(n), np.full(n, ends[0]), np.full(n, ends[1]), rising
    else:
        listed = _crossings(rigs, velocity, safe, quantity, bracket, integrator)
        found = tuple(np.array(column) for column in zip(*listed, strict=True))
    roots: list[list[tuple[float, float]]] = [[] for _ in range(n)]
    if found and n:
        which, lower, upper, rising = found
        several, v, aim = pick((rigs, velocity, safe), which)
        interval = (np.exp(lower), np.exp(upper))
        solved = _solve_many(several, v, aim, interval, rising, quantity, integrator)
        columns = (x.tolist() for x in (which, solved.mu_s, solved.slope, solved.solved))
        for i, mu_s, slope, good in zip(*columns, strict=True):
            if good:
                roots[i].append((mu_s, slope))
    ends: dict[int, tuple[float, float]] = {}
    rootless = np.flatnonzero(measured & ~np.array([bool(x) for x in roots], bool))
    if len(rootless):
        some, v = pick((rigs, velocity), rootless)
        least_most = _ends(some, v, quantity, bracket, integrator)
        ends = dict(zip(rootless.tolist(), zip(*least_most, strict=True), strict=True))
    nothing = Inversion(None, reason=f"no {_NAMES[quantity]} was measured")
    return [
        answer_of(own, aim, quantity, bracket, ends.get(i)) if known else nothing
        for i, (own, aim, known) in enumerate(
            zip(roots, target.tolist(), measured.tolist(), strict=True)
        )
    ]


_NAMES = {"peak_force": "peak force", "sliding_distance": "sliding distance"}


def answer_of(roots, target, quantity, bracket, ends) -> Inversion:
    """One push's roots, or what its measured value breaks."""
    if len(roots) == 1 and abs(roots[0][1] * roots[0][0]) > FLAT * target:
        return Inversion(*roots[0])
    if any(abs(slope * mu_s) <= FLAT * target for mu_s, slope in roots):
        what = "F_p" if quantity == "peak_force" else "d"
        set_by = ": the peak is b v at touch, or set by the stroke" if what == "F_p" else ""
        return Inversion(None, reason=f"{what} does not depend on mu_s here{set_by}")
    if roots:
        distinct = _distinct(roots)
        every = tuple(mu_s for mu_s, _ in distinct), tuple(slope for _, slope in distinct)
        return Inversion(*distinct[0], *(every if len(distinct) > 1 else ((), ())))
    where = f"for mu_s from {bracket[0]:g} to {bracket[1]:g}"
    least, most = ends

    def show(value):
        return f"{value:.4g} N" if quantity == "peak_force" else f"{to_um(value):.4g} µm"

    name = "F_p" if quantity == "peak_force" else "d"
    if np.isnan(most):
        return Inversion(None, reason=f"the part is never released {where}")
    if target > most:
        bound = f"the most the model gives {where}: {show(most)}"
        return Inversion(None, reason=f"{name} = {show(target)} is above {bound}")
    if target < least:
        bound = f"the least the model gives {where}: {show(least)}"
        return Inversion(None, reason=f"{name} = {show(target)} is below {bound}")
    return Inversion(None, reason=f"{name} = {show(target)} falls in a jump of the model {where}")


def _distinct(roots):
    """Roots in rising order, each once."""
    out: list[tuple[float, float]] = []
    for root in sorted(roots):
        if not out or root[0] > out[-1][0] * (1 + 1e-9):
            out.append(root)
    return out


def _in_chunks(function, arrays, n):
    """A compiled batch function over n elements in chunks of fixed size, the last one padded, so
    that one program serves all batches."""
    parts = []
    for start in range(0, n, _CHUNK):
        index = np.minimum(np.arange(start, start + _CHUNK), n - 1)
        parts.append(jax.tree.map(np.asarray, function(*pick(arrays, index))))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:n], *parts)


@kept
def _solve_batch(rigs, velocity, target, by_force, bracket, rising, integrator):
    from difffric.identification.crossing import (
        find_crossing,  # here: a kept program needs no optimistix
    )

    def one(rig, velocity, target, bracket, rising):
        return find_crossing(rig, velocity, target, by_force, bracket, rising, integrator)

    return jax.vmap(one)(rigs, velocity, target, bracket, rising)


def _solve_many(rigs, velocity, target, bracket, rising, quantity, integrator):
    by_force = jnp.asarray(quantity == "peak_force")

    def batch(rigs, velocity, target, bracket, rising):
        return _solve_batch(rigs, velocity, target, by_force, bracket, rising, integrator)

    return _in_chunks(batch, (rigs, velocity, target, bracket, rising), len(target))


@kept
def _model_batch(rigs, velocity, mu_s, integrator):
    def one(rig, velocity, mu_s):
        def measured(value):
            seen = observe(parameters.with_values(rig, {"mu_s": value}), velocity, integrator)
            return (seen.peak_force, seen.sliding_distance), seen.kind

        return jax.jvp(measured, (mu_s,), (jnp.ones_like(mu_s),), has_aux=True)

    return jax.vmap(one)(rigs, velocity, mu_s)


def both_at(rigs, velocity, mu_s, integrator):
    """(F_p, d), their derivatives by mu_s, and the kind, of n pushes, (n,) each."""

    def batch(rigs, velocity, mu_s):
        return _model_batch(rigs, velocity, mu_s, integrator)

    return _in_chunks(batch, (rigs, velocity, mu_s), mu_s.size)


def model_at(rigs, velocity, log_mu_s, quantity, integrator):
    """(value, derivative by log mu_s, kind), each (n, m), of the quantity of n pushes at rows of
    log mu_s (n, m). One compiled program serves all shapes."""
    rows, columns = log_mu_s.shape
    which = np.repeat(np.arange(rows), columns)
    rigs, velocity = pick((rigs, velocity), which)
    found = both_at(rigs, velocity, np.exp(log_mu_s.ravel()), integrator)
    values, slopes, kind = found
    which = ("peak_force", "sliding_distance").index(quantity)
    value, slope, kind = (a.reshape(rows, columns) for a in (values[which], slopes[which], kind))
    return value, slope * np.exp(log_mu_s), kind


def _grid(bracket):
    return np.linspace(np.log(bracket[0]), np.log(bracket[1]), _GRID)


def _ends(rigs, velocity, quantity, bracket, integrator):
    """The least and the most the model gives over the bracket, for each push."""
    grid = np.broadcast_to(_grid(bracket), (len(velocity), _GRID))
    every = np.arange(len(velocity))
    value, _, _ = _model_once(rigs, velocity, every, grid, quantity, integrator)
    nowhere = np.isnan(value).all(axis=1)
    least = np.where(nowhere, np.nan, np.min(np.where(np.isnan(value), np.inf, value), axis=1))
    most = np.where(nowhere, np.nan, np.max(np.where(np.isnan(value), -np.inf, value), axis=1))
    return least, most


def _model_once(rigs, velocity, which, points, quantity, integrator):
    """`model_at` of the pushes `which` at rows of equally spaced points of log mu_s: once for all
    rows that are alike, as those of a rig that is pushed at a few speeds are."""
    numbers = (np.asarray(x)[which] for x in (*jax.tree.leaves(rigs), velocity))
    code = np.zeros(len(which), int)
    for column in (*numbers, points[:, 0], points[:, -1]):
        values, own = np.unique(column, return_inverse=True)
        if len(values) > 1:
            code = np.unique(code * len(values) + own, return_inverse=True)[1]
    _, first, again = np.unique(code, return_index=True, return_inverse=True)
    own = which[first]
    found = model_at(pick(rigs, own), velocity[own], points[first], quantity, integrator)
    return tuple(x[again] for x in found)


def _crossings(rigs, velocity, target, quantity, bracket, integrator):
    """Intervals (push, lower, upper, rising) of log mu_s in which the model crosses the target.

    Intervals in which the kind of the push changes, the value ceases to exist, or the slope
    turns towards the target are subdivided, six levels deep: to 1e-8 of the bracket.
    """
    found = []
    which = np.arange(len(target))
    points = np.broadcast_to(_grid(bracket), (len(target), _GRID))
    for level in range(_LEVELS):
        value, slope, kind = _model_once(rigs, velocity, which, points, quantity, integrator)
        excess = value / target[which, None] - 1.0
        a, b = excess[:, :-1], excess[:, 1:]
        sa, sb = slope[:, :-1], slope[:, 1:]
        exists = np.isfinite(a) & np.isfinite(b)
        crosses = exists & ((a < 0) != (b < 0))
        # Same sign at both ends, but heading for zero from both: it may touch between.
        dips = exists & (a * b > 0) & (a * sa < 0) & (b * sb > 0)
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
