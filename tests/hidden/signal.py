"""How visible what is hidden is: s, the square root of the expected drop of chi-square.

For each push y = f(plain rig) + r + noise, r what the effect changes of all that was measured. A
plain fit makes the best of r with k, b, k_v, each condition's mu_s, each push's position zero, and
with each push's own mu_s, under a scatter that it estimates too. In units of the noise (AR(1)
undone) and linear in these, -2 log likelihood then rises on average, for a scatter sigma' where
sigma is true, by

    s^2 = min over theta, sigma' of  sum_i (r_i - G_i theta)^T V_i^-1 (r_i - G_i theta)
                                     + q_i - 1 - log q_i,
    V_i = 1 + sigma'^2 j_i j_i^T,   q_i = (1 + sigma^2 |j_i|^2) / (1 + sigma'^2 |j_i|^2),

j_i being the derivative of push i by its own log mu_s. The plain parameters are moved to where that
leads and the rest is looked at again, until s stays: an extra load takes a change of mu_s, however
large. Samples within one interval of a jump of the force count for nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from tests.hidden import simulate, stepper
from tests.hidden.case import TABLE, Case
from tests.hidden.noise import whitened
from tests.reference.effect_parameters import NAMES

STEP = 1e-6
"""of a coordinate, for differences"""
MOST_SCATTER = 1.0
ROUNDS, SLOW = 12, 0.3
"""at most so many moves of the plain parameters; their derivatives are taken anew where a move
leaves more of s than this"""
FARTHEST = 1.0
"""from the truth, in a coordinate"""
SETTLED = 0.01
"""relative change of s after which no further one is made"""
WEAK, GROW, LEVELS = 100.0, 4.0, 5
"""s up to which an effect is looked at as it is; what a stronger one is grown by, how often"""
HALVINGS, NEAR = 4, 10.0
"""of a step, to a quarter each, that leads farther from what is measured; chi-square that may be"""
NOTHING = 0.02
"""s that nobody asks for"""
PLACES = tuple(NAMES.index(x) for x in ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m", "mu_s"))
"""the coordinates: log k, log b, k_v / sqrt(k m), log mu_s of each push"""
VISCOUS = 2


class Invisible(ValueError):
    """No size of the effect is as visible as asked."""


Runs = Sequence[stepper.Run]


@dataclass
class Base:
    """A case's plain pushes at the times of its measurement, and their derivatives there."""

    times: list[np.ndarray]
    runs: list[stepper.Run]
    slopes: list[np.ndarray]
    """of each push: a row a reading (F, then position), a column a coordinate"""


def _stacked(run: stepper.Run, table: bool) -> np.ndarray:
    if table:
        return np.array([run.peak_force, run.sliding_distance])
    return np.concatenate([run.force, run.position])


def _runs(case: Case, times: Sequence[np.ndarray], moved: Any = 0.0) -> list[stepper.Run]:
    """The pushes at the times, the plain coordinates moved. Raises Invisible without an answer."""
    rows, others = simulate.numbers(case)
    moved = np.broadcast_to(moved, (len(rows), len(PLACES)))
    scale = math.sqrt(case.rig["k_N_per_m"] * case.rig["mass_kg"])
    for column, place in enumerate(PLACES):
        if NAMES[place] == "k_v_N_s_per_m":
            rows[:, place] += scale * moved[:, column]
        else:
            rows[:, place] *= np.exp(moved[:, column])
    runs = [simulate.sensed(case, row, others, t) for row, t in zip(rows, times, strict=True)]
    if any(run.reason for run in runs):
        raise Invisible("a push has no answer")
    return runs


def _linear(plain: Case, times: list[np.ndarray], at: np.ndarray) -> Base:
    table, columns = plain.kind == TABLE, []
    for column in range(len(PLACES)):
        step = STEP * (np.arange(len(PLACES)) == column)
        pairs = zip(_runs(plain, times, at + step), _runs(plain, times, at - step), strict=True)
        columns.append([(_stacked(a, table) - _stacked(b, table)) / 2 / STEP for a, b in pairs])
    slopes = [np.stack(each, axis=1) for each in zip(*columns, strict=True)]
    return Base(times, _runs(plain, times, at), slopes)


def base(case: Case) -> Base:
    """What has to be worked out once for a rig, its pushes and its times."""
    ends = [run.end for run in simulate.answers(case)]
    table = case.kind == TABLE
    times = [np.zeros(0) if table else simulate.sample_times(case, end) for end in ends]
    return _linear(case.plain(), times, np.zeros((len(case.pushes), len(PLACES))))


def _kept(times: np.ndarray, rate: float, *runs: stepper.Run) -> np.ndarray:
    """Samples that are not beside a jump of the force."""
    jumps = np.concatenate([run.jumps for run in runs])
    return np.all(np.abs(times[:, None] - jumps[None, :]) * rate > 1, axis=1)


