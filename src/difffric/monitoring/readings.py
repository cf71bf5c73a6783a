"""Two numbers that say all of a push: mu_s by the best combination of force and distance, and what
mu_s cannot explain of them.

With the errors sigma of F_p and d, and j = (dF_p/sigma_F, dd/sigma_d) by log mu_s, the residuals
rho = ((F_p - F_p(mu_s)) / sigma_F, (d - d(mu_s)) / sigma_d) split into

    log mu_s + j rho / |j|^2   (variance 1 / |j|^2)   and
    contrast = (rho_d j_F - rho_F j_d) / |j|          (variance 1),

which are independent, and stay so where mu_s itself scatters: that moves the first alone. The
contrast is positive where the force is larger than the distance lets one expect.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.compute.pytrees import pick
from difffric.estimation.push_rigs import rigs_of
from difffric.estimation.stacked_data import sensor_errors
from difffric.identification.tabulated_inversion import Curve
from difffric.measurements.pushes import Pushes
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.batch import Batch, observe_batch
from difffric.simulation.segments import default_integrator
from difffric.units import from_um, to_um

NOISE = (0.5, from_um(0.3) * np.sqrt(2.0))
"""Standard errors of F_p [N] and d [m] where neither the pushes nor the set-up say any."""
_KEPT = 256  # settings whose curves are kept
_NEWTON = 6  # steps from a cell of the curve, which is so narrow that three do
_CLOSE = 1e-6  # before Newton's last step, relative: it squares it; more is a jump of the model
_FAR = 0.25  # by so much of F_p another branch of the model is meant
_BRANCH = (0.2, 0.05)  # of mu_s and of F_p: distances of the branches of the model
_AT_ONCE = 4096  # pushes


class Reading(NamedTuple):
    """Of n pushes, (n,) each; NaN: not to be had."""

    log_mu_s: NDArray
    error: NDArray
    """of log_mu_s, by the sensors alone"""
    contrast: NDArray
    """in standard deviations of the sensors' noise"""
    sigma: NDArray
    """(n, 2) the errors of F_p [N] and d [m]; infinite where one was not measured"""
    reason: list[str | None]
    """why there is nothing"""


class Reader:
    """Reads pushes with the model of a rig: its curves over mu_s are solved once a setting."""

    def __init__(self, rig: Rig):
        self.rig = rig
        own = sensor_errors(rig)
        self.noise_known = tuple(x is not None for x in own)
        self._noise = [b if a is None else a for a, b in zip(own, NOISE, strict=True)]
        self._integrator = default_integrator(rig)
        self._curves: dict[tuple[float, ...], Curve] = {}

    def curve(self, velocity: float, mass: float, stroke: float) -> Curve:
        """F_p and d over mu_s of one setting, SI units; NaN: the rig's own."""
        key = (float(velocity), *(-1.0 if np.isnan(x) else float(x) for x in (mass, stroke)))
        if key not in self._curves:
            if len(self._curves) >= _KEPT:
                self._curves.pop(next(iter(self._curves)))
            alone = Pushes(velocity=_one(velocity), mass=_one(mass), stroke=_one(stroke))
            own = pick(rigs_of(self.rig, alone), 0)
            self._curves[key] = Curve.of(own, float(velocity), self._integrator)
        return self._curves[key]

    def sigma(self, pushes: Pushes) -> NDArray:
        """(n, 2) errors of F_p [N] and d [m]; infinite where one was not measured."""
        pairs = (
            (pushes.peak_force, pushes.peak_force_se, self._noise[0]),
            (pushes.sliding_distance, pushes.sliding_distance_se, self._noise[1]),
        )
        return np.stack(
            [np.where(np.isnan(x), np.inf, np.where(np.isnan(se), of, se)) for x, se, of in pairs],
            axis=1,
        )

    def read(self, pushes: Pushes, expected: float | None = None) -> Reading:
        """What pushes say. A push that was not measured, or that no mu_s explains, has a reason.

        `expected` is log mu_s as it was before, by default the rig's: where several mu_s give the
        measured d, the one is taken that is nearest to it, in 20 % of mu_s, and to the measured
        F_p, in 5 % of it.
        """
        n = len(pushes)
        if expected is None:
            expected = float(np.log(parameters.values(self.rig)["mu_s"]))
        empty = np.full((3, n), np.nan)
        out = Reading(empty[0], empty[1], empty[2], self.sigma(pushes), [None] * n)
        setting = np.stack([pushes.velocity, pushes.mass, pushes.stroke], axis=1)
        _, which = np.unique(
            np.where(np.isnan(setting), -1.0, setting), axis=0, return_inverse=True
        )
        which = which.ravel()
        for k in range(which.max() + 1):
            same = np.flatnonzero(which == k)
            curve = self.curve(*setting[same[0]])
            for lo in range(0, len(same), _AT_ONCE):
                self._read(curve, pushes, same[lo : lo + _AT_ONCE], expected, out)
        return out

    def _read(
        self, curve: Curve, pushes: Pushes, at: NDArray, expected: float, out: Reading
    ) -> None:
        measured = np.stack([pushes.peak_force[at], pushes.sliding_distance[at]])
        sigma = out.sigma[at].T
        start = roots(curve, 1, measured[1], expected, measured[0])
        model, slope = values(curve, start)
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.abs(model[0] / measured[0] - 1.0) > _FAR
            start = np.where(far, np.nan, start)
            finer = sigma[0] / np.abs(slope[0]) < sigma[1] / np.abs(slope[1])
            if (by_force := np.isnan(measured[1]) | (finer & ~far)).any():
                start = np.where(by_force, roots(curve, 0, measured[0], expected), start)
                model, slope = values(curve, start)
            J, gone = slope / sigma, np.isinf(sigma)
            rho = np.where(gone, 0.0, (measured - model) / sigma)
            size = np.hypot(*np.where(gone, 0.0, J))
            log_mu_s = start + (np.where(gone, 0.0, J) * rho).sum(axis=0) / size**2
            contrast = (rho[1] * J[0] - rho[0] * J[1]) / size
        good = np.isfinite(log_mu_s)
        out.log_mu_s[at] = np.where(good, log_mu_s, np.nan)
        out.error[at] = np.where(good, 1.0 / np.where(good, size, 1.0), np.nan)
        out.contrast[at] = np.where(good & ~gone.any(axis=0), contrast, np.nan)
        for i in np.flatnonzero(~good):
            out.reason[at[i]] = _why(curve, measured[:, i])


