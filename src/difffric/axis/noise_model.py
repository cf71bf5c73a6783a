"""The noise of an axis and what it leaves certain: restricted likelihood of a linear mixed model.

Rows of a run are block means of positions without their free start. Their covariance is a sum of
kernels with sizes >= 0: encoder noise, white and coloured, and force disturbances of several
colours, which the axis integrates twice; and each stretch has a friction level of its own. The
sizes are what makes the rows most likely once the parameters are eliminated (restricted maximum
likelihood: Patterson & Thompson, Biometrika 58 (1971) 545), by exact gradients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

ENCODER_TIMES = (0.02, 0.15)
"""Correlation times [s] of coloured encoder noise, beside white noise."""
FORCE_TIMES = (0.01, 0.08, 0.6)
"""Correlation times [s] of force disturbances."""
KERNELS = (
    "white",
    *(f"encoder {t:g} s" for t in ENCODER_TIMES),
    *(f"force {t:g} s" for t in FORCE_TIMES),
)
"""What the sizes stand for, in their order; the friction level's comes after them."""
_TINY = 1e-10
"""Size, as a share of what would explain all residuals, at which a kernel counts as absent."""
_HUGE = 1e5
"""Largest size, as such a share: what a strongly correlated noise explains is less than it is."""
_BEGIN = 1e-2
"""Size of all kernels, as such a share, at which a search begins."""
_MOST_STEPS = 60
"""Steps of a search at most; a dozen are usual."""
_SETTLED = 2e-3
"""Drop of -2 log likelihood that is not worth another step."""


@dataclass(frozen=True)
class RunRows:
    """The rows of one run, without its free start and speed."""

    stretch: int
    keep: NDArray
    """(n, n - 2) directions that no start and no speed reaches, orthonormal"""
    kernels: NDArray
    """(kernels, n - 2, n - 2) covariances of unit size"""


@dataclass(frozen=True)
class NoiseFit:
    """Sizes of the noise, and the parameters' steps under it."""

    sizes: NDArray
    """(kernels + 1,) variances: of each kernel, then of the friction level"""
    step: NDArray
    """(p,) best coefficients of the columns"""
    covariance: NDArray
    """(p, p) of the step"""
    criterion: float
    """-2 log restricted likelihood"""
    log_likelihood: float
    """-2 log of the likelihood itself, by which fits with other parameters compare"""
    before_step: float
    """the same without the step"""
    chi2: float
    """the rows' squared length in units of the noise, after the step"""
    levels: NDArray
    """(stretches,) best estimate of each stretch's deviation of the friction level"""
    level_variances: NDArray
    """(stretches,) of these estimates' errors"""


def make_rows(
    stretch: int, times: NDArray, starts: NDArray, per_block: float, rate: float
) -> RunRows:
    """Return what a run's rows have in common.

    `times` (n,) are the blocks' mean times, `starts` (n, 2) what a free start and a free speed
    change of the rows; the axis forgets its speed at `rate` [1/s], as k_v / m says.
    """
    n = len(times)
    keep = np.linalg.qr(starts, mode="complete")[0][:, 2:]
    lag = np.abs(times[:, None] - times[None, :])
    once = np.tril(np.ones((n, n))) * np.gradient(times)[None, :]
    once -= np.diag(np.diag(once)) / 2
    twice = np.linalg.solve(np.eye(n) + rate * once, once @ once)
    kernels = [np.eye(n) / per_block]
    kernels += [np.exp(-lag / t) for t in ENCODER_TIMES]
    kernels += [twice @ np.exp(-lag / t) @ twice.T for t in FORCE_TIMES]
    return RunRows(stretch, keep, np.stack([keep.T @ x @ keep for x in kernels]))


def make_force_rows(stretch: int, times: NDArray, per_block: int) -> RunRows:
    """Return what a run's rows have in common where they are block means of forces: the same
    kernels, none of them integrated, and the slowest of them a level of the whole run."""
    n = len(times)
    lag = np.abs(times[:, None] - times[None, :])
    kernels = [np.eye(n) / per_block]
    kernels += [np.exp(-lag / t) for t in (*ENCODER_TIMES, *FORCE_TIMES[:-1])]
    return RunRows(stretch, np.eye(n), np.stack([*kernels, np.ones((n, n))]))


