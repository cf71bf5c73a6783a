"""Where a diagnosis starts: the data, the plain fit, the program that follows extended models."""

from __future__ import annotations

from dataclasses import dataclass, replace
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.calibrate import Fit, fit
from difffric.diagnosis.data import DiagnosisData, beside, diagnosis_data
from difffric.diagnosis.extended_setup import stripped
from difffric.estimation.effect_coordinates import PLAIN
from difffric.estimation.ensemble import Fits
from difffric.estimation.stacked_data import sensor_errors
from difffric.measurements.checks import checked_data
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.measurements.reduction.reduce import reduce_recordings
from difffric.progress import Tell
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup

_SLIDE_READ = 1e-3
"""Relative error of a free slide's distance where none is known: what its mu_s scatters by is
taken for scatter."""


@dataclass(frozen=True)
class Start:
    """What a search starts from."""

    data: DiagnosisData
    fit: Fit
    """of the plain set-up"""
    known: tuple[str, ...]
    """numbers of the effects that the set-up has already"""
    at: Fits
    """the plain fit, with the effects that the set-up has"""
    guess: Fits
    """the set-up as it was given"""


def start_of(setup: Setup, given: Pushes | Recordings, tell: Tell, **options) -> Start:
    """Checks the data, fits the plain set-up, and makes the program beside it.

    `options`: use_data_mass, skip_bad.
    """
    own, known = stripped(setup)
    plain = own.rig
    if isinstance(given, Recordings):
        checked: Pushes | Recordings = checked_data(given, plain, **options)
        reduction = reduce_recordings(checked, skip_bad=options["skip_bad"])
        measured, noise = reduction.pushes, None
    else:
        checked = measured = checked_data(given, plain, **options)
        reduction, noise = None, _noise(plain, measured)
    data = diagnosis_data(plain, measured, reduction, noise)
    compiling = Thread(target=data.task.model.compile)
    compiling.start()
    try:
        # One start will do: where the fit is poor, the search begins with more of its own.
        fitted = fit(
            own, checked, thorough=False,
            tell=lambda what, share: tell(what, 0.25 * share), **options,
        )  # fmt: skip
    finally:
        compiling.join()
    data, start = beside(data, fitted)
    coordinates, free = data.task.model.coordinates, data.task.mu_free
    c = start.c.copy()
    extra = coordinates.indices(tuple(known))
    c[0, extra] = coordinates.point(known)
    at = replace(start, c=c, extra=(tuple(extra),))
    values = parameters.values(plain)
    c = c.copy()
    c[0, coordinates.indices(PLAIN)] = coordinates.point({n: float(values[n]) for n in PLAIN})
    mu = np.full_like(start.mu, np.log(float(values["mu_s"]))) if free else start.mu
    guess = replace(at, c=c, mu=mu, own=np.zeros_like(start.own) if free else start.own)
    return Start(data, fitted, tuple(known), at, guess)


def _noise(rig: Rig, measured: Pushes) -> NDArray:
    """(n, 2) standard errors of F_p and d; NaN: not known."""
    if measured.free_slides:
        d, v = measured.sliding_distance, measured.release_velocity
        through = np.nan_to_num(2 * d / v * measured.release_velocity_se)
        own = measured.sliding_distance_se
        own = np.where(np.isnan(own), sensor_errors(rig)[1] or _SLIDE_READ * d, own)
        return np.stack([np.full(len(d), np.nan), np.hypot(own, through)], axis=1)
    noise = np.stack([measured.peak_force_se, measured.sliding_distance_se], axis=1)
    default = [np.nan if x is None else x for x in sensor_errors(rig)]
    return np.where(np.isnan(noise), default, noise)


def folds_of(v: NDArray, by_speed: bool) -> NDArray:
    """(n,) the fold of each push: all of one speed, or one push each (of about twenty folds)."""
    if by_speed:
        return np.unique(v, return_inverse=True)[1]
    return np.arange(len(v)) % max(min(len(v), 20), 1)
