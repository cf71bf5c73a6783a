"""mu_s from F_p and from d by stored polynomials: what a controller evaluates in a hard loop.

In the scaled reading X = q / v (q is F_p or d) and y = mu_s / v, a cell of a range of speeds and
of X holds y as a polynomial. For the plain rig without a stroke v drops out altogether: equations
(1) and (2) are homogeneous, a push with v, mu_s, x and F all twice as large solves them too, and so
F_p / v and d / v are functions of mu_s / v alone. Equation (4) is its straight line.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

DETERMINED, NOT_MEASURED, SPEED_OUTSIDE, NOT_DETERMINED, OUTSIDE_BOX = range(5)
REASONS = (
    "determined",
    "not measured",
    "the speed is outside the box",
    "does not determine mu_s here: it hardly depends on it, or belongs to several mu_s, or to none",
    "mu_s is outside the box",
)
_ROUNDING = 1e-9
"""Relative: a speed may come by another conversion of units."""
NEITHER, BY_FORCE, BY_DISTANCE = 0, 1, 2
"""Of a status, which is a sum: 3 is both."""


@dataclass(frozen=True)
class Box:
    """Where a predictor is to hold: speeds [m/s] and mu_s, ends included."""

    slowest: float
    fastest: float
    least_mu_s: float
    most_mu_s: float


@dataclass(frozen=True)
class Cells:
    """y = mu_s / v [s/m] as a polynomial of X = q / v in cells, each for a range of speeds."""

    speeds: NDArray
    """(n + 1,) ends of the ranges of speed [m/s]"""
    first: NDArray
    """(n + 1,) each range's first cell, and how many cells there are"""
    lower: NDArray
    """(m,) least X of each cell, rising within a range; there may be gaps"""
    upper: NDArray
    coefficients: NDArray
    """(m, i, j): of tau^i xi^j, where tau and xi run from -1 to 1 over the cell"""

    def find(self, v: NDArray, X: NDArray) -> NDArray:
        """The cell of each point, -1 where there is none."""
        strip = np.clip(np.searchsorted(self.speeds, v, "right") - 1, 0, len(self.speeds) - 2)
        cell = np.full(v.shape, -1)
        for s in np.unique(strip):
            mine = strip == s
            low, high = self.first[s], self.first[s + 1]
            if high > low:
                at = low + np.searchsorted(self.lower[low:high], X[mine], "right") - 1
                inside = (at >= low) & (X[mine] <= self.upper[np.maximum(at, low)])
                cell[mine] = np.where(inside, at, -1)
        return cell

    def evaluate(self, cell: NDArray, v: NDArray, X: NDArray) -> tuple[NDArray, NDArray]:
        """y and its derivative by X in the cells given."""
        strip = np.searchsorted(self.first[1:], cell, "right")
        strip = np.minimum(strip, len(self.speeds) - 2)
        begin, end = self.speeds[strip], self.speeds[strip + 1]
        width = self.upper[cell] - self.lower[cell]
        xi = 2 * (X - self.lower[cell]) / width - 1
        tau = 2 * (v - begin) / (end - begin) - 1
        y, slope = np.zeros(v.shape), np.zeros(v.shape)
        for i in reversed(range(self.coefficients.shape[1])):
            row, steep = np.zeros(v.shape), np.zeros(v.shape)
            for j in reversed(range(self.coefficients.shape[2])):
                steep = steep * xi + row
                row = row * xi + self.coefficients[cell, i, j]
            y, slope = y * tau + row, slope * tau + steep
        return y, 2 * slope / width


class Prediction(NamedTuple):
    """What n pushes' readings say; NaN where they say nothing. All (n,)."""

    mu_s: NDArray
    variance: NDArray
    """of mu_s, from the readings' standard errors alone; NaN where they are not known"""
    mu_s_force: NDArray
    variance_force: NDArray
    mu_s_distance: NDArray
    variance_distance: NDArray
    status: NDArray
    """which readings mu_s is from: `NEITHER`, `BY_FORCE`, `BY_DISTANCE` or their sum"""
    force: NDArray
    """an index of `REASONS`"""
    distance: NDArray


