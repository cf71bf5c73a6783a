"""The push that would tell two explanations apart, or show an effect that these data do not.

One explanation is taken for the truth; the other is refitted, in one step, to the data there are
and to the new push. What is left of their difference is how far they would be apart, in standard
deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.data import DiagnosisData
from difffric.estimation import ensemble as en
from difffric.estimation.blocks import Blocks, blocks_of, stacked
from difffric.estimation.ensemble import Fits, Task
from difffric.estimation.extended_model import Pushes
from difffric.measurements.recordings import Channel
from difffric.units import to_mm, to_mm_min

_SPEEDS = (0.6, 1.0, 2.0, 4.0, 10.0)
"""Times the slowest, up to the fastest."""
_LONGEST = 2.5e-3
"""Of a block [s]: how fine a push is looked at that nobody has made yet."""


@dataclass(frozen=True)
class Experiment:
    """One push and what it would tell."""

    separates: tuple[str, ...]
    """the effects; "plain" is the model without any of them"""
    velocity_m_per_s: float
    mass_kg: float
    stroke_m: float | None
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


def designs(data: DiagnosisData) -> tuple[Pushes, NDArray]:
    """The pushes that are thought of: other speeds, a longer stroke, a heavier part, a long rest.
    Repeated to be as many as the data, so that the same program follows them; and the numbers of
    those that differ."""
    old = data.task.model.pushes
    n = data.task.n
    v = np.asarray(old.velocity)
    speeds = np.unique([min(x * v.min(), v.max()) for x in _SPEEDS])
    mass, stroke = float(np.median(old.mass)), float(np.median(old.stroke))
    long = stroke * 2 if np.isfinite(stroke) else stroke
    ends = (speeds[0], speeds[-1])
    rows = [(x, mass, stroke, 0.0) for x in speeds]
    rows += [(x, 1.5 * mass, stroke, 0.0) for x in ends]
    rows += [(x, mass, stroke, 1000.0) for x in ends]
    rows += [(x, mass, long, 0.0) for x in ends] if np.isfinite(stroke) else []
    columns = np.array(rows)[np.arange(n) % len(rows)].T
    whole = Pushes(columns[0], columns[1], columns[2], np.ones(n), columns[3], None)
    return whole, np.arange(min(n, len(rows)))


def next_experiment(
    data: DiagnosisData, pairs: Sequence[tuple[tuple[str, str], Fits, Fits]]
) -> tuple[Experiment, ...]:
    """The best push for each pair: its names, the model taken for the truth, and the other (each
    an ensemble of one, the other with its answers to the data)."""
    new, some = designs(data)
    task = replace(data.task, condition=np.zeros(data.task.n, int))
    empty = new._replace(data=_empty(data, new))
    out = []
    for names, truth, other in pairs:
        told = _seen(task, empty, truth, some)
        apart = _apart(data.task, task, empty._replace(data=told), other, some)
        known = np.isfinite(apart)
        if known.any():
            i = int(np.argmax(np.where(known, apart, -1.0)))
            stroke = float(new.stroke[i])
            out.append(
                Experiment(
                    names, float(new.velocity[i]), float(new.mass[i]),
                    stroke if np.isfinite(stroke) else None, float(new.rest[i]), float(apart[i]),
                )
            )  # fmt: skip
    return tuple(out)


def _empty(data: DiagnosisData, new: Pushes) -> Any:
    """The samples of pushes that nobody has made: all of them zero."""
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
        decay = data.scales.mu_s * 0.5 * 9.8
        end = stop + 2 * v / decay + 5e-3
        for part, channel, noise, beside in (
            (parts[0], recordings[0].force, details[0].noise_force, (0.0, stop)),
            (parts[1], recordings[0].position, details[0].noise_position, ()),
        ):
            blank = None
            if channel is not None:
                blank = Channel.of(np.zeros(int(end / channel.dt)), channel.dt, 0.0, channel.unit)
            part.append(blocks_of(blank, noise, (0.0, stop), beside, np.inf, end, _LONGEST))
    sizes = [(b.y.shape[1], b.t.shape[1]) for b in old]
    return tuple(stacked(p, *size) for p, size in zip(parts, sizes, strict=True))


def _follow(task: Task, pushes: Pushes, fits: Fits, some: NDArray):
    """(the task with these pushes, the fits' answers to them, their own mu_s at the mean)."""
    there = replace(task, model=replace(task.model, pushes=pushes))
    mean = fits.mu.mean(axis=1, keepdims=True)
    at = replace(fits, mu=mean, own=np.zeros_like(fits.own), gram=None, residual=None)
    return there, en.evaluated(there, at, some)


def _seen(task: Task, empty: Pushes, truth: Fits, some: NDArray) -> Any:
    """What a model reads of the pushes, in the place of measurements."""
    _, at = _follow(task, empty, truth, some)
    r = at.residual[0]
    if not task.model.recordings:
        weight = empty.data[1]
        return -r[:, :, 0] / np.where(weight > 0, weight, 1.0), weight
    return tuple(
        blocks._replace(y=_unwhitened(blocks, -r[:, k])) for k, blocks in enumerate(empty.data)
    )


def _unwhitened(blocks: Blocks, white: NDArray) -> NDArray:
    """(n, m) what has these whitened values."""
    out = np.zeros_like(white)
    before = np.zeros(len(white))
    for j in range(white.shape[1]):
        a, b = blocks.a[:, j], blocks.b[:, j]
        before = np.where(a > 0, (white[:, j] + b * before) / np.where(a > 0, a, 1.0), 0.0)
        out[:, j] = before
    return out


def _apart(given: Task, task: Task, told: Pushes, other: Fits, some: NDArray) -> NDArray:
    """(n,) how far the other model stays from what is told of each push, in standard deviations,
    once it has been fitted to the push and to the data."""
    known = en.normal(given, other)
    there, at = _follow(task, told, other, some)
    G = np.einsum("nkij,k->nij", at.gram[0], 1.0 / other.spread[0] ** 2)
    C, D = given.conditions, G.shape[1] - 1
    out = np.full(there.n, np.nan)
    for i in some:
        if G[i, -1, -1] >= en.REJECTED:
            continue
        # The push's own mu_s, then the conditions' (of which it has the mean), then the shared.
        S = np.zeros((D, 1 + C + D - 1))
        S[0, 0], S[0, 1 : 1 + C] = 1.0, 1.0 / C
        S[1:, 1 + C :] = np.eye(D - 1)
        H, g = S.T @ G[i, :D, :D] @ S, S.T @ G[i, :D, -1]
        H[0, 0] += 1.0 / other.scatter[0] ** 2
        size = known.H.shape[1]
        H[1 : 1 + size, 1 : 1 + size] += known.H[0][: len(H) - 1, : len(H) - 1]
        scale = np.sqrt(np.maximum(np.diag(H), 1e-12))
        solve = np.linalg.pinv(H / np.outer(scale, scale), rcond=1e-12)
        left = G[i, -1, -1] - (g / scale) @ solve @ (g / scale)
        out[i] = np.sqrt(max(left, 0.0))
    return out
