"""A sample of a rig's pushes for its diagnosis, spread over dates and speeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.errors import InputError
from difffric.fleet.archive import ArchiveFile
from difffric.measurements.load_file import load
from difffric.measurements.pushes import COLUMNS, Pushes
from difffric.measurements.recordings import Recording, Recordings

MOST = 40
"""Pushes of a rig that are looked at: a diagnosis takes time in proportion to them."""
MOST_FILES = 60
"""Files of a rig that are opened: more than `MOST`, as some files hold no good push."""


@dataclass(frozen=True)
class Sample:
    """Some of a rig's pushes, in the order of their pushing."""

    data: Pushes | Recordings
    files: int
    """that it comes from"""
    notes: tuple[str, ...]
    """what was left out, and why"""


def sample(
    sources: Sequence[ArchiveFile], most: int = MOST, channels: Mapping[str, str] | None = None
) -> Sample:
    """Choose at most `most` pushes of one rig's files, the same ones each time.

    A diagnosis takes one kind of data: recordings where there are any, else tables. Of many files
    those evenly spread over their dates are opened; of many pushes those evenly spread over time at
    each speed are kept, the speeds in turn. `channels`: what the files call what we call otherwise.

    Raises `InputError` where no file can be used.
    """
    ordered = sorted(sources, key=lambda s: (s.changed, s.name))
    kind = ".tdms" if any(s.path.lower().endswith(".tdms") for s in ordered) else ".csv"
    mine = [s for s in ordered if s.path.lower().endswith(kind)]
    notes = []
    if len(mine) < len(ordered):
        notes.append("tables are left out: recordings say more")
    opened = [mine[i] for i in spread_evenly(len(mine), MOST_FILES)]
    if len(opened) < len(mine):
        notes.append(f"{len(opened)} of {len(mine)} files are looked at")
    parts, problems = [], []
    for source in opened:
        try:
            part: Any = load(source.path, skip_bad=True, channels=channels)
        except InputError as error:
            problems.append(f"{source.name}: {' '.join(str(error).split())}")
            continue
        parts.append(part)
        problems += [f"{source.name}: {line}" for line in part.skipped]
    if not parts:
        raise InputError(f"no file can be used: {problems[0]}")
    if kind == ".csv":
        pushed = [p for p in parts if not p.free_slides]
        if pushed and len(pushed) < len(parts):
            notes.append(f"{len(parts) - len(pushed)} tables of free slides are left out")
        parts = pushed or parts
    whole = parts[0] if len(parts) == 1 else _join(parts)
    keep = choose_over_speeds(_read_speeds(whole), most)
    if len(keep) < len(whole):
        notes.append(f"{len(keep)} of {len(whole)} pushes are looked at")
    return Sample(whole.select(keep), len(parts), (*notes, *problems))


def spread_evenly(n: int, most: int) -> NDArray:
    """Choose at most `most` of the indices 0 to n - 1, evenly spread, first and last among them."""
    return np.arange(n) if n <= most else np.unique(np.linspace(0, n - 1, most).round().astype(int))


def choose_over_speeds(v: NDArray, most: int) -> NDArray:
    """Choose at most `most` of n pushes by their speeds v (n,) and return their indices, sorted.

    Each speed gets as equal a share as may be, evenly spread over the order of its pushes. Where
    there are more speeds than `most`, evenly spread ones are taken.
    """
    if len(v) <= most:
        return np.arange(len(v))
    speeds = np.unique(np.round(v, 9))
    speeds = speeds[spread_evenly(len(speeds), most)]
    groups = [np.flatnonzero(np.round(v, 9) == x) for x in speeds]
    share = np.zeros(len(groups), int)
    while share.sum() < most and any(share[i] < len(g) for i, g in enumerate(groups)):
        for i in sorted(range(len(groups)), key=lambda i: (share[i], i)):
            if share[i] < len(groups[i]) and share.sum() < most:
                share[i] += 1
    chosen = [
        g[spread_evenly(len(g), int(s))] if s > 1 else g[:s]
        for g, s in zip(groups, share, strict=True)
    ]
    return np.sort(np.concatenate(chosen))


def _read_speeds(data: Pushes | Recordings) -> NDArray:
    """The speed of each push (n,) [m/s], of a free slide its speed at release."""
    if isinstance(data, Recordings):
        return np.array([push.velocity for push in data])
    return np.asarray(data.release_velocity if data.free_slides else data.velocity)


def _join(parts: Sequence[Any]) -> Any:
    """Put the pushes of several files of one kind together: the files one after the other, the
    pushes of each in its own order."""
    if isinstance(parts[0], Recordings):
        pushes = [push for part in parts for push in _in_order(part, [p.order for p in part])]
        numbered = tuple(replace(push, order=float(i)) for i, push in enumerate(pushes))
        return replace(parts[0], pushes=numbered, source="", skipped=())
    ordered = [p.select(_find_order(p.order)) for p in parts]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(p, name) for p in ordered])
        for name in COLUMNS
        if name not in ("condition", "order")
    }
    condition = [x for p in ordered for x in p.condition]
    return Pushes(**columns, condition=condition, order=np.arange(len(condition), dtype=float))


def _find_order(order: ArrayLike) -> NDArray:
    """Indices that sort pushes by their `order`; as they stand where some have none."""
    x = np.asarray(order, float)
    return np.argsort(x, kind="stable") if np.isfinite(x).all() else np.arange(len(x))


def _in_order(part: Recordings, order: ArrayLike) -> list[Recording]:
    return [part.pushes[i] for i in _find_order(order)]
