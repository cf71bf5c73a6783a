"""mu_s of many pushes of many rigs, as columns: what `identify` says of each push from F_p and d.

`identify` makes an object a push. Here rigs of one kind (the same laws, the same calibrated
parameters) go through the same compiled programs together, in chunks of a fixed size, and their
estimates are combined as arrays. No push's answer depends on those beside it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np
import polars as pl
from numpy.typing import NDArray

from difffric.compute.precision import require_float64
from difffric.compute.pytrees import pick
from difffric.estimation.coordinates import to_value
from difffric.estimation.push_rigs import rigs_of
from difffric.estimation.stacked_data import sensor_errors
from difffric.identification.estimators import (
    Calibration,
    around,
    range_ratio_of,
    root_of,
    supported_by_force,
)
from difffric.identification.free_slide import slide_friction
from difffric.identification.inversion import BRACKET, invert
from difffric.identification.surrogates import weighted
from difffric.measurements.pushes import COLUMNS, Pushes
from difffric.rig.setup import Setup
from difffric.simulation.segments import default_integrator

CHUNK = 256
"""Pushes that a program takes at a time."""
_K_V = "k_v_N_s_per_m"
_NO_NOISE = "no optimum: the noise of F_p or of d is not known"

ESTIMATES = ("mu_s_force", "mu_s_distance", "mu_s_weighted", "mu_s_optimal", "mu_s_slide")
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


def friction(parts: Sequence[tuple[Setup, Pushes]]) -> list[pl.DataFrame]:
    """For each (set-up, its pushes) a table of `SCHEMA`, a row a push. The pushes are as
    `checked_data` lets them pass.

    Raises `InputError` where JAX is in 32-bit mode.
    """
    require_float64()
    kinds: dict[tuple, list[int]] = {}
    for i, (setup, pushes) in enumerate(parts):
        kinds.setdefault((_kind(setup, pushes), pushes.free_slides), []).append(i)
    out: dict[int, pl.DataFrame] = {}
    for indices in kinds.values():
        whole = _of_one_kind([parts[i] for i in indices])
        start = 0
        for i in indices:
            out[i] = whole.slice(start, len(parts[i][1]))
            start += len(parts[i][1])
    return [out[i] for i in range(len(parts))]


def _kind(setup: Setup, pushes: Pushes):
    """What decides which programs serve a rig's pushes."""
    rigs = rigs_of(setup.rig, pushes.select(slice(0, 1)) if len(pushes) else pushes)
    stroke = setup.rig.pusher.stroke is not None or bool(np.isfinite(pushes.stroke).any())
    return jax.tree.structure(rigs), stroke, Calibration.read(setup).names


def _of_one_kind(parts: Sequence[tuple[Setup, Pushes]]) -> pl.DataFrame:
    known = [Calibration.read(setup) for setup, _ in parts]
    names = known[0].names
    # NumPy's arrays: JAX's take a hundred times as long to index.
    rigs = [jax.tree.map(np.asarray, rigs_of(setup.rig, pushes)) for setup, pushes in parts]
    rigs = jax.tree.map(lambda *leaves: np.concatenate(leaves), *rigs)
    pushes = _joined([p for _, p in parts])
    which = np.repeat(np.arange(len(parts)), [len(p) for _, p in parts])
    roots = np.stack([root_of(x.of("")[1]) for x in known])
    integrator = default_integrator(known[0].rig)
    ratio = np.array([range_ratio_of(x.rig, integrator) for x in known])
    sensor = np.array([sensor_errors(x.rig) for x in known], float)
    return _columns(rigs, pushes, names, roots[which], ratio[which], sensor[which], integrator)


def _joined(parts: Sequence[Pushes]) -> Pushes:
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(p, name) for p in parts]) for name in COLUMNS
    }
    return Pushes(**columns)


def _columns(rigs, pushes: Pushes, names, roots, ratio, sensor, integrator) -> pl.DataFrame:
    """The columns of n pushes; roots (n, k, k), ratio (n,), sensor (n, 2)."""
    n = len(pushes)
    error = _error_of(pushes, sensor)
    found: dict[str, NDArray | list] = {}
    reasons = [None] * n
    if pushes.free_slides:
        nothing = np.full(n, np.nan)
        for way in ESTIMATES[:4]:
            found[way] = found[f"{way}_se"] = nothing
        found |= {"weight_force": nothing, "disagreement": nothing}
        found |= {"alternatives": [None] * n, "regime": [None] * n}
    else:
        force, distance, gradient, regimes = _inverted(rigs, pushes, names, integrator)
        value, slope = (
            np.array([[getattr(x, k) for x in xs] for xs in (force, distance)], float).T
            for k in ("value", "slope")
        )
        found |= _combined(value, slope, error, gradient, roots, ratio)
        found |= {"alternatives": [list(x.alternatives) or None for x in distance]}
        found |= {"regime": regimes}
        lost = np.isfinite(value).all(axis=1) & np.isnan(found["mu_s_optimal"])
        words = np.where(lost, _NO_NOISE, "")
        reasons = [
            "; ".join(r for r in (a.reason, b.reason, str(c)) if r) or None
            for a, b, c in zip(force, distance, words, strict=True)
        ]
    mu, se = _slides(rigs, pushes, error, names, roots)
    found |= {"mu_s_slide": mu, "mu_s_slide_se": se}
    by_push = np.isfinite(found["mu_s_optimal"])
    found["mu_s"] = np.where(by_push, found["mu_s_optimal"], mu)
    found["mu_s_se"] = np.where(by_push, found["mu_s_optimal_se"], se)
    if pushes.free_slides:
        reasons = [None if np.isfinite(x) else "no mu_s gives this free slide" for x in mu]
    table = pl.DataFrame({**found, "reason": reasons}, schema_overrides=SCHEMA, strict=False)
    return table.select(*SCHEMA).with_columns(pl.col(pl.Float64).fill_nan(None))


