"""The push that would tell two explanations apart, or show an effect that these data do not.

One explanation is taken for the truth; the other is refitted, in one step, to the data there are
and to the new push. What is left of their difference is how far they would be apart, in standard
deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.data import DiagnosisData
from difffric.estimation.block_means import UnevenBlocks, make_uneven, pad_uneven
from difffric.estimation.ensembles import ensemble, ensemble_refits
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.estimation.following.answer_by_program import StackedPushes
from difffric.measurements.recordings import Channel
from difffric.rig.catalogue import KEYS, RATIO, numbers_of
from difffric.units import to_mm, to_mm_min

_SPEEDS = (0.6, 1.0, 2.0, 4.0, 10.0)
"""Times the slowest, up to the fastest."""
_HEAVIER = 1.5
"""Times the data's median mass, of a part with a load on it."""
_LONG_REST = 1000.0
"""Rest [s] before a push: three decades beyond the second from which friction at rest grows."""
_LEAST_DRAG = 4.9
"""Deceleration [m/s^2] of a sliding part over mu_s: half of gravity, so that no slide is cut."""
_AFTER = 5e-3
"""How long a part is looked at beyond its slide [s]."""
_LONGEST = 2.5e-3
"""Of a block [s]: how fine a push is looked at that nobody has made yet."""
_HIDING = 6
"""Steps in which the plain model takes up what an invisible effect does."""
_TYPICAL_RATIO = 0.8
"""The mu_k / mu_s that stands for this effect's typical size, of which the catalogue has none."""


@dataclass(frozen=True)
class Experiment:
    """One push and what it would tell."""

    separates: tuple[str, ...]
    """the effects; "plain" is the model without any of them"""
    velocity_m_per_s: float
    mass_kg: float
    stroke_m: float | None
    """None: the pusher goes on without a stop"""
    rest_before_s: float
    separation: float
    """expected, in standard deviations"""

    def __str__(self) -> str:
        stroke = "" if self.stroke_m is None else f", stroke {to_mm(self.stroke_m):.3g} mm"
        what = " from ".join(x if x != "plain" else "the plain model" for x in self.separates)
        return (
            f"a push at {to_mm_min(self.velocity_m_per_s):.0f} mm/min with {self.mass_kg:.3g} kg"
            f"{stroke}, {self.rest_before_s:.3g} s of rest before it, would tell {what} by "
            f"{self.separation:.2g} standard deviations"
        )

    def as_dict(self) -> dict[str, Any]:
        """As `result.json` holds it."""
        return asdict(self)


class Pair(NamedTuple):
    """Two models that a push is to tell apart."""

    names: tuple[str, str]
    """their effects; "plain" is the model without any"""
    truth: Fits
    """the model that is taken for the truth, an ensemble of one"""
    other: Fits
    """an ensemble of one, with its answers to the data"""


def hide_effects(task: EnsembleTask, fits: Fits, effects: Sequence[str]) -> list[Pair]:
    """Pair each of the `effects`, as large as is typical and hidden in the data by what else is
    free, with the fit `fits` (an ensemble of one) that has none of them."""
    coordinates, there = task.model.coordinates, []
    for effect in effects:
        c = fits.c.copy()
        names = numbers_of(effect)
        typical = {n: _TYPICAL_RATIO if effect == RATIO else KEYS[n][1].typical for n in names}
        c[0, coordinates.indices(names)] = coordinates.point(typical)
        there.append(replace(fits, c=c, gram=None, residual=None, damping=None))
    if not there:
        return []
    hidden = ensemble_refits.refit(task, ensemble.join(*there), _HIDING)
    return [Pair((effect, "plain"), hidden.pick(j), fits) for j, effect in enumerate(effects)]


def propose_pushes(data: DiagnosisData) -> tuple[StackedPushes, NDArray]:
    """Propose pushes: other speeds, a longer stroke, a heavier part, a long rest.

    They are repeated to be as many as the data, so that the same program follows them; the numbers
    of those that differ are returned, too.
    """
    old = data.task.model.pushes
    n = data.task.n
    v = np.asarray(old.velocity)
    speeds = np.unique([min(x * v.min(), v.max()) for x in _SPEEDS])
    m, s = float(np.median(old.mass)), float(np.median(old.stroke))
    ends = (speeds[0], speeds[-1])
    rows = [(x, m, s, 0.0) for x in speeds]
    rows += [(x, _HEAVIER * m, s, 0.0) for x in ends]
    rows += [(x, m, s, _LONG_REST) for x in ends]
    rows += [(x, m, 2 * s, 0.0) for x in ends] if np.isfinite(s) else []
    columns = np.array(rows)[np.arange(n) % len(rows)].T
    velocity, mass, stroke, rest = columns
    no_end = np.full(n, np.inf)
    whole = StackedPushes(velocity, mass, stroke, np.ones(n), rest, None, no_end)
    return whole, np.arange(min(n, len(rows)))


def plan_experiments(data: DiagnosisData, pairs: Sequence[Pair]) -> tuple[Experiment, ...]:
    """Choose for each pair the push that tells the two apart best, as far as any does."""
    new, some = propose_pushes(data)
    task = replace(data.task, condition=np.zeros(data.task.n, int))
    blank = new._replace(data=_make_blank_data(data, new))
    out = []
    for names, truth, other in pairs:
        seen = blank._replace(data=_read(task, blank, truth, some))
        apart = _separate(data.task, task, seen, other, some)
        known = np.isfinite(apart)
        if known.any():
            i = int(np.argmax(np.where(known, apart, -1.0)))
            stroke = float(new.stroke[i])
            out.append(
                Experiment(
                    separates=names,
                    velocity_m_per_s=float(new.velocity[i]),
                    mass_kg=float(new.mass[i]),
                    stroke_m=stroke if np.isfinite(stroke) else None,
                    rest_before_s=float(new.rest[i]),
                    separation=float(apart[i]),
                )
            )
    return tuple(out)


