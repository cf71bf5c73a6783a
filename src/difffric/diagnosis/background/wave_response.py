"""What a small wave of any length changes, from waves of a few lengths.

A small wave of friction, or of the tip's speed, changes what a push answers in proportion, place by
place: the answer by the turns per metre is a Fourier transform of the answer by the place. No
place lies beyond the push's way, so that the transform is band-limited: samples of it less than
1 / way apart give it at any number of turns (Shannon, Communication in the presence of noise, Proc.
IRE 37, 1949; truncated by Kaiser's window). Short ways need few samples, long ones many; all
lengths can then be looked at as closely as the longest way tells them apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.columns.shape_columns import (
    AMPLITUDE,
    ShapeColumns,
    list_waves,
    make_columns,
    number_wave,
)
from difffric.diagnosis.background.evidence import Evidence
from difffric.diagnosis.background.small_effects import ask_pushes, measure_change
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits

Complex = NDArray[np.complex128]

_LONGEST = 1e3
"""A wavelength [m] that no push tells from an endless one."""
_FARTHER = 1.1
"""Times its way as it was measured that a simulated push may go."""
_DENSER = 1.3
"""How many times as dense as necessary the samples are."""
_HALF_WIDTH, _BETA = 7, 5.0
"""Samples on either side that a value is made of, and Kaiser's window over them."""
_BEYOND = 7
"""Samples beyond the shortest wave."""
_LOOKS = 6.0
"""Looks per turn that the longest way tells apart."""


@dataclass(frozen=True)
class WaveResponse:
    """The changes by waves of unit amplitude where a fit stands: of push i, K_i samples at turns
    0, step_i, 2 step_i, ... [1/m]. Real parts are those by a cosine, imaginary ones by a sine."""

    way: NDArray
    """(n,) as far as each push may go [m]"""
    rows: list[Complex]
    """of each push (K_i, R): of the whitened residuals"""
    changes: list[Complex]
    """of each push (K_i, 2): relative ones of F_p and d; NaN: there is none"""

    @property
    def step(self) -> NDArray:
        """(n,) between the samples' turns [1/m]."""
        return 1.0 / (_DENSER * self.way)

    def weigh_samples(self, i: int, turns: NDArray) -> Complex:
        """The weights (m, 2 K_i - 1) of push i's samples, those of negative turns first, that give
        its changes at `turns` (m,) [1/m]."""
        K, step = len(self.rows[i]), self.step[i]
        away = turns[:, None] / step - np.arange(1 - K, K)
        within = np.clip(1 - (away / (_HALF_WIDTH + 0.5)) ** 2, 0.0, None)
        window = np.i0(_BETA * np.sqrt(within)) / np.i0(_BETA) * (within > 0)
        # The places lie in 0 to way: about their middle, the band is symmetric.
        return np.sinc(away) * window * np.exp(1j * np.pi * away * step * self.way[i])

    def compute_rows(self, turns: NDArray) -> NDArray:
        """The columns (n, R, 2 m) by sines and cosines of `turns` (m,) [1/m], those of each in
        turn."""
        found = []
        for i, rows in enumerate(self.rows):
            at: Complex = self.weigh_samples(i, turns) @ _mirror(rows)
            found.append(np.stack([at.imag, at.real], axis=1).reshape(2 * len(turns), -1).T)
        return np.stack(found)

    def compute_changes(self, turns: NDArray) -> NDArray:
        """The relative changes (2 m, n, 2) of F_p and d likewise."""
        found = []
        for i, changes in enumerate(self.changes):
            at: Complex = self.weigh_samples(i, turns) @ _mirror(changes)
            found.append(np.stack([at.imag, at.real], axis=1).reshape(2 * len(turns), 2))
        return np.stack(found, axis=1)


