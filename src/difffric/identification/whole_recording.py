"""mu_s of each recorded push from all its samples, the rig's other parameters held."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from difffric.estimation import coordinates
from difffric.estimation.coordinates import layout
from difffric.estimation.descent import Model, blind_to_motion, first_point, respond_at
from difffric.estimation.mixed_model import MAX_STEPS
from difffric.estimation.push_friction import OTHERWISE, find_best_friction, find_push_friction
from difffric.estimation.stacked_data import traces_data
from difffric.measurements.reduction.reduce import Reduction
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.segments import Integrator

_OPEN = 0.3
"""Standard deviation of log mu_s that is as good as none: it moves no estimate by more than the
share (standard error / this)^2 of its distance from the start."""
_MASKINGS = 3
"""Times that the samples beside jumps of the model are looked up and the fit begins anew: the jumps
move with mu_s, by less each time."""
_FEW_STEPS = 15
"""Steps of a search before the last: it only tells which samples lie beside a jump."""
_POOR = 2.0
"""A reduced chi-square above this makes a search elsewhere."""


@dataclass(frozen=True)
class RecordingFits:
    """What whole recordings say of mu_s, an entry a push."""

    mu_s: NDArray
    own_variance: NDArray
    """of log mu_s, from the noise of the samples alone"""
    by_coordinate: NDArray
    """(n, coordinates) derivative of log mu_s by the rig's coordinates: how its calibration
    counts"""
    reduced_chi2: NDArray


def fit_recordings(
    rigs_by_push: list[Rig], reduction: Reduction, guess: NDArray, integrator: Integrator | None
) -> RecordingFits:
    """Fit log mu_s of every push to its samples, from `guess` (n,), NaN: the rig's own."""
    rig, recordings = rigs_by_push[0], reduction.recordings
    n, every = len(recordings), coordinates.names(rig)
    plan = layout(rig, (), (), reduction.pushes.condition, {}, {}, {})
    values = [parameters.values(r) for r in rigs_by_push]
    given = {name: np.array([float(v[name]) for v in values]) for name in parameters.names(rig)}
    given["mu_s"] = np.where(np.isfinite(guess), guess, given["mu_s"])
    mass = reduction.pushes.mass
    given["mass_kg"] = np.where(np.isnan(mass), given["mass_kg"], mass)
    fixed = plan.fixed.copy()
    for name, column in given.items():
        fixed[:, every.index(name)] = coordinates.to_coordinate(name, column)
    plan = replace(plan, fixed=fixed)
    fastest = float(np.sqrt(2 * given["k_N_per_m"].max() / given["mass_kg"].min()))
    everyone, s_eta, jumps = np.arange(n), np.zeros(n), None
    for masking in range(_MASKINGS):
        spread, data = traces_data(
            rig,
            recordings,
            reduction.details,
            fastest,
            len(every),
            jumps,
            motion=reduction.pushes.motion,
        )
        model = Model(spread, integrator, plan, _OPEN, False)
        at = first_point(model, data, np.zeros(0))
        if reduction.pushes.motion is not None:
            known = replace(at, s_eta=s_eta) if masking else None
            data = blind_to_motion(model, data, recordings, known)
        last = masking == _MASKINGS - 1
        steps = MAX_STEPS if last else _FEW_STEPS
        found = find_push_friction(model, data, at, everyone, s_eta, steps)
        s_eta, chi2 = found.s_eta, found.cost / data.samples_of
        poor = np.flatnonzero(chi2 > _POOR)
        if masking == 0 and len(poor):
            trials = s_eta[poor] + _OPEN * np.array(OTHERWISE)[:, None]
            best = find_best_friction(model, data, at, poor, trials)
            s_eta[poor] = np.where(best.cost < found.cost[poor], best.s_eta, s_eta[poor])
        moving = range(len(every)) if last else [0]
        end = respond_at(model, data, at, everyone, s_eta, np.zeros(n), moving)
        jumps = np.asarray(end.jumps)
    rows = np.asarray(end.rows) * data.weights[..., None]
    chi2 = np.sum(rows[..., -1] ** 2, axis=1) / data.samples_of
    J = rows[..., :-1]
    own = np.sum(J[..., 0] ** 2, axis=1)
    seen = own > 0
    across = -np.einsum("nm,nmk->nk", J[..., 0], J) / np.where(seen, own, 1.0)[:, None]
    across[:, 0] = 0.0
    mu = np.exp(fixed[:, 0] + s_eta)
    return RecordingFits(
        mu_s=np.where(seen, mu, np.nan),
        own_variance=1.0 / np.where(seen, own, np.nan),
        by_coordinate=across,
        reduced_chi2=chi2,
    )
