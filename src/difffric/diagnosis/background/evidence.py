"""How well sets of causes explain what was measured beside a background of small effects.

At the best fit with all small effects the answers are linear in every effect: the derivatives and
the columns of shapes there give one Gram matrix, in which a set of causes is compared with another
by linear algebra alone. A cause in the set has any size; every other effect is in the background,
normal about its null, its scatter a share of its unit that is estimated with the rest (as is the
scatter of mu_s): what is told is averaged over both, by their likelihood.

Equations: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), chapter 2, with
the plain parameters under flat priors and each push's own mu_s eliminated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.special import logsumexp

from difffric.diagnosis.background.columns.known_columns import collect_rows
from difffric.diagnosis.background.columns.shape_columns import Shape, ShapeColumns, join_columns
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits

SHARES = np.array([0.03, 0.06, 0.12, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8])
"""Shares of their units by which background effects may scatter."""
_NONE_AT_ALL = 0.3
"""Prior probability that there is no background."""
_USUAL = 0.5
"""The share up to which a background is usual: the scale of a half-Cauchy prior."""
_SCATTERS = np.array([0.5, 0.75, 1.0, 1.4, 2.0, 3.0])
"""Scatters of mu_s that are averaged over, as shares of the joint fit's."""
_RIDGE = 1e-10
"""What is added to a unit diagonal, so that sizes on which nothing depends have a solution."""
_LARGEST = 2.0
"""How many times as large as one may meet a cause is, at one standard deviation."""


class PossibleCause(NamedTuple):
    """What may be a cause: an effect, of one shape."""

    effect: str
    columns: tuple[int, ...]
    shape: Shape | None = None


class BackgroundState(NamedTuple):
    """All that a scatter of mu_s and a share of the background say of q effects' columns."""

    scatter: float
    share: float
    cost: float
    """-2 log likelihood with all effects in the background"""
    squares: float
    """the part of it that is a sum of squares"""
    M: NDArray
    """(q, q) information on the columns, all plain parameters eliminated"""
    h: NDArray
    """(q,) their products with the residuals"""
    C: NDArray | None
    """(q, q) posterior covariance of the columns' sizes in units of the background's; None: no
    background"""
    mean: NDArray | None
    """(q,) posterior means likewise"""
    inverse: NDArray
    """(P, P) of the information on the plain parameters"""
    known: NDArray
    """(P, q + 1) what these do in place of the columns and of the residuals"""
    B: NDArray | None = None
    """(q,) the background's scatter in each column"""


@dataclass(frozen=True)
class SetFit:
    """What N sets of causes, of k columns each, explain; S states."""

    gain: NDArray
    """(N,) log likelihood beyond that of no cause at all, averaged over the states"""
    weight: NDArray
    """(S, N) of the states"""
    size: NDArray
    """(S, N, k) best sizes of the columns"""
    covariance: NDArray
    """(S, N, k, k)"""
    background: NDArray
    """(S, N, k) variance that each column would have in the background"""

    def best_size(self, j: int) -> NDArray:
        """The sizes (k,) of set j, averaged over the states."""
        return np.einsum("s,sk->k", self.weight[:, j], self.size[:, j])


