"""Smoothing splines through the samples of a moving tip, with kinks where the acceleration jumps.

A cubic spline on even knots, whose third derivative is taken for white noise of an intensity that
the samples themselves say (restricted maximum likelihood). What the spline smooths away besides
noise is then within its posterior covariance. A kink has whatever size the samples say; where it
lies is found with the rest, and counts among what is not known exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

INTERVALS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Even intervals that there may be between knots; as many as the samples allow are taken."""
MOST_KINKS = 4
"""Jumps of the acceleration that are looked for: a ramp has one, a trapezium three."""
_DEGREE = 3
"""Of the spline: its speed is of second degree, and has no corner but at a kink."""
_KINK = 20.0
"""What a kink must gain in -2 log likelihood: noise alone does so once in a thousand motions."""
_AS_GOOD = 1.0
"""-2 log likelihood by which a penalty may be worse than the likeliest: a standard deviation."""
_APART = 3.0
"""Samples between two kinks at least."""
_PLACES = 240
"""Places at which a kink is looked for."""
_REFINEMENTS = 12
"""Steps by which kinks are moved to where they explain most."""
_SETTLED = 1e-2
"""Standard errors by which a kink may yet move when it is where it belongs."""
_PER_COEFFICIENT = 4
"""Samples for each coefficient of the spline at least."""
_STIFFEST, _SOFTEST, _STEP = 1e8, 1e-8, 0.25
"""Range of the penalties, about the one under which half of the directions are followed, and the
step [e-folds] to which the best is found."""


Kinks = Sequence[float] | NDArray
"""Times [s]."""


class Way(NamedTuple):
    """A tip's way, as a spline takes it: rows of (time, position, weight)."""

    t: NDArray
    y: NDArray
    weight: NDArray
    """1 / standard deviation [1/m]"""
    end: float
    travel: float
    noise: float
    level_error: float
    """standard deviation of the travel [m]"""
    sudden: bool
    """whether the tip stops at once; how it then stands is not among the rows"""
    dt: float


@dataclass(frozen=True)
class Spline:
    """A fitted spline."""

    knots: NDArray
    kinks: tuple[float, ...]
    coefficients: NDArray
    """of the even spline, then half the jump of the acceleration at each kink"""
    covariance: NDArray
    """of the coefficients and of the kinks' times"""
    criterion: float
    """-2 log likelihood"""
    freedom: float
    """how many numbers the samples determine"""
    penalty: float
    """what the third derivative's square costs"""

    @property
    def intervals(self) -> int:
        """Even intervals between its knots."""
        return len(self.knots) - 2 * _DEGREE - 1

    @property
    def corners(self) -> NDArray:
        """When its pieces begin [s]."""
        return np.unique(np.concatenate([self.knots[_DEGREE : -_DEGREE - 1], self.kinks]))

    def design(self, t: NDArray, slope: bool = False) -> NDArray:
        """What each coefficient adds to y, or to V, at the times t [s]."""
        return np.column_stack([_design(self.knots, t, int(slope)), _bend(self.kinks, t, slope)])

    def vary(self, t: NDArray, slope: bool = False) -> NDArray:
        """What a change of each coefficient and of each kink's time adds to y, or to V."""
        moved = _move_kinks(self.kinks, self.coefficients, t, slope)
        return np.column_stack([self.design(t, slope), moved])


def smooth_way(way: Way) -> Spline:
    """The smoothing spline through a way, with the kinks that it needs, on as many knots as its
    samples allow."""
    most = len(way.t) / _PER_COEFFICIENT
    base = _Basis(way, max(n for n in INTERVALS if n == 1 or n + _DEGREE <= most))
    spline = base.fit(())
    while len(spline.kinks) < MOST_KINKS:
        place = base.find_kink(spline.kinks)
        if place is None:
            break
        new = base.fit(base.refine([*spline.kinks, place]))
        if new.criterion > spline.criterion - _KINK:
            break
        spline = new
    return spline


def smooth_again(way: Way, spline: Spline) -> Spline:
    """The smoothing spline through a way that hardly differs from that of `spline`, with as many
    knots and kinks."""
    base = _Basis(way, spline.intervals)
    return base.fit(base.refine(spline.kinks))


