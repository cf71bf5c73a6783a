"""Where a fit misses: by phase of the push, over speed, position, time since contact, order and
condition, for each channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.data import DiagnosisData
from difffric.estimation.block_means import UnevenBlocks
from difffric.estimation.ensemble import Fits
from difffric.measurements.reduction.reduce import Reduced

PHASES = ("stuck", "closing", "rebounding", "free", "at rest")
FORCE, POSITION, DISTANCE, FRICTION = "force", "position", "distance", "mu_s"
"""Channels; of a table, each push's mu_s in units of its scatter is one."""
_BINS = 8
"""Groups at most into which a quantity's values are divided."""
_SMOOTH = 5
"""Blocks over which the part's speed is taken."""
_NO_FORCE = 0.01
"""Share of F_p below which the tip does not touch the part."""
_STILL = 0.02
"""Share of the pusher's speed below which the part does not move."""


@dataclass(frozen=True)
class Misfit:
    """Squared residuals per number, in units of the noise (1 is perfect), over one quantity."""

    channel: str
    by: str
    unit: str
    at: tuple[str, ...] | tuple[float, ...]
    """names, or the middles of bins"""
    numbers: NDArray
    """how many there are in each"""
    before: NDArray
    after: NDArray

    def as_dict(self) -> dict[str, Any]:
        """As `result.json` holds it."""
        return {
            "channel": self.channel,
            "by": self.by,
            "unit": self.unit,
            "at": list(self.at),
            "numbers": self.numbers.tolist(),
            "before": self.before.tolist(),
            "after": self.after.tolist(),
        }


@dataclass(frozen=True)
class _ChannelResiduals:
    """All squared residuals of one channel, one after the other."""

    name: str
    before: NDArray
    after: NDArray
    """squared residuals"""
    push: NDArray
    phase: Any = None
    """numbers of `PHASES`; None: a table says nothing of phases"""
    x: Any = None
    """from the start [m]"""
    since: Any = None
    """time since contact [s]"""


def measure_misfits(data: DiagnosisData, plain: Fits, extended: Fits) -> tuple[Misfit, ...]:
    """Measure what two fits (ensembles of one), without and with the causes, leave, and where."""
    channels = _collect_residuals(data, plain, extended)
    measured, out = data.measured, []
    conditions = list(dict.fromkeys(measured.condition))
    order = measured.order if np.isfinite(measured.order).all() else np.arange(len(measured)) + 1.0
    kind = np.array([conditions.index(c) for c in measured.condition])
    for one in channels:
        if one.phase is not None:
            out.append(_group_by_name(one, "phase", one.phase, PHASES))
        out.append(_group_by_value(one, "speed", "m/s", np.asarray(measured.velocity)[one.push]))
        if one.x is not None and np.isfinite(one.x).any():
            out.append(_group_by_value(one, "position", "m", one.x))
        if one.since is not None:
            out.append(_group_by_value(one, "time since contact", "s", one.since))
        out.append(_group_by_value(one, "order", "", order[one.push]))
        if len(conditions) > 1:
            out.append(_group_by_name(one, "condition", kind[one.push], conditions))
    return tuple(out)


def describe_misfits(found: Sequence[Misfit]) -> str | None:
    """Say in words where most of the misfit sits; None where there is none to speak of."""
    phases = [one for one in found if one.by == "phase"]
    if not phases:
        return None
    excess = {
        (one.channel, str(name)): float(n * (before - 1))
        for one in phases
        for name, n, before in zip(one.at, one.numbers, one.before, strict=True)
    }
    total = sum(max(x, 0.0) for x in excess.values())
    numbers = sum(float(one.numbers.sum()) for one in phases)
    (channel, phase), most = max(excess.items(), key=lambda item: item[1])
    if total < 0.1 * numbers:
        return None
    while_ = {"free": "slides free", "at rest": "is at rest", "stuck": "is stuck"}
    words = while_.get(phase, f"is in contact, {phase}")
    return (
        f"The largest part, {100 * most / total:.0f} %, is in the {channel} while the part {words}."
    )


