"""A calibrated model beside its data: push by push, over the speeds, and over time."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from difffric.calibration.result import Fit
from difffric.compute.pytrees import pick
from difffric.estimation.coordinates import rig_at
from difffric.estimation.residuals import Grid
from difffric.estimation.stacked_data import RECORDINGS, SLIDES
from difffric.measurements.pushes import Pushes
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.families import Family, family
from difffric.simulation.trajectory import simulate


@dataclass(frozen=True)
class PushComparison:
    """F_p [N] (first row) and d [m] (second row) of n pushes, NaN: not there."""

    velocity: NDArray
    """(n,) [m/s]; of free slides the release speed"""
    measured: NDArray
    """(2, n)"""
    standard_error: NDArray
    """(2, n)"""
    model: NDArray
    """(2, n) with each push's own mu_s"""
    residual: NDArray
    """(2, n) measured less model, in standard deviations. Recordings: with the push's own mu_s,
    which comes from all samples. Else with the shared mu_s, the scatter counted in."""


@dataclass(frozen=True)
class TraceComparison:
    """One channel of one push, as its fit took it: n samples or block means."""

    t: NDArray
    """(n,) [s], from the start of the pusher's motion"""
    measured: NDArray
    """(n,) [N] or [m]; a position from its fitted zero"""
    model: NDArray
    """(n,) likewise"""
    residual: NDArray
    """(n,) measured less model, whitened, in standard deviations of the noise; NaN: left out"""


def compare_pushes(fit: Fit, pushes: Pushes) -> PushComparison:
    """The fit beside the F_p and d that were measured, of the same pushes in the same order."""
    data, at = fit.state.data, fit.state.at
    measured = np.stack([pushes.peak_force, pushes.sliding_distance])
    fitted = np.stack([fit.peak_force, fit.sliding_distance])
    own = np.stack([pushes.peak_force_se, pushes.sliding_distance_se])
    if data.kind == RECORDINGS:
        residual = (measured - fitted) / own
        return PushComparison(pushes.velocity, measured, own, fitted, residual)
    there = data.weights > 0
    known = np.where(there, 1.0 / np.where(there, data.weights, 1.0), np.nan)
    sd = known * np.append(at.spreads, 1.0)[data.group]  # group -1 is the last: known
    rows = np.asarray(at.end.rows)[: data.n]
    by_mu_s, r = rows[..., 0], rows[..., -1]
    shared = (r - by_mu_s * at.s_eta[:, None]) / np.hypot(sd, by_mu_s * at.scatter)
    residual = np.where(there, shared, np.nan).T
    if data.kind == SLIDES:
        residual = np.concatenate([np.full_like(residual, np.nan), residual])
        sd = np.column_stack([np.full(len(sd), np.nan), sd])
    velocity = pushes.release_velocity if data.kind == SLIDES else pushes.velocity
    return PushComparison(velocity, measured, sd.T, fitted, residual)


def _rig_of(fit: Fit, i: int) -> tuple[Rig, float]:
    """The rig of push i as it was fitted, with its own mu_s, and its start offset [s]."""
    model, data, at = fit.state.model, fit.state.data, fit.state.at
    c = model.layout.fixed[i] + model.layout.selection[i] @ at.theta
    c[0] += at.s_eta[i]  # mu_s is the first coordinate
    rig = rig_at(model.rig, jnp.asarray(c))
    if rig.pusher.stroke is not None:
        rig = parameters.with_stroke(rig, pick(data.pushes.stroke, i))
    return rig, float(fit.start[i])


def compare_trace(fit: Fit, i: int) -> dict[str, TraceComparison]:
    """`force` and `position` of push i of a fit of recordings, those that were recorded."""
    data = fit.state.data
    rig, offset = _rig_of(fit, i)
    push = simulate(rig, float(data.pushes.velocity[i]))
    rows = data.weights.shape[1] // 2
    out = {}
    for j, name in enumerate(("force", "position")):
        weight = data.weights[i, j * rows]
        if weight > 0:
            own = getattr(data.pushes, name)
            t = np.asarray((data.pushes.force if own.t is None else own).t)[i]
            model = np.asarray(push.evaluate(t - offset)[j])
            out[name] = _compare_channel(own, i, t, model, weight, name == "position")
    return out


def _compare_channel(
    grid: Grid, i: int, t: NDArray, model: NDArray, weight: float, free_zero: bool
) -> TraceComparison:
    """One channel of push i beside the model's values (n,) at the times (n,) [s] of its grid.

    `weight` is 1 / standard deviation of the noise; with `free_zero` the channel's zero is fitted
    and taken off the measured values.
    """
    y, a, b, before = (np.asarray(x)[i] for x in (grid.y, grid.a, grid.b, grid.before))
    bend = model[:-2] - 2 * model[1:-1] + model[2:]
    model = np.concatenate([model[:1], model[1:-1] + grid.curve[i] * bend, model[-1:]])
    difference = y - model
    residual = a * difference - b * difference[before]
    zero = 0.0
    if free_zero:
        one = a - b
        zero = float(one @ residual / (one @ one))
        residual = residual - zero * one
    if grid.doubt is not None:
        residual = residual - grid.doubt[i] @ (grid.doubt[i].T @ residual)
    n = int(np.flatnonzero(a)[-1]) + 1
    whitened = np.where(a > 0, weight * residual, np.nan)
    return TraceComparison(t[:n], y[:n] - zero, model[:n], whitened[:n])


def simulate_condition(fit: Fit, condition: str, speeds: NDArray) -> Family | None:
    """The calibrated F_p and d of a condition over speeds (n,) [m/s].

    They are at the condition's mean mu_s and at one scatter below and above. None where its pushes
    differ in mass, stroke or recorded motion, and for free slides, which have no push.
    """
    mine = [i for i, c in enumerate(fit.conditions) if c == condition]
    if fit.kind == SLIDES or fit.pushes.motion is not None:
        return None
    rigs = [_rig_of(fit, i)[0] for i in mine]
    if np.ptp([float(r.mass) for r in rigs]) > 0 or len({_stroke(r) for r in rigs}) > 1:
        return None
    mu_s = np.exp(np.mean(np.log(fit.mu_s[mine])))
    if any(n == "mu_s" for n in fit.names):
        mu_s = float(parameters.values(fit.for_condition(condition)[0])["mu_s"])
    return family(rigs[0], speeds, mu_s * np.exp(fit.scatter * np.array([-1.0, 0.0, 1.0])))


def _stroke(rig: Rig) -> float:
    return np.inf if rig.pusher.stroke is None else float(rig.pusher.stroke)