@dataclass(frozen=True)
class _Basis:
    """A way on so many even intervals, rotated so that samples and penalty are both diagonal."""

    way: Way
    intervals: int

    @cached_property
    def knots(self) -> NDArray:
        ends = np.zeros(_DEGREE), np.full(_DEGREE, self.way.end)
        return np.concatenate([ends[0], np.linspace(0, self.way.end, self.intervals + 1), ends[1]])

    @cached_property
    def _rotated(self) -> tuple[NDArray, NDArray, NDArray]:
        """(Q, s, back): the weighted samples' orthonormal directions (n, p), how rough each is,
        and the coefficients that each is of."""
        Q, R = np.linalg.qr(self.way.weight[:, None] * _design(self.knots, self.way.t, 0))
        step = self.way.end / self.intervals
        middles = (np.arange(self.intervals) + 0.5) * step
        rough = np.sqrt(step) * _design(self.knots, middles, _DEGREE)
        inverse = np.linalg.inv(R)
        _, s, V = np.linalg.svd(rough @ inverse)
        full = np.zeros(len(V))
        full[: len(s)] = s
        return Q @ V.T, full, inverse @ V.T

    @cached_property
    def _penalties(self) -> NDArray:
        """Those that are tried, the softest first."""
        _, s, _ = self._rotated
        span = np.arange(np.log(_SOFTEST), np.log(_STIFFEST), 1.0)
        return np.exp(span) / np.median(s[: self.intervals] ** 2)

    def fit(self, kinks: Kinks) -> Spline:
        """The spline with these kinks, under the softest penalty that is as likely as any but for
        `_AS_GOOD`: a motion that keeps its speed is else taken to be smoother than samples show."""
        products = self._multiply(kinks)
        every = [self._measure(x, products) for x in self._penalties]
        worth = min(every) + _AS_GOOD
        softest = self._penalties[next(i for i, x in enumerate(every) if x <= worth)]
        near = softest * np.exp(np.arange(-1.0, _STEP, _STEP))
        found = next(x for x in near if x == near[-1] or self._measure(x, products) <= worth)
        return self._solve(found, kinks)

    def _multiply(self, kinks: Kinks) -> tuple[NDArray, NDArray]:
        """Products of [kinks' columns, samples] with each other and with the rotated spline's."""
        way = self.way
        columns = np.column_stack([_bend(kinks, way.t, False), way.y]) * way.weight[:, None]
        return columns.T @ columns, self._rotated[0].T @ columns

    def _reduce(self, penalty: float, products: tuple[NDArray, NDArray]) -> NDArray:
        """The products with each other, less what the even spline takes of them."""
        own, rotated = products
        return own - (rotated.T / (1 + penalty * self._rotated[1] ** 2)) @ rotated

    def _measure(self, penalty: float, products: tuple[NDArray, NDArray]) -> float:
        """-2 log likelihood, the kinks' sizes chosen best."""
        inner = self._reduce(penalty, products)
        sizes = _solve_sizes(inner)
        rough = penalty * self._rotated[1][: self.intervals] ** 2
        return float(inner[-1, -1] - sizes @ inner[:-1, -1] + np.sum(np.log1p(1 / rough)))

    def _solve(self, penalty: float, kinks: Kinks) -> Spline:
        Q, s, back = self._rotated
        way, m = self.way, len(kinks)
        products = self._multiply(kinks)
        sizes = _solve_sizes(self._reduce(penalty, products))
        shrinks = 1 / (1 + penalty * s**2)
        rotated = shrinks * (products[1] @ np.append(-sizes, 1.0))
        coefficients = np.concatenate([back @ rotated, sizes])
        moved = _move_kinks(kinks, coefficients, way.t, False)
        others = way.weight[:, None] * np.column_stack([_bend(kinks, way.t, False), moved])
        cross = shrinks[:, None] * (Q.T @ others)
        outer = np.linalg.pinv(others.T @ others - (Q.T @ others).T @ cross, hermitian=True)
        inner = np.diag(shrinks) + cross @ outer @ cross.T
        covariance = np.block([[inner, -cross @ outer], [-outer @ cross.T, outer]])
        turn = np.eye(len(covariance))
        turn[: len(back), : len(back)] = back
        freedom = float(np.sum(shrinks)) + 2 * m
        rest = way.weight * way.y - others[:, :m] @ sizes - Q @ rotated
        wide = max(1.0, float(rest @ rest) / max(len(rest) - freedom, 1.0))
        return Spline(
            self.knots,
            tuple(float(x) for x in kinks),
            coefficients,
            wide * turn @ covariance @ turn.T,
            self._measure(penalty, products),
            freedom,
            penalty,
        )

    def find_kink(self, kinks: Kinks) -> float | None:
        """Where a further kink explains most [s], under whatever penalty; None where there is no
        place for one."""
        way = self.way
        places = np.linspace(0, way.end, _PLACES + 2)[1:-1]
        apart = np.abs(places[:, None] - np.asarray(kinks, float)) > _APART * way.dt
        inside = (places > 2 * way.dt) & (places < way.end - 2 * way.dt)
        places = places[apart.all(axis=1) & inside]
        if not len(places):
            return None
        Q, s, _ = self._rotated
        bends = way.weight[:, None] * _bend(places, way.t, False)
        columns = np.column_stack([_bend(kinks, way.t, False), way.y]) * way.weight[:, None]
        own, mixed, turned = np.sum(bends**2, 0), columns.T @ bends, Q.T @ bends
        products, found = self._multiply(kinks), list[tuple[float, float]]()
        for penalty in self._penalties:
            shrinks = 1 / (1 + penalty * s**2)
            inner = self._reduce(penalty, products)
            cross = mixed - (products[1].T * shrinks) @ turned
            size = own - shrinks @ turned**2
            part = np.linalg.pinv(inner[:-1, :-1], hermitian=True) @ cross[:-1]
            size, r = size - np.sum(cross[:-1] * part, 0), cross[-1] - inner[-1, :-1] @ part
            gain = np.where(size > 1e-9 * own, r**2 / np.maximum(size, 1e-300), 0.0)
            at = int(np.argmax(gain))
            found.append((self._measure(penalty, products) - float(gain[at]), float(places[at])))
        return min(found)[1]

    def refine(self, kinks: Kinks) -> list[float]:
        """The kinks moved to where they explain most, in order; those that run into each other or
        out of the motion stay where they were."""
        way, found = self.way, np.sort(np.asarray(kinks, float))
        reach, m = way.end / _PLACES, len(found)
        for _ in range(_REFINEMENTS if m else 0):
            spline = self.fit(found)
            moved = _move_kinks(found, spline.coefficients, way.t, False)
            y = way.y - _bend(found, way.t, False) @ spline.coefficients[-m:]
            columns = np.column_stack([_bend(found, way.t, False), moved, y])
            columns = way.weight[:, None] * columns
            products = columns.T @ columns, self._rotated[0].T @ columns
            step = _solve_sizes(self._reduce(spline.penalty, products))[m:]
            new = found + np.clip(step, -reach, reach)
            inside = (new > 2 * way.dt) & (new < way.end - 2 * way.dt)
            if not inside.all() or (np.diff(new) < _APART * way.dt).any():
                break
            found = new
            if (np.abs(step) < _SETTLED * np.sqrt(np.diag(spline.covariance)[-m:])).all():
                break
        return [float(x) for x in found]