class NoiseProblem:
    """Rows of all runs: `targets` (n,) against `columns` (n, p), `levels` (n,) the column of the
    friction level, a run each."""

    def __init__(
        self,
        rows: Sequence[RunRows],
        targets: Sequence[NDArray],
        columns: Sequence[NDArray],
        levels: Sequence[NDArray],
    ):
        self.rows, self.targets, self.columns, self.levels = rows, targets, columns, levels
        self.p = columns[0].shape[1]
        self.stretches = 1 + max(x.stretch for x in rows)
        self.n = sum(len(x) for x in targets)
        self._data = [np.column_stack(x) for x in zip(columns, targets, strict=True)]

    def solve(self, sizes: NDArray) -> tuple[NoiseFit, NDArray, NDArray]:
        """Return the best step under noise of these sizes, the criterion's gradient in them, and
        its average information (Gilmour, Thompson & Cullis, Biometrics 51 (1995) 1440).

        Raises `numpy.linalg.LinAlgError` where the noise is singular.
        """
        tau2, logdet = sizes[-1], 0.0
        parts = []
        along = np.zeros(self.stretches)
        crossed = np.zeros((self.stretches, self.p + 1))
        normal = np.zeros((self.p + 1, self.p + 1))
        for rows, D, z in zip(self.rows, self._data, self.levels, strict=True):
            C = np.tensordot(sizes[:-1], rows.kernels, axes=1)
            inverse, half_logdet = _invert(C)
            logdet += 2 * half_logdet
            W = inverse @ np.column_stack([D, z])
            parts.append((inverse, W))
            along[rows.stretch] += z @ W[:, -1]
            crossed[rows.stretch] += W[:, -1] @ D
            normal += D.T @ W[:, :-1]
        shrink = tau2 / (1 + tau2 * along)
        logdet += float(np.log1p(tau2 * along).sum())
        normal -= (crossed * shrink[:, None]).T @ crossed
        A, b, yy = normal[:-1, :-1], normal[:-1, -1], normal[-1, -1]
        size = np.diag(A)
        if not np.isfinite(size).all():
            raise np.linalg.LinAlgError("columns are not finite")
        # A column that vanishes gets a variance without bounds, and no overflow.
        scale = 1 / np.sqrt(np.maximum(size, max(1e-60 * size.max(initial=0.0), 1e-200)))
        values, vectors = np.linalg.eigh(scale[:, None] * A * scale)
        values = np.maximum(values, 1e-13)
        root = scale[:, None] * vectors / np.sqrt(values)
        covariance = root @ root.T
        step = covariance @ b
        chi2 = float(yy - b @ step)
        of_columns = float(np.log(values).sum() - 2 * np.log(scale).sum())
        criterion = logdet + of_columns + chi2
        left = crossed[:, -1] - crossed[:, :-1] @ step
        likelihood = logdet + chi2
        before = logdet + float(yy)
        found = NoiseFit(
            sizes, step, covariance, criterion, likelihood, before, chi2, shrink * left, shrink
        )

        slopes = np.zeros(len(sizes))
        pulls, spreads = np.zeros(self.stretches), np.zeros((self.stretches, self.p))
        pushes = np.zeros((self.stretches, len(sizes)))
        inner = np.zeros((len(sizes), len(sizes)))
        by_columns = np.zeros((self.p, len(sizes)))
        shown = []
        for rows, z, (inverse, W) in zip(self.rows, self.levels, parts, strict=True):
            s = rows.stretch
            V = W[:, :-1] - np.outer(W[:, -1], shrink[s] * crossed[s])
            w = V[:, -1] - V[:, :-1] @ step
            U = V[:, :-1] @ root
            pulls[s] += z @ w
            spreads[s] += z @ U
            used = np.column_stack([w, U, np.sqrt(shrink[s]) * W[:, -1]])
            outer = inverse - used @ used.T
            slopes[:-1] += np.tensordot(rows.kernels, outer, axes=2)
            shown.append((w, U, inverse, W[:, -1]))
        squared = along - shrink * along**2
        slopes[-1] = float((squared - pulls**2 - (spreads**2).sum(1)).sum())
        for rows, z, (w, U, inverse, Z) in zip(self.rows, self.levels, shown, strict=True):
            Q = np.column_stack([(rows.kernels @ w).T, pulls[rows.stretch] * z])
            inner += Q.T @ inverse @ Q
            pushes[rows.stretch] += Z @ Q
            by_columns += U.T @ Q
        inner -= (pushes * shrink[:, None]).T @ pushes + by_columns.T @ by_columns
        return found, slopes, inner

    def fit(self, start: NDArray | None = None, without: Sequence[int] = ()) -> NoiseFit:
        """Return the noise that makes the rows most likely, and the parameters under it.

        `start` are sizes to begin at; the kernels `without` are left out.
        """
        scale = self._scale_sizes()
        if self.stretches < 2:
            without = [*without, len(KERNELS)]
        scale[list(without)] = 0.0
        least, most = scale * _TINY, scale * _HUGE
        sizes = np.clip(scale * _BEGIN if start is None else start, least, most)
        found, slopes, information = self.solve(sizes)
        damping = 1e-2
        for _ in range(_MOST_STEPS):
            gradient = slopes * sizes
            held = ((sizes <= least) & (gradient > 0)) | (sizes == 0)
            hessian = information * np.outer(sizes, sizes)
            curve = np.maximum(np.diag(hessian), np.abs(gradient)) + 1e-9
            hessian = hessian + np.diag(damping * curve + 0.3 * np.maximum(gradient, 0.0))
            hessian[held, :], hessian[:, held] = 0.0, 0.0
            hessian[held, held] = 1.0
            move = np.clip(np.linalg.solve(hessian, -np.where(held, 0.0, gradient)), -4.0, 4.0)
            trial = np.clip(sizes * np.exp(move), least, most)
            try:
                tried = self.solve(trial)
            except np.linalg.LinAlgError:
                damping = max(10 * damping, 1e-2)
                continue
            drop = found.criterion - tried[0].criterion
            if drop >= 0:
                sizes, (found, slopes, information) = trial, tried
                damping = max(damping / 5, 1e-4)
                if drop < _SETTLED:
                    break
            elif damping > 1e6:
                break
            else:
                damping *= 10
        return found

    def weigh_equally(self, found: NoiseFit) -> NoiseFit:
        """Return the noise found, with the step of plain least squares and the errors that the
        spread from stretch to stretch gives it (Liang & Zeger, Biometrika 73 (1986) 13).

        For forces that answer to an imposed motion: no kernel then decides which part of a move
        counts, and the fitted levels are the averages that a person takes.
        """
        X, y = np.concatenate(self.columns), np.concatenate(self.targets)
        inverse = np.linalg.pinv(X.T @ X, hermitian=True)
        step = inverse @ X.T @ y
        scores = np.zeros((self.stretches, self.p))
        for rows, X, y in zip(self.rows, self.columns, self.targets, strict=True):
            scores[rows.stretch] += X.T @ (y - X @ step)
        count = int((np.abs(scores).sum(1) > 0).sum())
        factor = count / max(count - 1, 1)
        robust = factor * inverse @ scores.T @ scores @ inverse
        covariance = robust if count > self.p + 1 else found.covariance
        return replace(found, step=step, covariance=covariance)

    def screen(self, sizes: NDArray, extra: Sequence[NDArray], width: int) -> NDArray:
        """Return by how much chi-square would fall with groups of more columns (groups,), under
        noise of these sizes; `extra` (n, groups * width) a run."""
        groups = extra[0].shape[1] // width
        along, p, tau2 = np.zeros(self.stretches), self.p, sizes[-1]
        crossed = np.zeros((self.stretches, p + 1 + groups * width))
        normal = np.zeros((p + 1, p + 1 + groups * width))
        own = np.zeros((groups, width, width))
        for rows, D, E, z in zip(self.rows, self._data, extra, self.levels, strict=True):
            inverse, _ = _invert(np.tensordot(sizes[:-1], rows.kernels, axes=1))
            W = inverse @ np.column_stack([D, E])
            along[rows.stretch] += z @ inverse @ z
            crossed[rows.stretch] += z @ W
            normal += D.T @ W
            of_extra = W[:, p + 1 :].reshape(len(z), groups, width)
            own += np.einsum("ngi,ngj->gij", E.reshape(len(z), groups, width), of_extra)
        shrink = tau2 / (1 + tau2 * along)
        normal -= (crossed[:, : p + 1] * shrink[:, None]).T @ crossed
        of_extra = crossed[:, p + 1 :].reshape(self.stretches, groups, width)
        own -= np.einsum("sgi,s,sgj->gij", of_extra, shrink, of_extra)
        solved = np.linalg.solve(normal[:p, :p], normal[:p, p:])
        beside = normal[:p, p + 1 :].reshape(p, groups, width)
        left = own - np.einsum("pgi,pgj->gij", beside, solved[:, 1:].reshape(p, groups, width))
        pull = (normal[p, p + 1 :] - normal[:p, p] @ solved[:, 1:]).reshape(groups, width)
        size = np.einsum("gii->gi", left)
        scale = 1 / np.sqrt(np.maximum(size, 1e-9 * np.einsum("gii->gi", own) + 1e-300))
        even = left * scale[:, :, None] * scale[:, None, :] + 1e-6 * np.eye(width)
        scaled = (pull * scale)[..., None]
        return np.einsum("gij,gij->g", scaled, np.linalg.solve(even, scaled))

    def _scale_sizes(self) -> NDArray:
        """Sizes at which each kernel alone would make rows as large as those left by the plain
        least squares."""
        X, y = np.concatenate(self.columns), np.concatenate(self.targets)
        norm = np.linalg.norm(X, axis=0) + 1e-300
        step = np.linalg.lstsq(X / norm, y, rcond=1e-12)[0] / norm
        traces = np.zeros(len(KERNELS) + 1)
        left = 0.0
        for rows, t, c, z in zip(self.rows, self.targets, self.columns, self.levels, strict=True):
            traces[:-1] += np.trace(rows.kernels, axis1=1, axis2=2)
            traces[-1] += z @ z
            left += float(((t - c @ step) ** 2).sum())
        floor = 1e-24 * float(y @ y) + 1e-300
        return np.where(traces > 0, (left + floor) / np.where(traces > 0, traces, 1.0), 0.0)


def _invert(C: NDArray) -> tuple[NDArray, float]:
    """The inverse of a covariance, and half the logarithm of its determinant.

    Raises `numpy.linalg.LinAlgError` where it is singular.
    """
    L = np.linalg.cholesky(C)
    inverse = scipy.linalg.lapack.dpotri(L, lower=1)[0]
    inverse = np.tril(inverse) + np.tril(inverse, -1).T
    return inverse, float(np.log(np.diag(L)).sum())