def _white(case: Case, columns: np.ndarray, keep_force: np.ndarray) -> np.ndarray:
    """One push's columns (force, then position) in units of the noise, its zero taken out."""
    noise, n = case.noise, len(keep_force)
    force = whitened(columns[:n], noise.force, noise.force_phi, keep_force)
    every = np.ones(n, bool)
    with_zero = np.column_stack([columns[n:], np.ones(n)])
    position = whitened(with_zero, noise.position, noise.position_phi, every)
    zero = position[:, -1] / np.linalg.norm(position[:, -1])
    position = position[:, :-1] - np.outer(zero, zero @ position[:, :-1])
    return np.concatenate([force, position])


def _table_white(case: Case, columns: np.ndarray) -> np.ndarray:
    scaled = columns / np.array([case.noise.force, case.noise.position])[:, None]
    return scaled[np.isfinite(scaled).all(axis=1)]


def _grams(case: Case, base: Base, measured: Runs, now: Runs, at: np.ndarray, extra=()):
    """Of each push, the products of [r, the extra shifts, the coordinates' slopes].

    `measured` and `now` are the runs whose difference r is, the latter at the coordinates `at`, the
    slopes' way there put back; an extra shift, a pair of runs, is what the one has more.
    """
    table, found = case.kind == TABLE, []
    for i, (times, slopes) in enumerate(zip(base.times, base.slopes, strict=True)):
        r = _stacked(measured[i], table) - _stacked(now[i], table) + slopes @ at[i]
        shifts = [_stacked(a[i], table) - _stacked(b[i], table) for a, b in extra]
        columns = np.column_stack([r, *shifts, slopes])
        if table:
            white = _table_white(case, columns)
        else:
            more = [runs[i] for pair in extra for runs in pair]
            kept = _kept(times, case.rate, measured[i], now[i], base.runs[i], *more)
            white = _white(case, columns, kept)
        found.append(white.T @ white)
    return np.array(found)


def _of_condition(case: Case) -> np.ndarray:
    names = list(case.mu_s)
    return np.array([names.index(push.condition) for push in case.pushes])


def _total(grams: np.ndarray, which: np.ndarray, scatter: float) -> np.ndarray:
    """The products over all pushes under a scatter, with a column for each condition's mu_s."""
    weight = scatter**2 / (1 + scatter**2 * grams[:, -1, -1])
    reduced = grams - weight[:, None, None] * grams[:, :, -1:] * grams[:, -1:, :]
    fixed = grams.shape[1] - 1
    total = np.zeros((fixed + which.max() + 1,) * 2)
    for gram, condition in zip(reduced, which, strict=True):
        at = [*range(fixed), fixed + condition]
        total[np.ix_(at, at)] += gram
    return total


def _projected(total: np.ndarray, shifts: int) -> tuple[np.ndarray, np.ndarray]:
    """(products of the first columns that the others leave, what takes up the rest)."""
    norms = np.sqrt(np.maximum(np.diag(total)[shifts:], 1e-300))
    inner = total[shifts:, shifts:] / np.outer(norms, norms)
    cross = total[shifts:, :shifts] / norms[:, None]
    taken = np.linalg.lstsq(inner, cross, rcond=1e-13)[0]
    return total[:shifts, :shifts] - cross.T @ taken, taken / norms[:, None]


def _squared(grams, which, scatter: float, least: float) -> tuple[float, np.ndarray]:
    """s^2, and where the coordinates go, a row a push; that of k_v is at least `least`."""
    squared, to = _free(grams, which, scatter)
    if to[0, VISCOUS] >= least:
        return squared, to
    fixed = np.eye(grams.shape[1])
    column = len(fixed) - len(PLACES) + VISCOUS
    fixed[column, 0], fixed[column, column] = -least, 0.0
    squared, to = _free(fixed.T @ grams @ fixed, which, scatter)
    to[:, VISCOUS] = least
    return squared, to


def _free(grams, which, scatter: float) -> tuple[float, np.ndarray]:
    """The same without a limit."""
    own = grams[:, -1, -1]

    def rise(log_scatter):
        tried = math.exp(log_scatter)
        ratio = (1 + scatter**2 * own) / (1 + tried**2 * own)
        left = _projected(_total(grams, which, tried), 1)[0][0, 0]
        return max(left, 0.0) + float(np.sum(ratio - 1 - np.log(ratio)))

    truth = math.log(max(scatter, 1e-9))
    bounds = (math.log(max(scatter, 1e-6)) - 1, math.log(MOST_SCATTER))
    best = minimize_scalar(rise, bounds=bounds, method="bounded")
    there = min((truth, float(best.x)), key=rise)  # type: ignore[union-attr]
    tried = math.exp(there)
    taken = _projected(_total(grams, which, tried), 1)[1][:, 0]
    n_mu = which.max() + 1
    common = np.column_stack([np.tile(taken[:-n_mu], (len(which), 1)), taken[-n_mu:][which]])
    rest = grams[:, -1, 0] - np.einsum("ij,ij->i", grams[:, -1, 1:], common)
    common[:, -1] += tried**2 / (1 + tried**2 * own) * rest
    return rise(there), common[:, -len(PLACES) :]