class Evidence:
    """The comparison of sets of causes where a joint fit stands."""

    def __init__(
        self,
        task: EnsembleTask,
        at: Fits,
        small: SmallEffects,
        shapes: ShapeColumns | None,
        background: bool = True,
        known: tuple[NDArray, NDArray] | None = None,
    ):
        """`known` are the columns of `collect_rows`, where they have been computed already."""
        self.task, self.at, self.small = task, at, small
        self._shapes, self._background = shapes, background
        self._columns = collect_rows(task, at, small, shapes) if known is None else known
        self.rows, self.push = self._columns
        # A cause may be as large as it is: it is no less probable than one that is usual.
        size = np.abs(at.c[0] - small.null)[list(small.index)]
        self.unit, self.typical = small.unit, np.maximum(small.typical, size / _LARGEST)
        self.usual = small.unit if small.usual is None else small.usual
        """the sizes at which effects change F_p or d by as much as matters"""
        if shapes is not None:
            parts = [self.rows[..., :-1], shapes.rows, self.rows[..., -1:]]
            self.rows = np.concatenate(parts, axis=2)
            self.unit = np.concatenate([small.unit, shapes.unit])
            self.typical = np.concatenate([self.typical, shapes.typical])
            self.usual = np.concatenate([self.usual, shapes.unit])
        self.gram = np.swapaxes(self.rows, 1, 2) @ self.rows
        self.own = np.einsum("nr,nrp->np", self.push, self.rows)
        self.z = (self.push**2).sum(axis=1)
        self.known = self.gram.shape[1] - 1 - len(self.unit)
        self.items = _list_items(small, shapes)
        shares = np.append(0.0, SHARES) if background else np.zeros(1)
        scatters = at.scatter[0] * (_SCATTERS if task.estimate_scatter and task.mu_free else [1.0])
        prior = np.tile(_make_prior(background), len(scatters))
        self.excess = 1.0
        """by how much more than noise is left with all effects in the background"""
        # Errors are as large as what all effects together leave says.
        most = self._make_states(scatters, np.array([1.0]))
        left = min(state.squares for state in most) / max(task.counts.sum() - self.known, 1.0)
        self.excess = max(float(left), 1.0)
        self._scatters, self._shares = np.asarray(scatters), shares
        self._states = self._make_states(scatters, shares)
        self._log_prior = prior
        self.nothing = float(sum_logs(prior - 0.5 * np.array([s.cost for s in self._states])))

    def add_columns(self, *more: ShapeColumns) -> Evidence:
        """Return the comparison with further shapes, none of them placed."""
        shapes = join_columns(*more if self._shapes is None else (self._shapes, *more))
        return Evidence(self.task, self.at, self.small, shapes, self._background, self._columns)

    @property
    def log_likelihood(self) -> float:
        """That of no cause at all, but for a constant: fits that stand elsewhere compare by it."""
        return self.nothing - 0.5 * float(self.task.counts.sum()) * float(np.log(self.excess))

    @property
    def effects(self) -> int:
        """How many effects are compared, or 1."""
        return max(len({item.effect for item in self.items}), 1)

    def weigh_states(self, items: Sequence[PossibleCause]) -> list[tuple[float, float, float]]:
        """The scatters of mu_s, the shares of the background and their probabilities, where the
        `items` are causes."""
        if items:
            weight = self.compare([[c for item in items for c in item.columns]]).weight[:, 0]
        else:
            log = self._log_prior - 0.5 * np.array([state.cost for state in self._states])
            weight = np.exp(log - self.nothing)
        return [(x.scatter, x.share, float(w)) for x, w in zip(self._states, weight, strict=True)]

    def estimate_share(self, items: Sequence[PossibleCause] = ()) -> float:
        """The share of their units by which the effects scatter, where the `items` are causes."""
        return sum(share * weight for _, share, weight in self.weigh_states(items))

    def compute_spread(self, share: float, causes: Sequence[int]) -> NDArray:
        """By how much each column's size is assumed to scatter: the columns `causes` as much as one
        may meet, the others by a share of their units."""
        B = share * self.unit
        B[list(causes)] = _LARGEST * self.typical[list(causes)]
        return B

    def _make_states(
        self, scatters: NDArray, shares: NDArray, causes: Sequence[int] = ()
    ) -> list[BackgroundState]:
        P, out, causes = self.known, [], list(causes)
        for scatter in scatters:
            weight = scatter**2 / (1 + scatter**2 * self.z / self.excess) / self.excess
            G = self.gram.sum(axis=0) - np.einsum("n,np,nq->pq", weight, self.own, self.own)
            G = G / self.excess
            A = G[:P, :P]
            scale = np.sqrt(np.maximum(np.diag(A), 1e-12))
            unit = A / np.outer(scale, scale)
            inverse = np.linalg.pinv(unit, rcond=1e-12) / np.outer(scale, scale)
            known = inverse @ G[:P, P:]
            R = G[P:, P:] - G[P:, :P] @ known
            plain = inverse, known
            volume = np.log1p(scatter**2 * self.z / self.excess).sum()
            volume += np.linalg.slogdet(unit + 1e-13 * np.eye(P))[1] + 2 * np.log(scale).sum()
            M, h, squares = R[:-1, :-1], R[:-1, -1], float(R[-1, -1])
            for share in shares:
                if share == 0 and not causes:
                    cost = float(squares + volume)
                    out.append(
                        BackgroundState(
                            float(scatter), 0.0, cost, squares, M, h, None, None, *plain
                        )
                    )
                    continue
                B = self.compute_spread(share, causes)
                Q = np.eye(len(B)) + B[:, None] * M * B
                C = np.linalg.inv(Q)
                mean = -C @ (B * h)
                left = squares + float(h @ (B * mean))
                cost = float(left + volume + np.linalg.slogdet(Q)[1])
                out.append(BackgroundState(scatter, share, cost, left, M, h, C, mean, *plain, B))
        return out

    def compare(self, sets: Sequence[Sequence[int]]) -> SetFit:
        """Compare sets of columns, all of k, of any size: every other column is in the
        background."""
        index = np.asarray(sets, int)
        k = index.shape[1]
        cost, sizes, covariances, variances = [], [], [], []
        for state in self._states:
            if state.C is None or state.mean is None:
                P, q = state.M[index[:, :, None], index[:, None, :]], state.h[index]
                variance, removed = np.zeros(index.shape), 0.0
            else:
                B = state.share * self.unit[index]
                inverse = np.linalg.inv(state.C[index[:, :, None], index[:, None, :]])
                mean = state.mean[index]
                P = (inverse - np.eye(k)) / B[:, :, None] / B[:, None, :]
                q = -np.einsum("nij,nj->ni", inverse, mean) / B
                removed = np.einsum("ni,nij,nj->n", mean, inverse, mean)
                removed = removed - np.linalg.slogdet(inverse)[1]
                variance = B**2
            P = P + (_LARGEST * self.typical[index])[:, :, None] ** -2.0 * np.eye(k)
            scale = np.sqrt(np.maximum(np.einsum("nii->ni", P), 1e-30))
            unit = P / scale[:, :, None] / scale[:, None, :] + _RIDGE * np.eye(k)
            V = np.linalg.inv(unit) / scale[:, :, None] / scale[:, None, :]
            size = -np.einsum("nij,nj->ni", V, q)
            cost.append(state.cost + removed + np.einsum("ni,ni->n", size, q))
            sizes.append(size)
            covariances.append(V)
            variances.append(variance)
        log = self._log_prior[:, None] - 0.5 * np.array(cost)
        total = sum_logs(log, axis=0)
        return SetFit(
            gain=total - self.nothing,
            weight=np.exp(log - total),
            size=np.array(sizes),
            covariance=np.array(covariances),
            background=np.array(variances),
        )

    def list_small_shapes(self, least: float) -> list[str]:
        """The effects whose shapes are placed and would have to grow by such a factor at `least`
        to have unit size."""
        placed = self.list_placed()
        return [item.effect for item in placed if self.unit[item.columns[0]] > least]

    def list_placed(self) -> list[PossibleCause]:
        """The shapes that are in the model."""
        return [item for item in self.items if item.shape is not None and item.shape.placed]

    def project_out_small(self) -> tuple[NDArray, NDArray, int]:
        """The information (C, C) on the columns of shapes and their products with the residuals
        (C,), the plain parameters free and all else with a background of unit size, and the number
        of the first of these columns."""
        (state,) = self._make_states(np.array([self.likeliest_scatter]), np.array([1.0]))
        p = len(self.small.index)
        known = state.M[:p, :p] + np.diag(self.unit[:p] ** -2.0)
        cross = np.linalg.solve(known, state.M[:p, p:])
        M = state.M[p:, p:] - state.M[p:, :p] @ cross
        return M * self.excess, (state.h[p:] - state.h[:p] @ cross) * self.excess, p

    def weigh_own(self) -> NDArray:
        """How much (n,) of each push's products with its own mu_s is taken off, which eliminates
        that, at the likeliest scatter."""
        weight = self.likeliest_scatter**2
        return weight / (1 + weight * self.z / self.excess) / self.excess

    def remove_known(self, products: NDArray) -> tuple[NDArray, NDArray]:
        """Of further columns, whose products (m, p + 1) with those that are compared and with the
        residuals are given, what they have to do with the residuals (m,), and (m, p) what the
        others explain of them: with a background of unit size, the placed shapes of any."""
        placed = [c for item in self.list_placed() for c in item.columns]
        prior = np.zeros(self.known + len(self.unit))
        prior[self.known :] = self.excess * self.compute_spread(1.0, placed) ** -2.0
        weight = self.weigh_own()
        G = self.gram.sum(axis=0) - np.einsum("n,np,nq->pq", weight, self.own, self.own)
        H = G[:-1, :-1] + np.diag(prior)
        scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
        factor = np.linalg.cholesky(H / np.outer(scale, scale) + _RIDGE * np.eye(len(H)))
        right = np.column_stack([G[:-1, -1], products[:, :-1].T]) / scale[:, None]
        whitened = scipy.linalg.solve_triangular(factor, right, lower=True)
        explained = whitened[:, 1:].T
        return products[:, -1] - explained @ whitened[:, 0], explained

    @property
    def likeliest_scatter(self) -> float:
        """The scatter of mu_s that is the most likely."""
        costs = np.array([state.cost for state in self._states]) - 2 * self._log_prior
        return float(self._scatters[int(np.argmin(costs)) // len(self._shares)])

    def list_states(self, items: Sequence[PossibleCause]) -> list[tuple[BackgroundState, float]]:
        """The states with the `items` as causes, normal about zero here too, and the log
        probability of each with what was measured, but for the constant of `nothing`."""
        causes = [c for item in items for c in item.columns]
        states = self._make_states(self._scatters, self._shares, causes)
        logs = self._log_prior - 0.5 * np.array([state.cost for state in states])
        return list(zip(states, logs.tolist(), strict=True))

    def compute_log_p_values(
        self, items: Sequence[PossibleCause], least_share: float | None = None
    ) -> list[float]:
        """The logarithm of the probability, for each item of a set, that noise makes it so large;
        with a `least_share`, that noise and a background do that scatters as the evidence says, and
        by that share of what matters at least."""
        found = self.compare([[c for item in items for c in item.columns]])
        out, start = [], 0
        for item in items:
            mine = slice(start, start + len(item.columns))
            start += len(item.columns)
            V = found.covariance[:, 0, mine, mine]
            if least_share is not None:
                least = (least_share * self.usual[list(item.columns)]) ** 2
                variance = np.maximum(found.background[:, 0, mine], least)
                V = V + variance[:, :, None] * np.eye(len(item.columns))
            size = found.size[:, 0, mine]
            drop = np.einsum("si,si->s", size, np.linalg.solve(V, size[:, :, None])[:, :, 0])
            tail = scipy.stats.chi2.logsf(drop, len(item.columns))
            out.append(float(sum_logs(tail, b=found.weight[:, 0])))
        return out


def sum_logs(x: Any, axis: int | None = None, b: Any = None) -> NDArray:
    """The logarithm of a sum of exponentials, each `b` times."""
    return np.asarray(logsumexp(x, axis=axis, b=b))


def _make_prior(background: bool) -> NDArray:
    """Log prior probabilities of the shares, none first."""
    if not background:
        return np.zeros(1)
    density = np.gradient(SHARES) / (1 + (SHARES / _USUAL) ** 2)
    return np.log(np.append(_NONE_AT_ALL, (1 - _NONE_AT_ALL) * density / density.sum()))


def _list_items(small: SmallEffects, shapes: ShapeColumns | None) -> list[PossibleCause]:
    items = [PossibleCause(effect, (k,)) for k, effect in enumerate(small.effects)]
    if shapes is not None:
        p = len(items)
        for shape, columns in zip(shapes.shapes, shapes.columns, strict=True):
            items.append(PossibleCause(shape.effect, tuple(p + c for c in columns), shape))
    return items
