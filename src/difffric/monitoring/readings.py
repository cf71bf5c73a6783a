"""Readings: the two numbers that say all of a push, mu_s by the best combination of force and
distance, and a contrast that mu_s cannot explain.

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
from difffric.estimation.push_rigs import make_push_rigs
from difffric.identification.resolved_pushes import fill_errors
from difffric.identification.tabulated_model import TabulatedModel
from difffric.measurements.pushes import Pushes
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.segments import default_integrator
from difffric.units import from_um, to_um

NOISE = (0.5, from_um(0.3) * np.sqrt(2.0))
"""Standard errors of F_p [N] and d [m] where neither the pushes nor the set-up say any."""
_KEPT = 256  # settings whose curves are kept in memory
_FAR = 0.25  # by so much of F_p another branch of the model is meant
_AT_ONCE = 4096  # pushes


class Reading(NamedTuple):
    """What n pushes say, (n,) each; NaN: not to be had."""

    log_mu_s: NDArray
    error: NDArray
    """standard error of `log_mu_s`, by the sensors alone"""
    contrast: NDArray
    """in standard deviations of the sensors' noise"""
    sigma: NDArray
    """(n, 2) the errors of F_p [N] and d [m]; infinite where one was not measured"""
    reason: list[str | None]
    """why a push says nothing"""


class Reader:
    """Reads pushes with the model of a rig, whose curves over mu_s are solved once a setting."""

    def __init__(self, rig: Rig):
        self.rig = rig
        own = rig.sensor_errors
        self.noise_known = tuple(x is not None for x in own)
        self._noise = [b if a is None else a for a, b in zip(own, NOISE, strict=True)]
        self._integrator = default_integrator(rig)
        self._curves: dict[tuple[float, ...], TabulatedModel] = {}

    def curve(self, velocity: float, mass: float, stroke: float) -> TabulatedModel:
        """Return F_p and d over mu_s at one setting, in SI units; NaN: the rig's own."""
        key = (float(velocity), *(-1.0 if np.isnan(x) else float(x) for x in (mass, stroke)))
        if key not in self._curves:
            if len(self._curves) >= _KEPT:
                self._curves.pop(next(iter(self._curves)))
            alone = Pushes(
                velocity=_make_column(velocity),
                mass=_make_column(mass),
                stroke=_make_column(stroke),
            )
            own = pick(make_push_rigs(self.rig, alone), 0)
            self._curves[key] = TabulatedModel.of(own, float(velocity), self._integrator)
        return self._curves[key]

    def sigma(self, pushes: Pushes) -> NDArray:
        """Return the errors of F_p [N] and d [m] (n, 2), infinite where one was not measured."""
        measured = np.stack([pushes.peak_force, pushes.sliding_distance], axis=1)
        return np.where(np.isnan(measured), np.inf, fill_errors(pushes, self._noise))

    def read(self, pushes: Pushes, expected: float | None = None) -> Reading:
        """Read pushes. One that was not measured, or that no mu_s explains, gets a reason.

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
        self, curve: TabulatedModel, pushes: Pushes, at: NDArray, expected: float, out: Reading
    ) -> None:
        """Read the pushes `at`, which are of one setting, into `out`."""
        measured = np.stack([pushes.peak_force[at], pushes.sliding_distance[at]])
        sigma = out.sigma[at].T
        start = curve.find_roots(measured[1], "sliding_distance", expected, measured[0])
        model, slope = curve.observe(start)
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.abs(model[0] / measured[0] - 1.0) > _FAR
            start = np.where(far, np.nan, start)
            finer = sigma[0] / np.abs(slope[0]) < sigma[1] / np.abs(slope[1])
            if (by_force := np.isnan(measured[1]) | (finer & ~far)).any():
                by_force_alone = curve.find_roots(measured[0], "peak_force", expected)
                start = np.where(by_force, by_force_alone, start)
                model, slope = curve.observe(start)
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


def _why(curve: TabulatedModel, measured: NDArray) -> str:
    """Return why a push of measured F_p and d (2,) says nothing of mu_s."""
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


def _make_column(value: float) -> NDArray:
    """A column of one row."""
    return np.array([value], float)