def roots(
    curve: Curve, which: int, target: NDArray, expected: float, force: NDArray | None = None
) -> NDArray:
    """(n,) log mu_s at which the model gives F_p (`which` 0) or d (1); NaN: at none. Of several,
    the one nearest to what is `expected` and, where it is given, to the measured force."""
    grid, value = np.log(curve.mu_s), curve.both[which]
    exists = np.isfinite(value)
    below = value < target[:, None]
    crosses = (below[:, 1:] != below[:, :-1]) & exists[1:] & exists[:-1]
    away = ((grid[1:] - expected) / _BRANCH[0]) ** 2 * np.ones(crosses.shape)
    if force is not None:
        F = 0.5 * (curve.both[0][1:] + curve.both[0][:-1])
        off = ((F / force[:, None] - 1.0) / _BRANCH[1]) ** 2
        away = away + np.where(np.isnan(off), 0.0, off)
    cell = np.argmin(np.where(crosses, away, np.inf), axis=1)
    some = crosses[np.arange(len(target)), cell]
    low, high = grid[cell], grid[cell + 1]
    x = np.where(some, 0.5 * (low + high), np.nan)
    for _ in range(_NEWTON):
        seen, slope = values(curve, x)
        with np.errstate(divide="ignore", invalid="ignore"):
            off = seen[which] - target
            close = np.abs(off) < _CLOSE * target
            x = np.clip(x - off / slope[which], low, high)
        if (close | ~some).all():
            break
    return np.where(some & close, x, np.nan)


def values(curve: Curve, x: NDArray) -> tuple[NDArray, NDArray]:
    """(2, n) F_p and d at log mu_s, and their derivatives by it; NaN at NaN."""
    known = np.isfinite(x)
    seen = observed(curve, {"mu_s": np.exp(np.where(known, x, -2.0))}, ("mu_s",))
    model = np.stack([seen.peak_force, seen.sliding_distance])
    slope = np.stack([seen.peak_force_by["mu_s"], seen.sliding_distance_by["mu_s"]])
    return np.where(known, model, np.nan), np.where(known, slope * np.exp(x), np.nan)


def observed(curve: Curve, new: dict, by: tuple[str, ...], rig: Rig | None = None) -> Batch:
    """F_p, d and their derivatives at a setting with some parameters (n,) replaced."""
    rig = parameters.with_values(curve.rig if rig is None else rig, new)
    return observe_batch(rig, curve.velocity, derivatives=by)


def _why(curve: Curve, measured: NDArray) -> str:
    """Why a push says nothing of mu_s."""
    if np.isnan(measured).all():
        return "neither force nor distance was measured"
    which = 0 if np.isnan(measured[1]) else 1
    value = curve.both[which][np.isfinite(curve.both[which])]
    name, unit, scale = (("F_p", "N", 1.0), ("d", "µm", to_um(1.0)))[which]
    if not len(value):
        return "the part is never released at this speed, whatever mu_s"
    least, most = scale * value.min(), scale * value.max()
    if which and least < scale * measured[1] < most:
        return f"no mu_s gives d = {scale * measured[1]:.4g} µm with a force near that measured"
    ends = f"{least:.4g} to {most:.4g} {unit}"
    return f"no mu_s gives {name} = {scale * measured[which]:.4g} {unit}: the model, {ends}"


def _one(value: float) -> NDArray:
    return np.array([value], float)
