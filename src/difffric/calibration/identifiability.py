"""Which parameters a set of pushes can determine, before any of them is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.free_parameters import USUAL_SCATTER, choose_free, collect_given
from difffric.errors import InputError
from difffric.estimation.coordinates import Layout, layout, slope
from difffric.estimation.descent import Model
from difffric.estimation.fisher_information import design_data, information, responses
from difffric.estimation.open_parameters import (
    describe_assumed_ratio,
    list_undetermined,
    open_units,
)
from difffric.estimation.restricted_likelihood import invert_information
from difffric.measurements.pushes import Pushes
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup, check_rig

ASSUMED = 0.01
"""The relative standard error of F_p and d where neither the pushes nor the sensors say one."""

_ONE_SPEED = 0.02
"""Speeds that differ by less than this share are one."""


@dataclass(frozen=True)
class Identifiability:
    """What to expect of a fit of these pushes, at the set-up's values."""

    free: tuple[str, ...]
    """labels, as a fit has them"""
    not_identifiable: list[dict]
    """groups of parameters with the reason, as `Fit.not_identifiable`"""
    standard_errors: dict[str, float | None]
    """expected, SI; None: not determined"""
    information: NDArray
    """(free, free) of the coordinates"""
    peak_force: NDArray
    """F_p to expect [N]"""
    sliding_distance: NDArray
    """d to expect [m], NaN where there is none"""
    notes: tuple[str, ...]

    def as_dict(self) -> dict:
        """As `result.json` holds it."""
        return {
            "standard_errors": self.standard_errors,
            "not_identifiable": self.not_identifiable,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        width = max(len(x) for x in self.free)
        lines = ["[[Expected standard errors]]"]
        for label, error in self.standard_errors.items():
            said = "not determined" if error is None else f"{error:.3g}"
            lines.append(f"    {label:<{width}}  {said}")
        if self.not_identifiable:
            lines.append("[[Not determined by these pushes]]")
            lines += [
                f"    {', '.join(x['parameters'])}: {x['reason']}" for x in self.not_identifiable
            ]
        return "\n".join([*lines, *(f"    note: {note}" for note in self.notes)])


def identifiable(
    rig: Rig | Setup,
    pushes: Pushes,
    free: Sequence[str] | None = None,
    noise: tuple[float | None, float | None] = (None, None),
    per_condition: Sequence[str] = ("mu_s",),
) -> Identifiability:
    """Which of the free parameters F_p and d of these pushes will determine, and how well.

    Only the design of the pushes is used: speeds (or release speeds), masses, strokes,
    conditions. Where some of them hold a measured F_p (or d) and others do not, or only one of
    the two was measured, what is missing counts as not to be measured; where nothing was
    measured, all will be. Parameters stand at the set-up's values, each push has its own mu_s
    under the set-up's scatter (3 % where it gives none).

    Arguments:
        rig: the rig, or the set-up.
        pushes: the planned pushes, measured or not.
        free: the names of the parameters to determine; by default those of `fit`.
        noise: the standard errors of F_p [N] and d [m]; None: the pushes' own, else the sensors',
            else 1 % of the value.
        per_condition: the parameters that have a value for each condition.

    Raises `InputError` for unknown parameters, where `free` is empty and for a noise that is not
    positive.
    """
    setup = rig if isinstance(rig, Setup) else Setup(rig)
    base = check_rig(setup.rig)
    for value, what in zip(noise, ("force", "distance"), strict=True):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(f"noise: that of the {what} is {value}: expected a number > 0")
    names = choose_free(setup, pushes, free)
    given, notes = collect_given(pushes, names), list[str]()
    arranged = layout(base, names, per_condition, pushes.condition, given, {}, {})
    scatter = USUAL_SCATTER if setup.mu_s_scatter is None else setup.mu_s_scatter
    scatter = scatter if "mu_s" in names else 0.0
    spread_rig, data = design_data(base, pushes)
    model = Model(spread_rig, None, arranged, scatter, False)
    theta = arranged.start
    derivatives, answers = responses(
        model, data, theta, data.pushes, arranged.fixed, arranged.selection
    )
    weights = _expect_weights(base, pushes, answers, noise, notes)
    X = information(derivatives, weights, arranged.selection, scatter).sum(axis=0)
    if "mu_s" in names and setup.mu_s_scatter is None:
        notes.append(f"the set-up gives no scatter of mu_s: {100 * USUAL_SCATTER:g} % is assumed")
    if np.isnan(answers[:, 1]).any():
        notes.append(f"{int(np.isnan(answers[:, 1]).sum())} pushes give no sliding distance")
    if "mu_s" in names and "mu_k_over_mu_s" not in names:
        notes += describe_assumed_ratio(base, pushes)
    covariance = invert_information(X)
    v = pushes.release_velocity if pushes.free_slides else pushes.velocity
    unit = open_units(base, arranged.names, float(np.max(v)))
    groups = list_undetermined(arranged.labels, arranged.names, covariance, unit)
    for group in groups:
        why = _explain(group["parameters"], derivatives, weights, v)
        group["reason"] += f". {why}" if why else ""
    return Identifiability(
        free=arranged.labels,
        not_identifiable=groups,
        standard_errors=_expect_errors(base, arranged, covariance, groups),
        information=X,
        peak_force=answers[:, 0],
        sliding_distance=answers[:, 1],
        notes=tuple(notes),
    )


def _expect_errors(
    rig: Rig, arranged: Layout, covariance: NDArray, groups: list[dict]
) -> dict[str, float | None]:
    """Standard errors [SI] to expect, by label; None for those in groups that stay open."""
    open_ = {label for group in groups for label in group["parameters"]}
    known = parameters.values(rig)
    errors: dict[str, float | None] = {}
    for j, (label, name) in enumerate(zip(arranged.labels, arranged.names, strict=True)):
        error = abs(slope(name, float(known[name]))) * float(np.sqrt(covariance[j, j]))
        errors[label] = None if label in open_ else error
    return errors


def _expect_weights(
    rig: Rig,
    pushes: Pushes,
    answers: NDArray,
    noise: tuple[float | None, float | None],
    notes: list[str],
) -> NDArray:
    """1 / standard error of each answer (n, rows); 0 where there is none, or will not be.

    A standard error that has to be assumed adds a line to `notes`.
    """
    own = np.stack([pushes.peak_force_se, pushes.sliding_distance_se], axis=1)
    measured = np.isfinite(np.stack([pushes.peak_force, pushes.sliding_distance], axis=1))
    wanted = measured if measured.any() else np.ones_like(measured)
    default = [a if a is not None else b for a, b in zip(noise, rig.sensor_errors, strict=True)]
    error = np.where(np.isnan(own), np.array([np.nan if x is None else x for x in default]), own)
    there = wanted & np.isfinite(answers)
    if pushes.free_slides:
        there, error = there & np.array([False, True]), error.copy()
        through = 2 * answers[:, 1] / pushes.release_velocity * pushes.release_velocity_se
        error[:, 1] = np.hypot(error[:, 1], np.nan_to_num(through))
    for j, what in enumerate(("F_p", "d")):
        if (there[:, j] & np.isnan(error[:, j])).any():
            notes.append(f"no standard error of {what} is known: {100 * ASSUMED:g} % is assumed")
    error = np.where(np.isnan(error), ASSUMED * np.abs(answers), error)
    out = np.where(there & (error > 0), 1.0 / np.where(error > 0, error, 1.0), 0.0)
    return out[:, 1:] if pushes.free_slides else out


def _explain(labels: list[str], derivatives: NDArray, weights: NDArray, v: NDArray) -> str:
    """What of the pushes leaves these parameters open, where that is known; else empty."""
    said = []
    J = derivatives * weights[..., None]
    names = {label.split("[")[0] for label in labels}
    # mu_s and mu_k_over_mu_s are the first two coordinates: the same logarithmic derivative.
    if {"mu_s", "mu_k_over_mu_s"} <= names and np.allclose(
        J[..., 0], J[..., 1], rtol=1e-6, atol=1e-6 * np.abs(J).max(initial=1e-300)
    ):
        said.append("No push sticks first, so F_p and d depend on mu_k alone")
    if "k_v_N_s_per_m" in names and np.ptp(v) < _ONE_SPEED * np.max(v):
        said.append("All pushes have one speed")
    forces = weights.shape[1] == 1 or not weights[:, 0].any()
    if names & {"k_N_per_m", "b_N_s_per_m"} and forces:
        said.append("No force is measured")
    return ". ".join(said)