def _solve_sizes(inner: NDArray) -> NDArray:
    """The factors of columns that explain the last one best, from their products."""
    return np.linalg.pinv(inner[:-1, :-1], hermitian=True) @ inner[:-1, -1]


def _design(knots: NDArray, t: NDArray, order: int) -> NDArray:
    """What each coefficient of the even spline adds to a derivative of y."""
    if order == 0:
        return BSpline.design_matrix(t, knots, _DEGREE).toarray()
    unit = np.eye(len(knots) - _DEGREE - 1)
    return BSpline(knots, unit, _DEGREE).derivative(order)(t)


def _bend(kinks: Kinks, t: NDArray, slope: bool) -> NDArray:
    """What each kink's size adds to y, or to V, at the times t [s]."""
    beyond = np.maximum(t[:, None] - np.asarray(kinks, float)[None], 0.0)
    return 2 * beyond if slope else beyond**2


def _move_kinks(kinks: Kinks, coefficients: NDArray, t: NDArray, slope: bool) -> NDArray:
    """What a change of each kink's time adds to y, or to V, at the times t [s]."""
    beyond = np.maximum(t[:, None] - np.asarray(kinks, float)[None], 0.0)
    sizes = -2 * coefficients[len(coefficients) - len(kinks) :]
    return sizes * ((beyond > 0) if slope else beyond)
