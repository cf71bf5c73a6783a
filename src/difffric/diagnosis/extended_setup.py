"""The rig and the set-up that a diagnosis extends, and those that it starts from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from difffric.estimation.effect_coordinates import PLAIN
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig import catalogue, parameters
from difffric.rig.friction import innermost
from difffric.rig.rig import Rig
from difffric.rig.setup import Extras, Setup


def strip_effects(setup: Setup) -> tuple[Setup, dict[str, float]]:
    """Return the plain set-up behind an extended one, and the effects' numbers by name."""
    rig = setup.rig
    known = {n: float(parameters.values(rig)[n]) for n in catalogue.parameter_names(rig)}
    extras = {name: x for name, x in setup.extras.items() if name not in catalogue.KEYS}
    plain = replace(
        rig,
        friction=innermost(rig.friction),
        contact=innermost(rig.contact),
        pusher=innermost(rig.pusher),
        force_sensor=innermost(rig.force_sensor),
        probe=innermost(rig.probe),
    )
    return replace(setup, rig=plain, extras=extras), known


def describe_plain(task: EnsembleTask, fits: Fits) -> dict[str, float]:
    """Return the plain model's numbers [SI] in `fits` (an ensemble of one), by name; mu_s is the
    mean over the conditions."""
    values = task.model.coordinates.values(fits.c[0], PLAIN)
    found: dict[str, float] = dict(zip(PLAIN, map(float, values), strict=True))
    return found | {"mu_s": float(np.exp(fits.mu[0].mean()))}


def extend_rig(plain: Rig, task: EnsembleTask, fits: Fits) -> Rig:
    """Return the plain rig with the numbers and effects that `fits` (an ensemble of one) has."""
    coordinates, values = task.model.coordinates, describe_plain(task, fits)
    inside: dict[str, dict[str, float]] = {}
    names = [coordinates.names[i] for i in fits.extra[0]]
    for name, value in zip(names, coordinates.values(fits.c[0], names), strict=True):
        effect, _, key = name.partition(".")
        if key:
            inside.setdefault(effect, {})[key] = value
    return catalogue.extended(parameters.with_values(plain, values), inside)


def extend_setup(setup: Setup, rig: Rig, task: EnsembleTask, fits: Fits) -> Setup:
    """Return the set-up as it is written to a file: the extended `rig`, its numbers' standard
    errors by `fits` (an ensemble of one), and what is free."""
    coordinates = task.model.coordinates
    C = ensemble.covariance(task, fits)[0][task.conditions :, task.conditions :]
    extras = dict(setup.extras)
    columns = [*task.shared, *fits.extra[0]]
    names = [coordinates.names[i] for i in columns]
    errors = coordinates.errors(fits.c[0], names, columns, C)
    for name, error in zip(names, errors, strict=True):
        known = extras.get(name, Extras())
        extras[name] = Extras(error if error > 0 else None, True, known.lower, known.upper)
    scatter = float(fits.scatter[0]) if task.mu_free else setup.mu_s_scatter
    return replace(setup, rig=rig, mu_s_scatter=scatter, extras=extras)