def _collect_residuals(data: DiagnosisData, plain: Fits, extended: Fits) -> list[_ChannelResiduals]:
    task = data.task
    squares = [
        (fits.residual[0] / fits.spread[0][None, :, None]) ** 2 for fits in (plain, extended)
    ]
    if data.reduction is None:
        out = []
        for k, name in enumerate((FORCE, DISTANCE)):
            mine = np.flatnonzero(task.counts[:, k])
            # A mu_s of each push takes up its distance: what it takes stands below.
            if len(mine) and (name == FORCE or not task.mu_free):
                out.append(
                    _ChannelResiduals(name, squares[0][mine, k, 0], squares[1][mine, k, 0], mine)
                )
        if task.mu_free:
            before, after = ((fits.own[0] / fits.scatter[0]) ** 2 for fits in (plain, extended))
            out.append(_ChannelResiduals(FRICTION, before, after, np.arange(task.n)))
        return out
    out = []
    course = [_follow_course(data, i, reduced) for i, reduced in enumerate(data.reduction.details)]
    for k, name in enumerate((FORCE, POSITION)):
        blocks = task.model.pushes.data[k]
        parts = []
        for i, (t, phase, x, since) in enumerate(course):
            there = blocks.a[i] > 0
            if there.any():
                at = _find_middles(blocks, i)[there]
                nearest = np.clip(np.searchsorted(t, at), 0, len(t) - 1)
                parts.append(
                    (*(s[i, k][there] for s in squares), np.full(there.sum(), i),
                     phase[nearest], np.interp(at, t, x), at - since(at))
                )  # fmt: skip
        if parts:
            columns = (np.concatenate(column) for column in zip(*parts, strict=True))
            out.append(_ChannelResiduals(name, *columns))
    return out


def _find_middles(blocks: UnevenBlocks, i: int) -> NDArray:
    """Return the (m,) middles of a push's blocks [s]."""
    return 0.5 * (blocks.t[i][blocks.first[i]] + blocks.t[i][blocks.second[i]])


def _follow_course(data: DiagnosisData, i: int, reduced: Reduced):
    """Follow push i from what was measured: the times of its blocks [s], the number of its phase
    there, how far the part is from its start [m], and a function from times to the last contact
    before them."""
    force, position = data.task.model.pushes.data
    v = float(np.asarray(data.measured.velocity)[i])
    there = [blocks.a[i] > 0 for blocks in (force, position)]
    both = zip((force, position), there, strict=True)
    t = np.sort(np.concatenate([_find_middles(blocks, i)[mine] for blocks, mine in both]))
    x, u = np.full(len(t), np.nan), np.full(len(t), np.nan)
    if there[1].sum() > _SMOOTH:
        tx, y = _find_middles(position, i)[there[1]], position.y[i][there[1]]
        before = y[tx <= 0]
        y = y - (before.mean() if len(before) else y[0])
        smooth = np.ones(_SMOOTH) / _SMOOTH
        mid = slice(_SMOOTH // 2, -(_SMOOTH // 2))
        ty, slope = tx[mid], np.gradient(np.convolve(y, smooth, "valid"), tx[mid])
        x, u = np.interp(t, tx, y), np.interp(t, ty, slope)
    touching = t < (reduced.release_time if np.isfinite(reduced.release_time) else np.inf)
    if there[0].any():
        f = np.interp(t, _find_middles(force, i)[there[0]], force.y[i][there[0]])
        touching &= f > _NO_FORCE * np.max(f)
    phase = np.where(np.nan_to_num(u) > v, 2, 1)
    phase[np.isfinite(u) & (u < _STILL * v)] = 0
    phase[~touching] = 3
    rest = reduced.rest_time if np.isfinite(reduced.rest_time) else np.inf
    phase[(t >= rest) | (t < 0)] = 4
    onsets = np.array([*reduced.onsets] or [0.0])

    def last(at):
        return onsets[np.clip(np.searchsorted(onsets, at, side="right") - 1, 0, None)]

    return t, phase, x, last


def _group_by_name(
    one: _ChannelResiduals, by: str, number: NDArray, names: Sequence[str]
) -> Misfit:
    there = [k for k in range(len(names)) if (number == k).any()]
    return _average_groups(
        one, by, "", tuple(names[k] for k in there), [number == k for k in there]
    )


def _group_by_value(one: _ChannelResiduals, by: str, unit: str, value: NDArray) -> Misfit:
    distinct = np.unique(value[np.isfinite(value)])
    if len(distinct) <= _BINS:
        edges = np.append(distinct, np.inf)
    else:
        edges = np.unique(np.quantile(value[np.isfinite(value)], np.linspace(0, 1, _BINS + 1)))
        edges[-1] = np.inf
    masks = [(value >= low) & (value < high) for low, high in pairwise(edges)]
    masks = [mask for mask in masks if mask.any()]
    return _average_groups(one, by, unit, tuple(float(np.median(value[m])) for m in masks), masks)


def _average_groups(one: _ChannelResiduals, by: str, unit: str, at, masks) -> Misfit:
    numbers = np.array([mask.sum() for mask in masks])
    before, after = (
        np.array([x[mask].mean() for mask in masks]) for x in (one.before, one.after)
    )  # fmt: skip
    return Misfit(one.name, by, unit, at, numbers, before, after)
