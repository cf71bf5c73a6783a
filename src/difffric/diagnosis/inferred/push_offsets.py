"""By how much each push's trigger, the zero of its force, and its speed are off.

A trigger that is off by microseconds moves all samples of a push in time, of each push by another
amount; a force sensor's zero wanders between pushes; no drive goes at the very speed that was asked
for. Good sensors see all three, and no effect explains them: they are as random as friction is from
push to push. So they are estimated beside each push's own mu_s, and its record is corrected, as
soon as that explains nearly all that a fit leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.diagnosis.lack_of_fit import LackOfFit, measure_lack_of_fit
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.measurements.noise import read_quiet
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.measurements.reduction.reduce import Reduction

_FEWEST = 6
"""Pushes that can show whether offsets are random at least."""
_TURNS = 4
"""Steps of Gauss and Newton to the offsets at most."""
_ARRIVED = 0.03
"""Standard errors by which the last step moves no offset."""
_STEPS = (1e-7, 1e-3, 1e-5)
"""Half of the differences over which residuals are differenced: in time [s], in force [N] and in
speed, as a share."""
_LARGE, _MUCH = 0.25, 0.8
"""What a fit leaves beyond the noise, in units of it, from which on offsets need not explain all of
it but this share: beside them there may be a cause that is not found yet."""
_NOTHING_LEFT = 0.05
"""Probability above which what they leave is noise, which is asked of them where a fit leaves less:
of friction that varies with the speed in waves they explained 0.93, and left 1e-20."""
_RANDOM = 0.25
"""Share of the offsets' squares that neither their mean nor their speed may explain: a tip that
slows makes all pushes seem slower."""
_BY_CHANCE = 1e-9
"""How probable it may be at most that noise alone lets offsets explain as much."""
_POWERS = 3
"""Powers of log speed, the constant among them, that may explain offsets: what comes late for
another reason does so by the speed."""


@dataclass(frozen=True)
class PushOffsets:
    """By how much n pushes are off."""

    late: NDArray
    """(n,) how much later than its samples say each push began [s]"""
    zero: NDArray
    """(n,) what its force read where there was none [N]"""
    faster: NDArray
    """(n,) by what share it went faster than was asked for"""

    def take_from(self, recordings: Recordings) -> Recordings:
        """Return the recordings corrected by the offsets."""
        each = zip(recordings.pushes, self.late, self.zero, self.faster, strict=True)
        corrected = tuple(_correct(push, *map(float, own)) for push, *own in each)
        return replace(recordings, pushes=corrected)


def _correct(push: Recording, late: float, zero: float, faster: float) -> Recording:
    def begin(channel: Channel | None) -> Channel | None:
        return None if channel is None else replace(channel, start=channel.start - late)

    force, position, pusher = map(begin, (push.force, push.position, push.pusher))
    if force is not None and zero:
        read = force.read
        force = replace(force, read=lambda lo, hi: read(lo, hi) - zero)
    speed = push.velocity * (1.0 + faster)
    return replace(push, velocity=speed, force=force, position=position, pusher=pusher)


def describe_offsets(shifts: Sequence[PushOffsets]) -> tuple[str, ...]:
    """Say by how much the records of the pushes were corrected, by one shift after the other."""
    said: list[str] = []
    for name, what, unit, factor in _SAID if shifts else ():
        whole = factor * np.sum([getattr(one, name) for one in shifts], axis=0)
        if whole.any():
            size = f"{np.sqrt(np.mean(whole**2)):.3g} {unit}"
            said.append(f"{what} off by {size} (rms), in each push by another amount: corrected")
    return tuple(said)


_SAID = (
    ("late", "triggers are", "us", 1e6),
    ("zero", "the force's zero is", "N", 1.0),
    ("faster", "speeds are", "%", 100.0),
)
"""What is said of each kind of offset, in which unit."""


def compare_zeros(reduction: Reduction) -> PushOffsets | None:
    """Return by how much the zeros of the force that n pushes had before they began differ from
    their mean; None: by no more than noise.

    No model has to be known for that. What all zeros are off by is an effect of the catalogue.
    """
    if len(reduction.details) < _FEWEST:
        return None
    found = []
    for push, one in zip(reduction.recordings, reduction.details, strict=True):
        samples = 0 if push.force is None else len(read_quiet(push.force))
        if not samples or one.noise_force is None:
            return None
        error = one.noise_force.level / np.sqrt(one.noise_force.effective(samples))
        found.append((one.force_level, error))
    levels, errors = np.array(found).T
    weights = errors**-2.0
    zero = levels - float(np.average(levels, weights=weights))
    if not zero**2 @ weights > _compute_least(len(zero)):
        return None
    return PushOffsets(np.zeros(len(zero)), zero, np.zeros(len(zero)))


def find_push_offsets(task: EnsembleTask, fits: Fits) -> PushOffsets | None:
    """Return the offsets of n pushes; None: the fit (an ensemble of one, to recordings) leaves
    nothing that random ones explain.

    The plain parameters and each push's own mu_s move with them, effects stand still: what comes
    late by one of them is not to be taken for a trigger.
    """
    lack = measure_lack_of_fit(task, fits)
    if task.n < _FEWEST or lack.excess < _compute_least(task.n):
        return None
    at = replace(fits, extra=((),), gram=None, residual=None, damping=None)
    speeds, kinds = np.asarray(task.model.pushes.velocity), tuple(range(len(_STEPS)))
    while kinds:
        found = _fit_offsets(task, at, kinds)
        if found is None:
            return None
        sizes = found.offsets[:, kinds].T, found.errors.T
        real = [_is_real(*one, speeds) for one in zip(*sizes, strict=True)]
        if all(real):
            much = lack.excess > _LARGE * lack.expected
            much &= found.left.excess < (1 - _MUCH) * lack.excess
            nothing = (found.left.p_value or 0.0) > _NOTHING_LEFT
            return PushOffsets(*found.offsets.T) if much or nothing else None
        kinds = tuple(kind for kind, there in zip(kinds, real, strict=True) if there)
    return None


class _Fitted(NamedTuple):
    """Offsets that were fitted."""

    offsets: NDArray
    """(n, 3) in time [s], force [N] and speed; zero: of a kind that was not asked for"""
    errors: NDArray
    """(n, kinds) standard errors, all else known"""
    left: LackOfFit
    """what the fit leaves with them"""


def _fit_offsets(task: EnsembleTask, at: Fits, kinds: tuple[int, ...]) -> _Fitted | None:
    """Fit offsets of these `kinds` from the fit `at`; None: they cannot be told."""
    offsets, errors = np.zeros((task.n, len(_STEPS))), np.zeros((task.n, len(kinds)))
    for _ in range(_TURNS):
        at, step, errors = _step(task, at, offsets, kinds)
        if not np.isfinite(step).all():
            return None
        offsets[:, kinds] += step
        if (np.abs(step) < _ARRIVED * errors).all():
            break
    r = _ask(task, at, offsets)[..., -1].reshape(task.n, len(at.spread[0]), -1)
    left = measure_lack_of_fit(task, replace(at, residual=at.spread[:, None, :, None] * r))
    return _Fitted(offsets, errors, left)


def _ask(task: EnsembleTask, fits: Fits, offsets: NDArray, derivatives: bool = True) -> NDArray:
    """Return the rows (n, any, D + 1) of whitened derivatives and residuals of `fits`, with the
    pushes corrected by `offsets` (n, 3); D is 0 without derivatives."""
    pushes, (late, zero, faster) = task.model.pushes, offsets.T
    force, position = (one._replace(t=one.t - late[:, None]) for one in pushes.data)
    data = force._replace(y=force.y - zero[:, None]), position
    speed = np.asarray(pushes.velocity) * (1.0 + faster)
    moved = replace(task.model, pushes=pushes._replace(velocity=speed, data=data))
    c = np.repeat(fits.c, task.n, axis=0)
    c[:, 0] = fits.mu[0, task.condition] + fits.own[0]
    along = ensemble.directions(task, fits)[0, : None if derivatives else 0]
    rows = moved.answers(np.arange(task.n), c, along, keep_rows=True).rows
    return (rows / fits.spread[0][:, None, None]).reshape(task.n, -1, rows.shape[-1])


def _step(
    task: EnsembleTask, at: Fits, offsets: NDArray, kinds: tuple[int, ...]
) -> tuple[Fits, NDArray, NDArray]:
    """Return the fit and the changes (n, kinds) of the pushes' offsets where, by the slopes at
    them, the sum of squares is least; and the offsets' standard errors, all else known."""
    rows, shared, scatter = _ask(task, at, offsets), task.shared, float(at.scatter[0])
    J, r = rows[..., :-1], rows[..., -1]
    # What is each push's own: its mu_s, which scatters, and its offsets.
    own = [J[..., 0], *(_differentiate(task, at, offsets, kind) for kind in kinds)]
    B, free = np.stack(own, axis=-1), np.zeros(len(kinds))
    U = np.swapaxes(B, 1, 2) @ B + np.diag([scatter**-2, *free])
    b = np.einsum("nma,nm->na", B, r)
    b[:, 0] += at.own[0] / scatter**2
    A = np.zeros((*r.shape, task.conditions + len(shared)))
    A[np.arange(task.n), :, task.condition] = J[..., 0]
    A[..., task.conditions :] = J[..., 1:]
    lost = np.full((task.n, len(kinds)), np.nan)
    if not np.isfinite(U).all() or (np.einsum("naa->na", U) == 0).any():
        return at, lost, lost
    try:
        known = np.linalg.inv(U)
    except np.linalg.LinAlgError:  # two offsets of a push do the same
        return at, lost, lost
    W = np.einsum("nmp,nma->npa", A, B)
    H = np.einsum("nmp,nmq->pq", A, A) - np.einsum("npa,nab,nqb->pq", W, known, W)
    g = np.einsum("nmp,nm->p", A, r) - np.einsum("npa,nab,nb->p", W, known, b)
    x = ensemble.solve(H[None], g[None])[0]
    y = -np.einsum("nab,nb->na", known, b + np.einsum("npa,p->na", W, x))
    c = at.c.copy()
    c[0, list(shared)] += x[task.conditions :]
    moved = replace(at, c=c, mu=at.mu + x[: task.conditions], own=at.own + y[:, 0])
    return moved, y[:, 1:], np.sqrt(np.einsum("naa->na", known)[:, 1:])