def _make_blank_data(data: DiagnosisData, new: StackedPushes) -> Any:
    """Return data of pushes that nobody has made: all numbers, or samples, are zero."""
    old = data.task.model.pushes.data
    n = data.task.n
    if data.reduction is None:
        _, weight = old
        typical = [np.median(x[x > 0]) if (x > 0).any() else 0.0 for x in weight.T]
        return np.zeros((n, 2)), np.tile(typical, (n, 1))
    recordings, details = data.reduction.recordings, data.reduction.details
    parts = [], []
    for v, stroke in zip(new.velocity, new.stroke, strict=True):
        stop = stroke / v if np.isfinite(stroke) else 10 * data.scales.travel / v
        end = stop + 2 * v / (data.scales.mu_s * _LEAST_DRAG) + _AFTER
        for part, channel, noise, beside in (
            (parts[0], recordings[0].force, details[0].noise_force, (0.0, stop)),
            (parts[1], recordings[0].position, details[0].noise_position, ()),
        ):
            blank = None
            if channel is not None:
                blank = Channel.of(np.zeros(int(end / channel.dt)), channel.dt, 0.0, channel.unit)
            part.append(make_uneven(blank, noise, (0.0, stop), beside, np.inf, end, _LONGEST))
    sizes = [(b.y.shape[1], b.t.shape[1]) for b in old]
    return tuple(pad_uneven(p, *size) for p, size in zip(parts, sizes, strict=True))


def _follow(
    task: EnsembleTask, pushes: StackedPushes, fits: Fits, some: NDArray
) -> tuple[EnsembleTask, Fits]:
    """Return the task with these pushes, and the fits' answers to them, each at the mean mu_s."""
    there = replace(task, model=replace(task.model, pushes=pushes))
    mean = fits.mu.mean(axis=1, keepdims=True)
    at = replace(fits, mu=mean, own=np.zeros_like(fits.own), gram=None, residual=None)
    return there, ensemble.evaluate(there, at, some)


def _read(task: EnsembleTask, blank: StackedPushes, truth: Fits, some: NDArray) -> Any:
    """Return what the model `truth` reads of the pushes, as data in the place of `blank`'s."""
    _, at = _follow(task, blank, truth, some)
    r = at.residual[0]
    if not task.model.recordings:
        weight = blank.data[1]
        return -r[:, :, 0] / np.where(weight > 0, weight, 1.0), weight
    return tuple(
        blocks._replace(y=_undo_whitening(blocks, -r[:, k])) for k, blocks in enumerate(blank.data)
    )


def _undo_whitening(blocks: UnevenBlocks, white: NDArray) -> NDArray:
    """Return the (n, m) values whose whitened ones are `white`."""
    out = np.zeros_like(white)
    before = np.zeros(len(white))
    for j in range(white.shape[1]):
        a, b = blocks.a[:, j], blocks.b[:, j]
        before = np.where(a > 0, (white[:, j] + b * before) / np.where(a > 0, a, 1.0), 0.0)
        out[:, j] = before
    return out


def _separate(
    given: EnsembleTask, task: EnsembleTask, seen: StackedPushes, other: Fits, some: NDArray
) -> NDArray:
    """Return how far the other model stays from what was seen of each push (n,), in standard
    deviations, once it has been fitted to the push and to the data `given`."""
    known = ensemble.normal_equations(given, other)
    there, at = _follow(task, seen, other, some)
    gram = np.einsum("nkij,k->nij", at.gram[0], 1.0 / other.spread[0] ** 2)
    out = np.full(there.n, np.nan)
    for i in some:
        if gram[i, -1, -1] < ensemble.REJECTED:
            left = _fit_to_one_more(gram[i], known.H[0], given.conditions, other.scatter[0])
            out[i] = np.sqrt(max(left, 0.0))
    return out


def _fit_to_one_more(G: NDArray, known: NDArray, conditions: int, scatter: float) -> float:
    """Return what is left of the squares of a push once the model has been fitted, in one step, to
    it and to the data.

    `G` (D + 1, D + 1) is the push's Gram matrix, its residual last; `known` (P, P) is the data's
    information on the conditions' mu_s and the shared parameters.
    """
    D = len(G) - 1
    # The push's own mu_s, then the conditions' (of which it has the mean), then the shared.
    S = np.zeros((D, 1 + conditions + D - 1))
    S[0, 0], S[0, 1 : 1 + conditions] = 1.0, 1.0 / conditions
    S[1:, 1 + conditions :] = np.eye(D - 1)
    H, g = S.T @ G[:D, :D] @ S, S.T @ G[:D, -1]
    H[0, 0] += 1.0 / scatter**2
    size = len(known)
    H[1 : 1 + size, 1 : 1 + size] += known[: len(H) - 1, : len(H) - 1]
    scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
    solve = np.linalg.pinv(H / np.outer(scale, scale), rcond=1e-12)
    return float(G[-1, -1] - (g / scale) @ solve @ (g / scale))