@dataclass(frozen=True)
class Predictor:
    """mu_s from F_p and from d over a box, within `max_error` of the model's own inverse."""

    box: Box
    max_error: float
    """relative, of mu_s; an answer that far outside the box still counts as inside"""
    force: Cells
    distance: Cells

    def predict(
        self,
        velocity: ArrayLike,
        peak_force: ArrayLike = np.nan,
        sliding_distance: ArrayLike = np.nan,
        peak_force_se: ArrayLike = np.nan,
        sliding_distance_se: ArrayLike = np.nan,
    ) -> Prediction:
        """mu_s of n pushes from `velocity` [m/s], F_p [N], d [m] (NaN: not measured) and their
        standard errors (NaN: not known); the same arithmetic as the C function's."""
        given = (velocity, peak_force, sliding_distance, peak_force_se, sliding_distance_se)
        v, F, d, F_se, d_se = (np.asarray(x, float) for x in np.broadcast_arrays(*given))
        by_force, var_force, force = self._one(self.force, v, F, F_se)
        by_distance, var_distance, distance = self._one(self.distance, v, d, d_se)
        has = [code == DETERMINED for code in (force, distance)]
        known = [~np.isnan(x) for x in (var_force, var_distance)]
        # One without a standard error does not count beside one with.
        counts = [
            mine & (mine_known | ~(other & other_known))
            for mine, mine_known, other, other_known in (
                (has[0], known[0], has[1], known[1]),
                (has[1], known[1], has[0], known[0]),
            )
        ]
        weight = [
            np.where(count, np.where(k, 1 / np.where(k, var, 1.0), 1.0), 0.0)
            for count, k, var in zip(counts, known, (var_force, var_distance), strict=True)
        ]
        total = weight[0] + weight[1]
        some = total > 0
        safe = np.where(some, total, 1.0)
        value = [np.where(h, x, 0.0) for h, x in zip(has, (by_force, by_distance), strict=True)]
        mean = (weight[0] * value[0] + weight[1] * value[1]) / safe
        told = (counts[0] & known[0]) | (counts[1] & known[1])
        status = BY_FORCE * counts[0] + BY_DISTANCE * counts[1]
        return Prediction(
            np.where(some, mean, np.nan), np.where(told, 1 / safe, np.nan), by_force, var_force,
            by_distance, var_distance, status, force, distance,
        )  # fmt: skip

    @property
    def slowest(self) -> float:
        """The least speed that is answered [m/s]: the box's, but for rounding."""
        return self.box.slowest * (1 - _ROUNDING)

    @property
    def fastest(self) -> float:
        """The largest speed that is answered [m/s]."""
        return self.box.fastest * (1 + _ROUNDING)

    def _one(self, cells: Cells, v, q, se):
        box = self.box
        inside = (v >= self.slowest) & (v <= self.fastest)
        measured = ~np.isnan(q)
        usable = measured & inside
        v = np.where(usable, v, box.slowest)
        X = np.where(usable, q, 0.0) / v
        cell = np.where(usable, cells.find(v, X), -1)
        found = cell >= 0
        y, slope = cells.evaluate(np.maximum(cell, 0), v, np.where(found, X, cells.lower[0]))
        mu_s = v * y
        least = box.least_mu_s * (1 - self.max_error)
        most = box.most_mu_s * (1 + self.max_error)
        in_box = found & (mu_s >= least) & (mu_s <= most)
        reason = np.where(in_box, DETERMINED, np.where(found, OUTSIDE_BOX, NOT_DETERMINED))
        reason = np.where(measured, np.where(inside, reason, SPEED_OUTSIDE), NOT_MEASURED)
        error = slope * np.where(se > 0, se, np.nan)  # v cancels: dmu_s / dq is dy / dX
        variance = np.where(in_box, error * error, np.nan)
        return np.where(in_box, mu_s, np.nan), variance, reason

    def as_dict(self) -> dict:
        """As predictor.json holds it (SI)."""
        return {
            "box": asdict(self.box),
            "max_error": self.max_error,
            **{name: asdict(getattr(self, name)) for name in ("force", "distance")},
        }

    @classmethod
    def from_dict(cls, stored: dict) -> Predictor:
        """The predictor that `as_dict` wrote."""

        def cells(name) -> Cells:
            read = {key: np.asarray(value) for key, value in stored[name].items()}
            return Cells(**read)

        return cls(Box(**stored["box"]), stored["max_error"], cells("force"), cells("distance"))
