"""mu_s of many pushes of many rigs, as columns: what `identify` says of each push from F_p and d.

`identify` makes an object a push. Here rigs of one kind (the same laws, the same calibrated
parameters) go through the same compiled programs together, in chunks of a fixed size, and their
estimates are combined as arrays. No push's answer depends on those beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from difffric.compute.pytrees import map_tree
from difffric.estimation.push_rigs import make_push_rigs
from difffric.identification.combination import Combination, combine
from difffric.identification.free_slide import estimate_by_slides
from difffric.identification.inversion import Inversion
from difffric.identification.resolved_pushes import Calibration, ResolvedPushes
from difffric.measurements.pushes import Pushes
from difffric.rig.setup import Setup

CHUNK = 256
"""Pushes that a program takes at a time: always so many, so that one program serves all."""

BY_PUSH = ("mu_s_force", "mu_s_distance", "mu_s_weighted", "mu_s_optimal")
"""The ways to mu_s from F_p and d."""
ESTIMATES = (*BY_PUSH, "mu_s_slide")
SCHEMA = {
    "mu_s": pl.Float64,
    "mu_s_se": pl.Float64,
    **{f"{way}{end}": pl.Float64 for way in ESTIMATES for end in ("", "_se")},
    "weight_force": pl.Float64,
    "disagreement": pl.Float64,
    "alternatives": pl.List(pl.Float64),
    "regime": pl.String,
    "reason": pl.String,
}
"""The columns, null where there is no value."""


def identify_columns(
    parts: Sequence[tuple[Setup, Pushes]], compiled: bool = False
) -> list[pl.DataFrame]:
    """Identify the pushes of many rigs, each given as its set-up and its pushes; by compiled
    programs where it is said, or where NumPy does not serve (`PushModels`).

    Returns for each a table of the columns `SCHEMA`, a row a push. The pushes must be such as
    `check_data` lets pass.
    """
    kinds: dict[tuple, list[int]] = {}
    for i, (setup, pushes) in enumerate(parts):
        kinds.setdefault((_find_kind(setup, pushes), pushes.free_slides), []).append(i)
    out: dict[int, pl.DataFrame] = {}
    for indices in kinds.values():
        whole = _identify_kind([parts[i] for i in indices], compiled)
        start = 0
        for i in indices:
            out[i] = whole.slice(start, len(parts[i][1]))
            start += len(parts[i][1])
    return [out[i] for i in range(len(parts))]


def _find_kind(setup: Setup, pushes: Pushes) -> tuple:
    """Return what decides which programs serve a rig's pushes: its laws, whether there are strokes,
    and the calibrated parameters."""
    rigs = make_push_rigs(setup.rig, pushes.select(slice(0, 1)) if len(pushes) else pushes)
    stroke = setup.rig.pusher.stroke is not None or bool(np.isfinite(pushes.stroke).any())
    structure = map_tree(lambda number: 0.0, rigs)
    return structure, stroke, Calibration.read(setup).names


def _identify_kind(parts: Sequence[tuple[Setup, Pushes]], compiled: bool) -> pl.DataFrame:
    """Identify the pushes of rigs of one kind, in one table, one rig's after the other's."""
    resolved = ResolvedPushes.join(
        [
            ResolvedPushes.of(Calibration.read(setup), pushes, compiled=compiled)
            for setup, pushes in parts
        ]
    )
    found = (
        _fill_nothing(len(resolved)) if resolved.pushes.free_slides else _estimate_by_push(resolved)
    )
    mu, se = _estimate_by_slide(resolved)
    found |= {"mu_s_slide": mu, "mu_s_slide_se": se}
    by_push = np.isfinite(found["mu_s_optimal"])
    found["mu_s"] = np.where(by_push, found["mu_s_optimal"], mu)
    found["mu_s_se"] = np.where(by_push, found["mu_s_optimal_se"], se)
    if resolved.pushes.free_slides:
        found["reason"] = [None if np.isfinite(x) else "no mu_s gives this free slide" for x in mu]
    table = pl.DataFrame(found, schema_overrides=SCHEMA, strict=False)
    return table.select(*SCHEMA).with_columns(pl.col(pl.Float64).fill_nan(None))


def _fill_nothing(n: int) -> dict[str, Any]:
    """Return the columns from F_p and d for n free slides, which say nothing of them."""
    numbers = [f"{way}{end}" for way in BY_PUSH for end in ("", "_se")]
    found: dict[str, Any] = dict.fromkeys(
        [*numbers, "weight_force", "disagreement"], np.full(n, np.nan)
    )
    return found | {"alternatives": [None] * n, "regime": [None] * n}


def _estimate_by_push(resolved: ResolvedPushes) -> dict[str, Any]:
    """Return the columns from F_p and d of each push."""
    combination = _combine_in_chunks(resolved, *resolved.invert())
    found: dict[str, Any] = {
        "weight_force": combination.weight_force,
        "disagreement": combination.disagreement,
        "alternatives": [list(x) or None for x in combination.alternatives],
        "regime": combination.regimes,
        "reason": combination.reasons,
    }
    for way in BY_PUSH:
        estimates = getattr(combination, way)
        found[way] = np.where(np.isfinite(estimates.value), estimates.value, np.nan)
        known = np.isfinite(found[way]) & np.isfinite(estimates.standard_error)
        found[f"{way}_se"] = np.where(known, estimates.standard_error, np.nan)
    return found


def _combine_in_chunks(
    resolved: ResolvedPushes, force: Sequence[Inversion], distance: Sequence[Inversion]
) -> Combination:
    """Combine force and distance, with the derivatives taken a chunk at a time."""
    gradients, regimes = [], []
    for index in _chunk(len(resolved)):
        two = [[found[i] for i in index] for found in (force, distance)]
        gradient, regime = resolved.pick(index).differentiate(*two)
        gradients.append(gradient)
        regimes += regime
    n = len(resolved)
    return combine(resolved, force, distance, np.concatenate(gradients)[:n], regimes[:n])


def _chunk(n: int) -> Iterator[NDArray]:
    """Yield the indices of n pushes, `CHUNK` at a time, the last one repeated to fill."""
    for start in range(0, n, CHUNK):
        yield np.minimum(np.arange(start, start + CHUNK), n - 1)


def _estimate_by_slide(resolved: ResolvedPushes) -> tuple[NDArray, NDArray]:
    """Return mu_s and its standard errors (n,) from release speed and d alone, NaN where there is
    none."""
    n, parts = len(resolved), []
    for index in _chunk(n):
        found = estimate_by_slides(resolved.pick(index))
        nothing = np.full(CHUNK, np.nan)
        parts.append((nothing, nothing) if found is None else (found.value, found.standard_error))
    mu, se = (np.concatenate(columns)[:n] for columns in zip(*parts, strict=True))
    return mu, se
