"""Where a fit misses: by phase of the push, over speed, position, time since contact, order and
condition, for each channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.data import DiagnosisData
from difffric.estimation.block_means import UnevenBlocks
from difffric.estimation.ensembles.ensemble import Fits
from difffric.measurements.reduction.reduce import Reduced, Reduction
from difffric.units import to_mm_min

PHASES = ("stuck", "closing", "rebounding", "free", "at rest")
_STUCK, _CLOSING, _REBOUNDING, _FREE, _AT_REST = range(len(PHASES))
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
    """the quantity, as a person reads it"""
    unit: str
    """of the quantity; empty where it has none"""
    at: tuple[str, ...] | tuple[float, ...]
    """names, or the middles of bins"""
    numbers: NDArray
    """how many there are in each"""
    before: NDArray
    """what the plain model leaves"""
    after: NDArray
    """what the model with its causes leaves"""

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
    """All squared residuals (N,) of one channel, those of one push after those of another."""

    name: str
    before: NDArray
    """without the causes"""
    after: NDArray
    """with them"""
    push: NDArray
    """number of each one's push"""
    phase: NDArray | None = None
    """numbers of `PHASES`; None: a table says nothing of phases"""
    x: NDArray | None = None
    """how far the part is from its start [m]"""
    since: NDArray | None = None
    """time since contact [s]"""


class _PushCourse(NamedTuple):
    """A push as it was measured, at the times of the blocks of both channels."""

    t: NDArray
    """[s]"""
    phase: NDArray
    """numbers of `PHASES`"""
    x: NDArray
    """how far the part is from its start [m]; NaN where no position was recorded"""
    onsets: NDArray
    """times [s] at which the tip came into contact"""

    def time_since_contact(self, t: NDArray) -> NDArray:
        """Return the times [s] that have passed at `t` since the last contact before."""
        last = np.clip(np.searchsorted(self.onsets, t, side="right") - 1, 0, None)
        return t - self.onsets[last]


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
    total = sum(float((one.numbers * np.maximum(one.before - 1, 0)).sum()) for one in phases)
    numbers = sum(float(one.numbers.sum()) for one in phases)
    if total < 0.1 * numbers:
        return None
    most, words = _find_largest(phases, [one.before for one in phases])
    return f"The largest part, {100 * most / total:.0f} %, is in {words}."


def describe_remaining(found: Sequence[Misfit]) -> str:
    """Say in words where most of what is left with the causes sits: in which channel and phase, or,
    of a table, at which speed."""
    by = "phase" if any(one.by == "phase" for one in found) else "speed"
    mine = [one for one in found if one.by == by]
    return _find_largest(mine, [one.after for one in mine])[1]


def _find_largest(found: Sequence[Misfit], left: Sequence[NDArray]) -> tuple[float, str]:
    """Return the largest excess over the noise of any group, and the group in words; `left` are
    the squared residuals per number of each of `found`."""
    excess = [one.numbers * (x - 1) for one, x in zip(found, left, strict=True)]
    k = int(np.argmax([x.max() for x in excess]))
    j = int(np.argmax(excess[k]))
    at, most = found[k].at[j], float(excess[k][j])
    if isinstance(at, str):
        while_ = {"free": "slides free", "at rest": "is at rest", "stuck": "is stuck"}
        words = while_.get(at, f"is in contact, {at}")
        return most, f"the {found[k].channel} while the part {words}"
    return most, f"the {found[k].channel} at {to_mm_min(at):.0f} mm/min"


def _collect_residuals(data: DiagnosisData, plain: Fits, extended: Fits) -> list[_ChannelResiduals]:
    """Collect the squared residuals, in units of the noise, of each channel that was measured."""
    if data.reduction is None:
        return _collect_from_table(data, plain, extended)
    return _collect_from_recordings(data, data.reduction, plain, extended)


def _square_residuals(fits: Fits) -> NDArray:
    """Return the (n, 2, blocks) squared residuals of an ensemble of one."""
    return (fits.residual[0] / fits.spread[0][None, :, None]) ** 2