def _inverted(rigs, pushes: Pushes, names, integrator):
    options = {"bracket": BRACKET, "integrator": integrator}
    force = invert(rigs, pushes.velocity, pushes.peak_force, "peak_force", **options)
    distance = invert(rigs, pushes.velocity, pushes.sliding_distance, "sliding_distance", **options)
    distance = supported_by_force(rigs, pushes, distance, integrator)
    gradients, regimes = [], []
    for index in _chunks(len(pushes)):
        two = [[found[i] for i in index] for found in (force, distance)]
        some = pick(rigs, index), pushes.select(index)
        gradient, regime = around(*some, two[0], two[1], names, integrator)
        gradients.append(gradient)
        regimes += regime
    n = len(pushes)
    return force, distance, np.concatenate(gradients)[:n], regimes[:n]


def _chunks(n: int) -> Iterator[NDArray]:
    """Indices of n pushes, `CHUNK` at a time, the last one repeated to fill."""
    for start in range(0, n, CHUNK):
        yield np.minimum(np.arange(start, start + CHUNK), n - 1)


def _error_of(pushes: Pushes, sensor: NDArray) -> NDArray:
    """(n, 2) standard errors of F_p [N] and d [m]: the push's own, else its rig's sensors'."""
    own = np.stack([pushes.peak_force_se, pushes.sliding_distance_se], axis=1)
    return np.where(np.isnan(own), sensor, own)


def _combined(mu, slope, error, gradient, roots, ratio) -> dict[str, NDArray]:
    """Force, distance, (7) and generalised least squares: mu, slope, error (n, 2), gradient
    (n, 2, k), roots (n, k, k), ratio (n,). As `estimators.combine`, for all pushes."""
    with np.errstate(invalid="ignore", divide="ignore"):
        shared = -np.einsum("nij,njk->nik", gradient / slope[..., None], roots)
        covariance = np.einsum("nik,njk->nij", shared, shared)
        covariance[:, [0, 1], [0, 1]] += (error / slope) ** 2
        exists = np.isfinite(mu)
        both, alone = exists.all(axis=1), exists.any(axis=1)
        _, w_F, w_d = weighted(mu[:, 0], mu[:, 1], slope[:, 0], slope[:, 1], ratio)
        by_7 = np.where(both[:, None], np.stack([w_F, w_d], axis=1), np.nan)
        F, d, cross = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]
        apart = F + d - 2 * cross
        best = np.stack([(d - cross) / apart, (F - cross) / apart], axis=1)
        only = np.where(exists, 1.0, 0.0)
        best = np.where(both[:, None], best, np.where(alone[:, None], only, np.nan))
        out = {}
        for name, weights in (
            ("mu_s_force", np.broadcast_to([1.0, 0.0], mu.shape)),
            ("mu_s_distance", np.broadcast_to([0.0, 1.0], mu.shape)),
            ("mu_s_weighted", by_7),
            ("mu_s_optimal", best),
        ):
            used = weights != 0
            value = np.where(used, weights * mu, 0.0).sum(axis=1)
            both_used = used[:, :, None] & used[:, None, :]
            parts = weights[:, :, None] * weights[:, None, :] * covariance
            variance = np.where(both_used, parts, 0.0).sum(axis=(1, 2))
            out[name] = np.where(np.isfinite(value), value, np.nan)
            known = np.isfinite(value) & np.isfinite(variance)
            out[f"{name}_se"] = np.where(known, np.sqrt(variance), np.nan)
        out["weight_force"] = by_7[:, 0]
        out["disagreement"] = np.where(both, (mu[:, 0] - mu[:, 1]) / np.sqrt(apart), np.nan)
    return out


def _slides(rigs, pushes: Pushes, error, names, roots) -> tuple[NDArray, NDArray]:
    """(mu_s, standard errors) from release speed and d alone, NaN where there is none."""
    v, d = pushes.release_velocity, pushes.sliding_distance
    if not (np.isfinite(v) & np.isfinite(d)).any() or not rigs.friction.affine:
        return np.full(len(pushes), np.nan), np.full(len(pushes), np.nan)
    k_v = np.zeros(len(v))
    if _K_V in names:
        k_v = to_value(_K_V, np.linalg.norm(roots[:, names.index(_K_V)], axis=1))
    v_se = pushes.release_velocity_se
    v_se = np.where(np.isnan(v_se) & pushes.free_slides, 0.0, v_se)
    found = [
        slide_friction(pick(rigs, i), v[i], v_se[i], d[i], error[i, 1], k_v[i])
        for i in _chunks(len(v))
    ]
    mu, se = (np.concatenate(parts)[: len(v)] for parts in zip(*found, strict=True))
    return mu, se
