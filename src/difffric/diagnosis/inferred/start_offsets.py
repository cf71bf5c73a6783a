"""When each push really began, where the trigger of recordings is off by microseconds.

Such a trigger moves all samples of a push in time, of each push by another amount. Good sensors see
that, and no effect explains it: it is as random as friction is from push to push. So each push's
start offset is estimated beside its own mu_s, and its samples are moved, as soon as that explains
much of what a fit leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.diagnosis.lack_of_fit import measure_lack_of_fit
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.measurements.recordings import Channel, Recording, Recordings

_FEWEST = 6
"""Pushes that can show whether offsets are random at least."""
_TURNS = 4
"""Steps of Gauss and Newton to the offsets."""
_INSTANT = 1e-7
"""Half of the time [s] over which residuals are differenced."""
_MUCH = 0.4
"""Share of what a fit leaves beyond the noise that offsets have to explain. Of 30 fits to data
without any, to causes outside the catalogue, they explained half at most where they varied with
the speed, and a third at most where they did not."""
_MOST, _LEFT = 0.8, 2.0
"""The same where more than so many times the noise's squares are left: such a fit may be elsewhere,
and the push's time makes up for anything."""
_RANDOM = 0.25
"""Share of the offsets' variance that their speed must not explain."""
_BY_CHANCE = 1e-9
"""How probable it may be at most that noise alone lets offsets explain as much."""
_POWERS = 3
"""Powers of log speed, the constant among them, that may explain offsets: what comes late for
another reason does so by the speed."""


def find_start_offsets(task: EnsembleTask, fits: Fits) -> NDArray | None:
    """Return how much later than its samples say each of n pushes began [s], (n,); None: the fit
    (an ensemble of one, to recordings) leaves nothing that random offsets explain.

    The plain parameters and each push's own mu_s move with them, effects stand still: what comes
    late by one of them is not to be taken for a trigger.
    """
    if task.n < _FEWEST:
        return None
    offsets, errors = np.zeros((2, task.n))
    at = replace(fits, extra=((),), gram=None, residual=None, damping=None)
    before = _measure_squares(_ask(task, at, offsets))
    for _ in range(_TURNS):
        at, step, errors = _step(task, at, offsets)
        if not np.isfinite(step).all():
            return None
        offsets = offsets + step
    after = _measure_squares(_ask(task, at, offsets))
    drop, speeds = before - after, np.asarray(task.model.pushes.velocity)
    share = _MUCH if after < _LEFT * task.counts.sum() else _MOST
    large = drop > share * max(measure_lack_of_fit(task, fits).excess, 0.0)
    sure = drop > scipy.stats.chi2.isf(_BY_CHANCE, task.n)
    return offsets if large and sure and _are_random(offsets, errors, speeds) else None


def shift_starts(recordings: Recordings, offsets: Sequence[float] | NDArray) -> Recordings:
    """Return the recordings with their pushes begun later by the offsets (n,) [s]."""
    pairs = zip(recordings.pushes, offsets, strict=True)
    return replace(recordings, pushes=tuple(_shift(push, float(late)) for push, late in pairs))


def describe_offsets(shifts: Sequence[NDArray]) -> tuple[str, ...]:
    """Say how far the samples of the pushes were moved in time, by one shift (n,) [s] after the
    other; nothing where they were not."""
    if not shifts:
        return ()
    size = 1e6 * float(np.sqrt(np.mean(np.sum(shifts, axis=0) ** 2)))
    return (
        f"the triggers are off by {size:.3g} us (rms): each push's samples were moved in time "
        "(fit --free-start estimates by how much)",
    )


def _shift(push: Recording, late: float) -> Recording:
    def move(channel: Channel | None) -> Channel | None:
        return None if channel is None else replace(channel, start=channel.start - late)

    channels = (push.force, push.position, push.pusher)
    force, position, pusher = (move(channel) for channel in channels)
    return replace(push, force=force, position=position, pusher=pusher)


def _ask(task: EnsembleTask, fits: Fits, offsets: NDArray, derivatives: bool = True) -> NDArray:
    """Return the rows (n, any, D + 1) of whitened derivatives and residuals of `fits`, with the
    pushes begun later by `offsets` (n,) [s]; D is 0 without derivatives."""
    pushes = task.model.pushes
    data = tuple(one._replace(t=one.t - offsets[:, None]) for one in pushes.data)
    moved = replace(task.model, pushes=pushes._replace(data=data))
    c = np.repeat(fits.c, task.n, axis=0)
    c[:, 0] = fits.mu[0, task.condition] + fits.own[0]
    along = ensemble.directions(task, fits)[0, : None if derivatives else 0]
    rows = moved.answers(np.arange(task.n), c, along, keep_rows=True).rows
    return (rows / fits.spread[0][:, None, None]).reshape(task.n, -1, rows.shape[-1])


def _measure_squares(rows: NDArray) -> float:
    """Return the sum of squares of residuals."""
    return float((rows[..., -1] ** 2).sum())


def _step(task: EnsembleTask, at: Fits, offsets: NDArray) -> tuple[Fits, NDArray, NDArray]:
    """Return the fit and the change (n,) of the pushes' offsets [s] where, by the slopes at them,
    the sum of squares is least; and the offsets' standard errors (n,), all else known."""
    rows, shared, scatter = _ask(task, at, offsets), task.shared, float(at.scatter[0])
    J, r = rows[..., :-1], rows[..., -1]
    late, early = (_ask(task, at, offsets + h, False)[..., -1] for h in (_INSTANT, -_INSTANT))
    # What is each push's own: its offset, and its mu_s, which scatters.
    B = np.stack([(late - early) / (2 * _INSTANT), J[..., 0]], axis=-1)
    U = np.swapaxes(B, 1, 2) @ B + np.diag([0.0, scatter**-2])
    b = np.einsum("nma,nm->na", B, r) + np.stack([0 * offsets, at.own[0] / scatter**2], axis=1)
    A = np.zeros((*r.shape, task.conditions + len(shared)))
    A[np.arange(task.n), :, task.condition] = J[..., 0]
    A[..., task.conditions :] = J[..., 1:]
    if not np.isfinite(U).all() or (U[:, 0, 0] == 0).any():
        return at, np.full(task.n, np.nan), np.full(task.n, np.nan)
    known = np.linalg.inv(U)
    W = np.einsum("nmp,nma->npa", A, B)
    H = np.einsum("nmp,nmq->pq", A, A) - np.einsum("npa,nab,nqb->pq", W, known, W)
    g = np.einsum("nmp,nm->p", A, r) - np.einsum("npa,nab,nb->p", W, known, b)
    x = ensemble.solve(H[None], g[None])[0]
    own = -np.einsum("nab,nb->na", known, b + np.einsum("npa,p->na", W, x))
    c = at.c.copy()
    c[0, list(shared)] += x[task.conditions :]
    moved = replace(at, c=c, mu=at.mu + x[: task.conditions], own=at.own + own[:, 1])
    return moved, own[:, 0], np.sqrt(known[:, 0, 0])


def _are_random(offsets: NDArray, errors: NDArray, speeds: NDArray) -> bool:
    """Whether offsets (n,), known to within `errors`, vary by more than goes with the `speeds`."""
    powers = np.log(speeds / speeds.mean())[:, None] ** np.arange(_POWERS)
    fitted, _, rank, _ = np.linalg.lstsq(powers, offsets, rcond=None)
    rest = offsets - powers @ fitted
    random = float((rest**2).sum() / (len(offsets) - rank) - (errors**2).mean())
    return random > _RANDOM * float(np.var(offsets, ddof=1))