def sample_waves(
    task: EnsembleTask,
    at: Fits,
    effect: str,
    ways: NDArray,
    most: float,
) -> WaveResponse:
    """Ask what waves of one effect change, up to `most` turns [1/m], where the fit `at` (an
    ensemble of one) stands, which has none; along `ways` (n,) [m]."""
    way = _FARTHER * ways
    sine, length, cosine = number_wave(task, effect)
    coordinates = task.model.coordinates
    points, index, sizes = [], [], []
    for i in range(task.n):
        K = int(np.ceil(most * _DENSER * way[i])) + 1 + _BEYOND
        turns = np.arange(K) / (_DENSER * way[i])
        long = 1.0 / np.maximum(turns, 1.0 / _LONGEST)
        one = np.repeat(at.c, 2 * K, axis=0)
        one[:, length] = np.repeat((long - coordinates.null[length]) / coordinates.unit[length], 2)
        one[0::2, cosine] = one[1::2, sine] = AMPLITUDE / coordinates.unit[sine]
        points += [at.c, one]
        index += [i] * (1 + 2 * K)
        sizes.append(2 * K)
    r, model = ask_pushes(task, at, np.array(index), np.concatenate(points))
    rows, changes, first = [], [], 0
    for size in sizes:
        own = r[first : first + 1 + size].reshape(1 + size, -1)
        with np.errstate(invalid="ignore", divide="ignore"):
            change = model[first + 1 : first + 1 + size] / model[first] - 1
        moved = own[1:] - own[0]
        # A push that cannot be followed with one of the waves says nothing of any.
        moved = moved if np.isfinite(moved).all() else np.zeros_like(moved)
        for found, x in ((rows, moved), (changes, change)):
            found.append((x[0::2] + 1j * x[1::2]) / AMPLITUDE)
        first += 1 + size
    return WaveResponse(way, rows, changes)


def make_wave_columns(
    task: EnsembleTask, effect: str, response: WaveResponse, turns: NDArray
) -> ShapeColumns:
    """Make the columns of waves of so many `turns` [1/m]."""
    change = measure_change(response.compute_changes(turns))
    return make_columns(list_waves(task, effect, turns), response.compute_rows(turns), change)


def choose_lengths(evidence: Evidence, response: WaveResponse, cells: NDArray) -> NDArray:
    """Return the turns [1/m] of those waves, one between each two of the ascending `cells`
    (m + 1,) [1/m], that explain the most beside all that `evidence` compares: as its likeliest
    state has it, all of that in the background."""
    looks = max(int(np.ceil((cells[-1] - cells[0]) * _LOOKS * response.way.max())), 1)
    turns = np.linspace(cells[0], cells[-1], looks + 1)
    gain = _compute_gains(evidence, response, turns)
    cell = np.clip(np.searchsorted(cells, turns, side="right") - 1, 0, len(cells) - 2)
    best = [np.flatnonzero(cell == k) for k in range(len(cells) - 1)]
    return np.array([turns[mine[np.argmax(gain[mine])]] for mine in best if len(mine)])


def _compute_gains(evidence: Evidence, response: WaveResponse, turns: NDArray) -> NDArray:
    """The drop (m,) of chi-square by a wave of each of `turns` (m,) [1/m], its sine and cosine of
    any size."""
    known = evidence.rows.shape[2]
    U: Complex = np.zeros((len(turns), known), complex)  # F' [known, r], F = cosine + i sine
    straight = np.zeros(len(turns))  # |F|^2
    crossed: Complex = np.zeros(len(turns), complex)  # F'F
    weights = evidence.weigh_own()
    for i, rows in enumerate(response.rows):
        S, w = _mirror(rows), response.weigh_samples(i, turns)
        own = w @ (S @ evidence.push[i])
        U += w @ (S @ evidence.rows[i]) - weights[i] * own[:, None] * evidence.own[i]
        straight += np.real(np.einsum("mk,mk->m", w @ (S @ S.conj().T), w.conj()))
        straight -= weights[i] * np.abs(own) ** 2
        crossed += np.einsum("mk,mk->m", w @ (S @ S.T), w) - weights[i] * own**2
    left, explained = evidence.remove_known(np.concatenate([U.real, U.imag]))
    a, b = 0.5 * (straight + crossed.real), 0.5 * (straight - crossed.real)
    M = np.stack([[a, 0.5 * crossed.imag], [0.5 * crossed.imag, b]]).transpose(2, 0, 1)
    both = explained.reshape(2, len(turns), -1)
    M = M - np.einsum("imk,jmk->mij", both, both)
    h = left.reshape(2, len(turns)).T
    # Waves that the others do as well explain nothing.
    M = M + 1e-9 * np.maximum(straight, 1e-12)[:, None, None] * np.eye(2)
    return np.einsum("mi,mi->m", h, np.linalg.solve(M, h[:, :, None])[:, :, 0])


def _mirror(samples: Complex) -> Complex:
    """The samples (2 K - 1, ...) of negative turns, whose changes are conjugate, before the
    others."""
    return np.concatenate([samples[:0:-1].conj(), samples])