def _differentiate(task: EnsembleTask, at: Fits, offsets: NDArray, kind: int) -> NDArray:
    """Return by how much the residuals (n, any) change with the pushes' offsets of a `kind`."""
    by = np.zeros(len(_STEPS))
    by[kind] = _STEPS[kind]
    more, less = (_ask(task, at, offsets + sign * by, False)[..., -1] for sign in (1, -1))
    return (more - less) / (2 * _STEPS[kind])


def _is_real(offsets: NDArray, errors: NDArray, speeds: NDArray) -> bool:
    """Whether offsets (n,), known to within `errors`, are no noise, and neither all alike nor what
    goes with the `speeds`."""
    if ((offsets / errors) ** 2).sum() < _compute_least(len(offsets)):
        return False
    powers = np.log(speeds / speeds.mean())[:, None] ** np.arange(_POWERS)
    fitted, _, rank, _ = np.linalg.lstsq(powers, offsets, rcond=None)
    rest = offsets - powers @ fitted
    random = float((rest**2).sum() / (len(offsets) - rank) - (errors**2).mean())
    return random > _RANDOM * float((offsets**2).mean())


def _compute_least(n: int) -> float:
    """Return the sum of n squares, in units of their variance, that is no noise."""
    return float(scipy.stats.chi2.isf(_BY_CHANCE, n))
