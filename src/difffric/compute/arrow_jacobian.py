"""Levenberg and Marquardt's method for a fit of many pushes, in NumPy: what costs is the model, not
the step.

Each step's linear least squares has a matrix in the shape of an arrow (`ArrowJacobian`): a few
columns that all pushes share, and two of each push's own, which are eliminated push by push. The
damping follows a trust region as that of `levenberg_marquardt` does (Conn, Gould and Toint,
Trust-Region Methods, SIAM 2000; the cut-offs are those of Gould, Orban, Sartenaer and Toint, 4OR 3
(2005)). The search also ends where a model with jumps would keep it going for nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_RTOL, _ATOL = 1e-8, 1e-7
"""A step that changes no coordinate and no residual by more than this has arrived."""
_STEP = 1e-7
"""A step smaller than this in every coordinate is none."""
_REFUSALS = 10
"""Refused steps in a row after which a search has arrived: it stands at a jump of the model."""
_POOR, _GOOD = 0.01, 0.99
"""Shares of the predicted gain below which a step is refused, and above which the next may go
further."""
_FURTHER, _SHORTER = 3.5, 0.25
"""Factors of the trust region after a good step, and after a refused one."""


class ArrowJacobian(NamedTuple):
    """The derivatives of all residuals by x = (theta (P,), own (q, n)), flat; own numbers of a push
    act on the residuals of that push alone.

    Residuals, flat too, are the rows (n, m) of the pushes, then a penalty of each of the first own
    numbers (n,), then one of each shared number (P,).
    """

    shared: NDArray
    """(n, m, P) of the rows by theta"""
    own: NDArray
    """(n, m, q) of the rows by each push's own numbers"""
    penalty: float
    """of the penalties (n,) by the first own number"""
    prior: NDArray
    """(P,) of the penalties by theta"""

    def apply(self, x: NDArray) -> NDArray:
        """The residuals' change for a change of x, to first order."""
        n, _, P = self.shared.shape
        theta, own = x[:P], x[P:].reshape(-1, n)
        rows = self.shared @ theta + np.einsum("nmq,qn->nm", self.own, own)
        return np.concatenate([rows.ravel(), self.penalty * own[0], self.prior * theta])

    def solve(self, r: NDArray, damping: float) -> NDArray:
        """The x that minimises |J x - r|^2 + damping |x|^2, by the normal equations: what they lose
        in accuracy the next step makes up. NaN where they have no solution."""
        n, m, P = self.shared.shape
        q = self.own.shape[2]
        rows, own_r, prior_r = np.split(r, [n * m, n * (m + 1)])
        columns = np.concatenate([self.shared, self.own], axis=2)
        turned = columns.swapaxes(1, 2)
        gram, right = turned @ columns, (turned @ rows.reshape(n, m, 1))[:, :, 0]
        block, mixed, g_own = gram[:, P:, P:], gram[:, :P, P:], right[:, P:]
        block[:, range(q), range(q)] += damping
        block[:, 0, 0] += self.penalty**2
        g_own[:, 0] += self.penalty * own_r
        shared = gram[:, :P, :P].sum(axis=0) + np.diag(self.prior**2 + damping)
        g = right[:, :P].sum(axis=0) + self.prior * prior_r
        across = mixed @ _invert(block)
        reduced = shared - (across @ mixed.swapaxes(1, 2)).sum(axis=0)
        try:
            theta = np.linalg.solve(reduced, g - (across @ g_own[:, :, None]).sum(axis=0)[:, 0])
        except np.linalg.LinAlgError:
            theta = np.full(P, np.nan)
        left = g_own - theta @ mixed
        own = (_invert(block) @ left[:, :, None])[:, :, 0]
        return np.concatenate([theta, own.T.ravel()])


def _invert(blocks: NDArray) -> NDArray:
    """Inverses of symmetric blocks (n, q, q) of one row or two."""
    if blocks.shape[1] == 1:
        return 1.0 / blocks
    a, b, d = blocks[:, 0, 0], blocks[:, 0, 1], blocks[:, 1, 1]
    adjugate = np.stack([np.stack([d, -b], 1), np.stack([-b, a], 1)], 1)
    return adjugate / (a * d - b * b)[:, None, None]


class Evaluation(NamedTuple):
    """A model at one x."""

    r: NDArray
    """residuals, flat"""
    jacobian: ArrowJacobian
    aux: Any
    """what else it says there"""


def search_minimum(
    evaluate: Callable[[NDArray], Evaluation], x: NDArray, most: int, worth: float = 0.0
) -> tuple[NDArray, Evaluation, int]:
    """(x, the model there, steps) near `x` where the sum of squares is least, after `most` steps at
    most, of which the first is the look at `x` itself. The search ends where the model gives no
    number for a step, and after one that brings the sum down by less than is `worth` it, or fails
    though it promised no more."""
    with np.errstate(all="ignore"):  # what is no number is refused
        here, at, region, refused, steps = evaluate(x), x, 1.0, 0, 1
        trial = x - here.jacobian.solve(here.r, 1.0)
        still = _is_none(trial - x)
        while steps < most and not still and refused < _REFUSALS and np.isfinite(trial).all():
            found, before, arrived, steps = evaluate(trial), at, False, steps + 1
            gain = _compare(here, found, trial - at)
            region *= gain.factor
            if gain.accepted:
                arrived = _is_arrived(trial, trial - at, found.r, found.r - here.r)
                arrived |= here.r @ here.r - found.r @ found.r < worth
                at, here, refused = trial, found, 0
            else:
                refused += 1
                arrived = gain.promised < worth  # shorter ones promise less
            trial = at - here.jacobian.solve(here.r, 1.0 / region)
            still = arrived or _is_none(trial - before)
    return at, here, steps


def _is_none(step: NDArray) -> bool:
    """Whether a step moves nothing."""
    return bool((np.abs(step) < _STEP).all())


class _StepOutcome(NamedTuple):
    """What has become of a step."""

    accepted: bool
    factor: float
    """of the trust region"""
    promised: float
    """by how much the sum of squares was to fall"""


def _compare(here: Evaluation, found: Evaluation, step: NDArray) -> _StepOutcome:
    """What a step has gained, beside what the linear model predicted."""
    square = here.r @ here.r
    linear = here.jacobian.apply(step) + here.r
    predicted = 0.5 * (linear @ linear - square)
    gained = 0.5 * (found.r @ found.r - square)
    accepted = bool(gained <= _POOR * predicted)
    good = gained < _GOOD * predicted and predicted < 0
    factor = (_FURTHER if good else 1.0) if accepted else _SHORTER
    return _StepOutcome(accepted, factor, float(-2.0 * predicted))


def _is_arrived(x: NDArray, dx: NDArray, r: NDArray, dr: NDArray) -> bool:
    """Whether neither x nor the residuals r have changed any more."""

    def is_still(at: NDArray, change: NDArray) -> bool:
        return bool((np.abs(change) < _ATOL + _RTOL * np.abs(at)).all())

    return is_still(x, dx) and is_still(r, dr)