def _collect_from_table(
    data: DiagnosisData, plain: Fits, extended: Fits
) -> list[_ChannelResiduals]:
    """Collect the squared residuals of each push's F_p and d, or of its own mu_s."""
    task, out = data.task, []
    before, after = _square_residuals(plain), _square_residuals(extended)
    for k, name in enumerate((FORCE, DISTANCE)):
        mine = np.flatnonzero(task.counts[:, k])
        # A mu_s of each push takes up its distance: what it takes stands below.
        if len(mine) and (name == FORCE or not task.mu_free):
            out.append(_ChannelResiduals(name, before[mine, k, 0], after[mine, k, 0], mine))
    if task.mu_free:
        before, after = ((fits.own[0] / fits.scatter[0]) ** 2 for fits in (plain, extended))
        out.append(_ChannelResiduals(FRICTION, before, after, np.arange(task.n)))
    return out


def _collect_from_recordings(
    data: DiagnosisData, reduction: Reduction, plain: Fits, extended: Fits
) -> list[_ChannelResiduals]:
    """Collect the squared residuals of each block of the samples, and where in its push it is."""
    squares, out = (_square_residuals(plain), _square_residuals(extended)), []
    courses = [_follow_course(data, i, reduced) for i, reduced in enumerate(reduction.details)]
    for k, name in enumerate((FORCE, POSITION)):
        blocks = data.task.model.pushes.data[k]
        parts = []
        for i, course in enumerate(courses):
            there = blocks.a[i] > 0
            if there.any():
                t = _find_middles(blocks, i)[there]
                nearest = np.clip(np.searchsorted(course.t, t), 0, len(course.t) - 1)
                parts.append(
                    (
                        *(s[i, k][there] for s in squares),
                        np.full(there.sum(), i),
                        course.phase[nearest],
                        np.interp(t, course.t, course.x),
                        course.time_since_contact(t),
                    )
                )
        if parts:
            columns = (np.concatenate(column) for column in zip(*parts, strict=True))
            out.append(_ChannelResiduals(name, *columns))
    return out


def _find_middles(blocks: UnevenBlocks, i: int) -> NDArray:
    """Return the (m,) middles of a push's blocks [s]."""
    return 0.5 * (blocks.t[i][blocks.first[i]] + blocks.t[i][blocks.second[i]])


def _follow_course(data: DiagnosisData, i: int, reduced: Reduced) -> _PushCourse:
    """Follow push i from what was measured of its force and position."""
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
    phase = np.where(np.nan_to_num(u) > v, _REBOUNDING, _CLOSING)
    phase[np.isfinite(u) & (u < _STILL * v)] = _STUCK
    phase[~touching] = _FREE
    rest = reduced.rest_time if np.isfinite(reduced.rest_time) else np.inf
    phase[(t >= rest) | (t < 0)] = _AT_REST
    return _PushCourse(t, phase, x, np.array([*reduced.onsets] or [0.0]))


def _group_by_name(
    one: _ChannelResiduals, by: str, number: NDArray, names: Sequence[str]
) -> Misfit:
    """Average the residuals of a channel for each of `names` that occurs; `number` (N,) says which
    one each residual belongs to."""
    there = [k for k in range(len(names)) if (number == k).any()]
    masks = [number == k for k in there]
    return _average_groups(one, by, "", tuple(names[k] for k in there), masks)


def _group_by_value(one: _ChannelResiduals, by: str, unit: str, value: NDArray) -> Misfit:
    """Average the residuals of a channel over ranges of a quantity, whose `value` (N,) each has."""
    distinct = np.unique(value[np.isfinite(value)])
    if len(distinct) <= _BINS:
        edges = np.append(distinct, np.inf)
    else:
        edges = np.unique(np.quantile(value[np.isfinite(value)], np.linspace(0, 1, _BINS + 1)))
        edges[-1] = np.inf
    masks = [(value >= low) & (value < high) for low, high in pairwise(edges)]
    masks = [mask for mask in masks if mask.any()]
    middles = tuple(float(np.median(value[mask])) for mask in masks)
    return _average_groups(one, by, unit, middles, masks)


def _average_groups(
    one: _ChannelResiduals,
    by: str,
    unit: str,
    at: tuple[str, ...] | tuple[float, ...],
    masks: Sequence[NDArray],
) -> Misfit:
    """Average the residuals of a channel within each of the masks (N,)."""
    numbers = np.array([mask.sum() for mask in masks])
    before = np.array([one.before[mask].mean() for mask in masks])
    after = np.array([one.after[mask].mean() for mask in masks])
    return Misfit(one.name, by, unit, at, numbers, before, after)