def _least(case: Case) -> float:
    """The coordinate where k_v is 0."""
    return -case.rig["k_v_N_s_per_m"] / math.sqrt(case.rig["k_N_per_m"] * case.rig["mass_kg"])


def _misfit(grams: np.ndarray, at: np.ndarray) -> float:
    """Chi-square of what is measured where the coordinates stand, without any penalty."""
    taken = np.zeros(grams.shape[:2])
    taken[:, 0], taken[:, -len(PLACES) :] = 1.0, -at
    return float(np.einsum("ni,nij,nj->", taken, grams, taken))


class Settled(NamedTuple):
    """s, the plain coordinates where it is least, and whether the search came to rest there."""

    s: float
    at: np.ndarray
    settled: bool


def settle(
    case: Case, start: Base, at: np.ndarray | None = None, extra: Sequence[Case] = ()
) -> Settled:
    """Moves the plain coordinates, from the truth or, where that is better, from `at`, to where s
    is least; the sizes of extra effects are free."""
    which, plain, measured = _of_condition(case), case.plain(), _runs(case, start.times)
    pairs = [(_runs(one, start.times), start.runs) for one in extra]

    def look(at):
        now = _runs(plain, start.times, at)
        grams = _grams(case, start, measured, now, at, pairs)
        return grams, _misfit(grams, at)

    nowhere, least = np.zeros((len(which), len(PLACES))), _least(case)
    starts = [nowhere] if at is None else [at, nowhere]
    found, looks, closer = [], [look(at) for at in starts], True
    best = min(range(len(starts)), key=lambda i: looks[i][1])
    at, (grams, misfit) = starts[best], looks[best]
    for _ in range(ROUNDS):
        squared, to = _squared(grams, which, case.scatter, least)
        to = np.clip(to, -FARTHEST, FARTHEST)
        found.append(math.sqrt(squared))
        slow = len(found) > 1 and found[-1] > SLOW * found[-2]
        close = len(found) > 1 and abs(found[-1] - found[-2]) <= SETTLED * found[-1]
        if found[-1] < NOTHING or (close and closer):
            return Settled(found[-1], at, True)
        step = to - at
        for _ in range(HALVINGS):
            there, reached = look(at + step)
            closer = reached <= misfit + NEAR
            if closer:
                break
            step = step / 4
        at, grams, misfit = at + step, there, reached
        if slow or not closer:
            start = _linear(plain, start.times, at)
            grams, misfit = look(at)
    return Settled(min(found[1:]), at, False)


def strength(case: Case, at: Base | None = None) -> float:
    """s of all that is hidden in the case (nuisances left out); `at` from `base`, of any size."""
    case = replace(case, nuisances={})
    return grown(case, at or base(case)).s


def grown(case: Case, start: Base, extra: Sequence[Case] = ()) -> Settled:
    """`settle`, a strong effect grown from a weak one, or the plain parameters would rest elsewhere
    than at the best that they can do."""
    nowhere = np.zeros((len(case.pushes), len(PLACES)))
    grams = _grams(case, start, _runs(case, start.times), start.runs, nowhere)
    first = math.sqrt(_free(grams, _of_condition(case), case.scatter)[0])
    levels, at = min(max(math.ceil(math.log(max(first, 1e-9) / WEAK, GROW)), 0), LEVELS), None
    for level in range(levels, 0, -1):
        weaker = case
        for name in case.hidden:
            weaker = weaker.scaled(name, max(GROW**-level, case.factors(name)[0]))
        at = GROW * settle(weaker, start, at, extra).at
    return settle(case, start, at, extra)


def own_strength(case: Case, name: str, at: Base | None = None) -> tuple[float, float]:
    """s of one hidden effect: alone, and beside the others hidden, whose sizes are free too."""
    case = replace(case, nuisances={})
    at = at or base(case)
    rest = [case.only(other) for other in case.hidden if other != name]
    return grown(case.only(name), at).s, grown(case, at, rest).s


def cosine(case: Case, one: Case, other: Case) -> float:
    """Of the angle between what two cases of the same rig and pushes show, plain part taken out:
    near 1, the data of `case` cannot tell them apart. Linear: for effects that are not large."""
    start = base(case)
    a, b = (_runs(x, start.times) for x in (one, other))
    at = np.zeros((len(a), len(PLACES)))
    grams = _grams(case, start, a, start.runs, at, [(b, start.runs)])
    left, _ = _projected(_total(grams, _of_condition(case), case.scatter), 2)
    return float(left[0, 1] / math.sqrt(max(left[0, 0] * left[1, 1], 1e-300)))
