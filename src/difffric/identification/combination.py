"""What force and distance together say of mu_s: equation (7), and the statistically best mean.

The best weights are C^-1 1, scaled to a sum of one (generalised least squares), with C the
covariance of the two that `standard_errors` gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from difffric.identification.estimates import Estimates, PushFriction
from difffric.identification.inversion import Inversion
from difffric.identification.resolved_pushes import ResolvedPushes
from difffric.identification.standard_errors import average_with_error, propagate_errors
from difffric.identification.surrogates import weigh_by_ranges

if TYPE_CHECKING:
    from jaxtyping import Float

_NO_RANGE = "no (7): the model gives no range of d"
_NO_NOISE = "no optimum: the noise of F_p or of d is not known"
_NO_OWN_NOISE = "no optimum: beside the calibration's error the noise does not count"


@dataclass(frozen=True)
class Combination:
    """What F_p and d say of mu_s of n pushes, as arrays; `row` is the view of one push."""

    pushes: ResolvedPushes
    mu_s_force: Estimates
    mu_s_distance: Estimates
    mu_s_weighted: Estimates
    mu_s_optimal: Estimates
    weight_force: Float[NDArray, " n"]
    """equation (7)'s; the distance's is the rest to one"""
    disagreement: Float[NDArray, " n"]
    """mu_force minus mu_dist in standard deviations of that difference; NaN: not known"""
    alternatives: tuple[tuple[float, ...], ...]
    """all mu_s that give the measured d, where there are several"""
    regimes: tuple[str | None, ...]
    reasons: tuple[str | None, ...]
    """why an estimate is missing"""

    def row(self, i: int) -> PushFriction:
        """What one push says of mu_s."""
        pushes, force = self.pushes.pushes, float(self.weight_force[i])
        apart = self.disagreement[i]
        return PushFriction(
            velocity=float(pushes.velocity[i]),
            condition=pushes.condition[i],
            regime=self.regimes[i],
            mu_s_force=self.mu_s_force.row(i),
            mu_s_distance=self.mu_s_distance.row(i),
            mu_s_weighted=self.mu_s_weighted.row(i),
            mu_s_optimal=self.mu_s_optimal.row(i),
            weights={"force": force, "distance": 1 - force} if np.isfinite(force) else None,
            alternatives=self.alternatives[i],
            disagreement=None if np.isnan(apart) else float(apart),
            reason=self.reasons[i],
        )


def combine(
    pushes: ResolvedPushes,
    force: Sequence[Inversion],
    distance: Sequence[Inversion],
    gradient: Float[NDArray, "n 2 k"],
    regimes: Sequence[str | None],
) -> Combination:
    """Combine the inversions of F_p and d of n pushes. `gradient` and `regimes` are those of
    `ResolvedPushes.differentiate`."""
    mu, slope = (_read(force, distance, field) for field in ("value", "slope"))
    with np.errstate(invalid="ignore", divide="ignore"):
        covariance, shared = propagate_errors(slope, gradient, pushes.roots, pushes.errors)
        exists = np.asarray(np.isfinite(mu))
        count = exists.sum(axis=1)
        both, one = count == 2, count == 1
        by_7 = _weigh_by_7(mu, slope, pushes.range_ratio, both)
        best, apart = _weigh_best(covariance, both)
        alone = np.where(exists, 1.0, 0.0)
        weights = {
            "mu_s_force": np.where(exists[:, :1], [1.0, 0.0], np.nan),
            "mu_s_distance": np.where(exists[:, 1:], [0.0, 1.0], np.nan),
            "mu_s_weighted": by_7,
            "mu_s_optimal": np.where(one[:, None], alone, best),
        }
        found = {name: average_with_error(w, mu, covariance, shared) for name, w in weights.items()}
        disagreement = (mu[:, 0] - mu[:, 1]) / np.sqrt(apart)
    no_range = both & ~np.isfinite(pushes.range_ratio)
    reasons = [
        "; ".join(x for x in (a.reason, b.reason, *own) if x) or None
        for a, b, own in zip(force, distance, _explain(both, no_range, best, apart), strict=True)
    ]
    return Combination(
        pushes,
        **found,
        weight_force=by_7[:, 0],
        disagreement=disagreement,
        alternatives=tuple(x.alternatives for x in distance),
        regimes=tuple(regimes),
        reasons=tuple(reasons),
    )


def _explain(
    both: NDArray, no_range: NDArray, best: Float[NDArray, "n 2"], apart: Float[NDArray, " n"]
) -> list[tuple[str, ...]]:
    """Why equation (7) or the best mean gives nothing of a push, though F_p and d do."""
    unknown = both & np.isnan(apart)
    singular = both & np.isnan(best[:, 0]) & ~unknown
    causes = ((no_range, _NO_RANGE), (unknown, _NO_NOISE), (singular, _NO_OWN_NOISE))
    return [tuple(text for where, text in causes if where[i]) for i in range(len(both))]


def _read(
    force: Sequence[Inversion], distance: Sequence[Inversion], field: str
) -> Float[NDArray, "n 2"]:
    """A number of both inversions, NaN where there is none."""
    pairs = zip(force, distance, strict=True)
    return np.array([[getattr(x, field) for x in pair] for pair in pairs], float)


def _weigh_by_7(
    mu: Float[NDArray, "n 2"],
    slope: Float[NDArray, "n 2"],
    ratio: Float[NDArray, " n"],
    both: NDArray,
) -> Float[NDArray, "n 2"]:
    """Equation (7)'s weights; NaN where force and distance do not both say something."""
    _, w_F, w_d = weigh_by_ranges(mu[:, 0], mu[:, 1], slope[:, 0], slope[:, 1], ratio)
    return np.where(both[:, None], np.stack([w_F, w_d], axis=1), np.nan)


def _weigh_best(
    covariance: Float[NDArray, "n 2 2"], both: NDArray
) -> tuple[Float[NDArray, "n 2"], Float[NDArray, " n"]]:
    """The weights of least variance, which sum to one, and the variance of the difference of the
    two; NaN where a noise is not known."""
    known = both & np.isfinite(covariance).all(axis=(1, 2))
    C = covariance[known]
    apart, best = np.full(len(both), np.nan), np.full((len(both), 2), np.nan)
    apart[known] = C[:, 0, 0] + C[:, 1, 1] - 2 * C[:, 0, 1]
    # By LAPACK, a matrix each; where the calibration's error is so much larger than the noise
    # that the matrix is singular to the last digit, nothing is best.
    regular = np.linalg.det(C) != 0
    known[known] = regular
    w = np.linalg.solve(C[regular], np.ones((int(regular.sum()), 2, 1)))[..., 0]
    best[known] = w / w.sum(axis=1, keepdims=True)
    return best, apart
