"""How well a set-up predicts pushes that it has not seen: each re-estimates its own mu_s alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from difffric.diagnosis.data import prepare_data
from difffric.diagnosis.extended_setup import strip_effects
from difffric.estimation.effect_coordinates import PLAIN
from difffric.estimation.ensembles import ensemble_refits, friction_scan
from difffric.estimation.ensembles.ensemble import Fits
from difffric.measurements.checks import check_data
from difffric.measurements.recordings import Recordings
from difffric.measurements.reduction.reduce import reduce_recordings
from difffric.rig import parameters
from difffric.rig.setup import Setup


def prediction_error(setup: Setup, data, noise=(0.5, 0.3e-6), **options) -> float:
    """Root mean square residual in units of the noise; of a table's F_p and d that noise's
    standard deviations are given."""
    plain, known = strip_effects(setup)
    data = check_data(data, plain.rig, **options)
    reduction = reduce_recordings(data) if isinstance(data, Recordings) else None
    measured = reduction.pushes if reduction else data
    errors = None if reduction else np.tile(noise, (len(measured), 1))
    found = prepare_data(plain.rig, measured, reduction, errors)
    task, coordinates = replace(found.task, estimate_scatter=False), found.task.model.coordinates
    values = parameters.values(setup.rig)
    c = np.zeros((1, len(coordinates.names)))
    c[0, coordinates.indices(PLAIN)] = coordinates.point({n: float(values[n]) for n in PLAIN})
    c[0, coordinates.indices(tuple(known))] = coordinates.point(known)
    mu = np.full((1, task.conditions), np.log(float(values["mu_s"])))
    start = Fits(((),), c, mu, np.zeros((1, task.n)), np.array([0.1]), np.ones((1, 2)))
    at = ensemble_refits.refit(task, start, 10)
    at = ensemble_refits.refit(task, friction_scan.rescan_bad_pushes(task, at), 10)
    squares = at.gram[0, :, :, -1, -1].sum()
    return float(np.sqrt(squares / task.counts.sum()))
