"""The next push that says most about a calibrated rig's parameters.

D-optimal design: the speed and the mass for which log det of the information grows most, or, for
one parameter, for which its expected variance falls most (c-optimal). A candidate's information
follows from its exact derivatives, with the noise of the fit's data, and with a mu_s of its own,
averaged over the fitted scatter: beside a change of regime one value alone would mislead.
Source: V. V. Fedorov, Theory of Optimal Experiments (Academic Press, 1972).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from difffric import units
from difffric.calibration.result import Fit
from difffric.errors import InputError
from difffric.estimation import coordinates
from difffric.estimation.coordinates import slope, to_coordinate
from difffric.estimation.descent import Settled
from difffric.estimation.fisher_information import information, responses
from difffric.estimation.open_parameters import open_units
from difffric.estimation.residuals import TablePush, TracePush
from difffric.estimation.stacked_data import SLIDES, TABLE, FitData

SPEEDS_MM_MIN = (500.0, 5000.0)
"""The range of the paper's rig: candidates lie in it, and between the fit's own speeds."""
_CANDIDATES = 32
"""Speeds that are compared unless told otherwise: 8 % apart over the paper's range, which is finer
than log det varies."""
_NODES = 5
"""Values of a push's own mu_s over which its information is averaged: three within one scatter and
a half, two in the tails."""
_SHOWN = 5
"""The best candidates that are told."""
_VAGUE = 1e-6
"""What is known of each parameter anyhow, as information in units of `open_units`: a standard
error of 1000 of them, so that log det exists where the fit left a parameter open."""
_LEAST_VARIANCE = 1e-13
"""Share of the largest variance below which one is rounding."""


@dataclass(frozen=True)
class NextPush:
    """The push to make next, what it would change, and how the other candidates compare."""

    velocity: float
    """[m/s]"""
    mass: float
    """[kg]"""
    stroke: float | None
    """[m]; None: the pusher stops at the first loss of contact"""
    condition: str
    target: str | None
    """the parameter it is best for; None: all, by the determinant"""
    gain: float
    """growth of log det of the information"""
    peak_force: float
    """F_p to expect [N]"""
    sliding_distance: float
    """d to expect [m]"""
    before: dict[str, float]
    """standard errors now [SI]"""
    after: dict[str, float]
    """standard errors to expect [SI]"""
    best: tuple[dict[str, float], ...]
    """the best few candidates"""
    candidates: dict[str, NDArray]
    """`velocity`, `mass`, `gain` (n,), `information` (n, open, open), `after` (n, open)"""
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict:
        """As `result.json` holds it."""
        return {
            "velocity_m_per_s": self.velocity,
            "mass_kg": self.mass,
            "stroke_m": self.stroke,
            "condition": self.condition,
            "target": self.target,
            "gain_log_det": self.gain,
            "peak_force_N": self.peak_force,
            "sliding_distance_m": self.sliding_distance,
            "standard_error_before": self.before,
            "standard_error_after": self.after,
            "best": list(self.best),
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        aim = "all parameters" if self.target is None else self.target
        lines = [
            f"next push, best for {aim}: {self.velocity / units.MM_PER_MIN:.0f} mm/min, "
            f"{self.mass:.4g} kg",
            f"    expected F_p {self.peak_force:.4g} N, d {self.sliding_distance:.4g} m",
            "    standard error      now -> after",
        ]
        lines += [f"    {x}: {self.before[x]:.3g} -> {self.after[x]:.3g}" for x in self.before]
        lines.append("    best candidates (growth of log det):")
        lines += [
            f"        {x['velocity_m_per_s'] / units.MM_PER_MIN:.0f} mm/min, "
            f"{x['mass_kg']:.4g} kg: {x['gain_log_det']:.3g}"
            for x in self.best
        ]
        return "\n".join([*lines, *(f"    note: {note}" for note in self.notes)])


def next_push(
    fit: Fit,
    speeds: Sequence[float] | None = None,
    masses: Sequence[float] | None = None,
    target: str | None = None,
    condition: str | None = None,
) -> NextPush:
    """The speed and the mass of the next push that best determine the fit's parameters.

    A candidate is measured like the fit's push nearest in speed, with its stroke. Candidates
    without a sliding distance, or beyond the force sensor's range, are left out.

    Arguments:
        fit: the fit of a table or of recordings.
        speeds: the candidates' speeds [m/s]; by default 32 over the rig's range.
        masses: the candidates' masses [kg]; by default those of the data.
        target: the label of the parameter to determine best; None: all of them.
        condition: the condition of the push; by default that of the first one.

    Raises `InputError` for a fit of free slides, an unknown or held target, an unknown condition,
    speeds or masses that are not positive, and where no candidate is left.
    """
    if fit.kind == SLIDES:
        raise InputError("next_push: expected a fit of pushes (a table or recordings)")
    keep = [j for j, label in enumerate(fit.free) if label not in fit.held]
    labels = [fit.free[j] for j in keep]
    if target is not None and target not in labels:
        raise InputError(f"next_push: target is {target}, expected one of {', '.join(labels)}")
    if condition is None:
        condition = fit.conditions[0]
    if condition not in fit.conditions:
        known = ", ".join(dict.fromkeys(fit.conditions))
        raise InputError(f"next_push: condition is {condition}, expected one of {known}")
    designs = _lay_out_designs(fit, speeds, masses, fit.conditions.index(condition))
    added, answers = _expect_information(fit, designs)
    added = added[:, keep][:, :, keep]
    good, notes = _find_usable(fit, added, answers)
    v, m, added, answers = designs.velocity[good], designs.mass[good], added[good], answers[good]
    now = _gather_information(fit, keep)
    gain = np.linalg.slogdet(now + added)[1] - np.linalg.slogdet(now)[1]
    scale = np.array([abs(slope(fit.names[j], fit.value(fit.free[j]))) for j in keep])
    after = scale * np.sqrt(np.diagonal(np.linalg.inv(now + added), axis1=1, axis2=2))
    before = scale * np.sqrt(np.diag(np.linalg.inv(now)))
    merit = gain if target is None else -after[:, labels.index(target)]
    order = np.argsort(-merit, kind="stable")
    i = int(order[0])
    stroke = np.asarray(designs.pushes.stroke)[good][i]
    return NextPush(
        velocity=float(v[i]),
        mass=float(m[i]),
        stroke=float(stroke) if np.isfinite(stroke) else None,
        condition=condition,
        target=target,
        gain=float(gain[i]),
        peak_force=float(answers[i, 0]),
        sliding_distance=float(answers[i, 1]),
        before=dict(zip(labels, before.tolist(), strict=True)),
        after=dict(zip(labels, after[i].tolist(), strict=True)),
        best=tuple(
            {
                "velocity_m_per_s": float(v[x]),
                "mass_kg": float(m[x]),
                "gain_log_det": float(gain[x]),
            }
            for x in order[:_SHOWN]
        ),
        candidates={"velocity": v, "mass": m, "gain": gain, "information": added, "after": after},
        notes=tuple(notes),
    )


@dataclass(frozen=True)
class _Designs:
    """N pushes that might be made."""

    velocity: NDArray
    """(N,) [m/s]"""
    mass: NDArray
    """(N,) [kg]"""
    pushes: TablePush | TracePush
    """stacked, each like the fit's push nearest in speed"""
    fixed: NDArray
    """(N, coordinates) those that are not free, as in a `Layout`"""
    selection: NDArray
    """(N, coordinates, free) as in a `Layout`"""
    weights: NDArray
    """(N, rows) 1 / standard error of what would be measured"""


def _lay_out_designs(
    fit: Fit, speeds: Sequence[float] | None, masses: Sequence[float] | None, example: int
) -> _Designs:
    """Every speed with every mass, in the condition of the fit's push `example`.

    Raises `InputError` for speeds or masses that are not positive.
    """
    layout, data = fit.state.model.layout, fit.state.data
    mass_at = coordinates.names(fit.state.model.rig).index("mass_kg")
    v_data = np.asarray(data.pushes.velocity)[: data.n]
    known_masses = np.unique(np.exp(layout.fixed[:, mass_at]))
    if "mass_kg" in fit.names:
        known_masses = np.array([float(fit.rig.mass)])
    ends = [x * units.MM_PER_MIN for x in SPEEDS_MM_MIN]
    usual = np.geomspace(min(*ends, v_data.min()), max(*ends, v_data.max()), _CANDIDATES)
    v = _check_candidates(speeds, usual, "speeds [m/s]")
    m = _check_candidates(masses, known_masses, "masses [kg]")
    v, m = (x.ravel() for x in np.meshgrid(v, m, indexing="ij"))
    like = np.argmin(np.abs(np.log(v[:, None] / v_data)), axis=1)
    pushes: Any = jax.tree.map(lambda a: np.asarray(a)[like], data.pushes)
    fixed = np.repeat(layout.fixed[example : example + 1], len(v), axis=0)
    if "mass_kg" not in fit.names:
        fixed[:, mass_at] = to_coordinate("mass_kg", m)
    return _Designs(
        velocity=v,
        mass=m,
        pushes=pushes._replace(velocity=v),
        fixed=fixed,
        selection=np.repeat(layout.selection[example : example + 1], len(v), axis=0),
        weights=_weigh_rows(data, fit.state.at)[like],
    )


def _check_candidates(given: Sequence[float] | None, usual: NDArray, what: str) -> NDArray:
    values = usual if given is None else np.atleast_1d(np.asarray(given, float))
    if not values.size or not (np.isfinite(values) & (values > 0)).all():
        raise InputError(f"next_push: {what} are {values.tolist()}: expected numbers > 0")
    return values


def _weigh_rows(data: FitData, at: Settled) -> NDArray:
    """1 / standard error of each row of the fit's pushes (n, rows); where a push lacks one that
    others have, theirs."""
    own = np.concatenate([at.spreads, [1.0]])[data.group]
    weights = data.weights / own
    typical = np.array([np.median(w[w > 0]) if (w > 0).any() else 0.0 for w in weights.T])
    return np.where(weights > 0, weights, typical)


def _expect_information(fit: Fit, designs: _Designs) -> tuple[NDArray, NDArray]:
    """The information (N, free, free) that each design would add, averaged over its own mu_s; and
    its F_p and d (N, 2) at the shared mu_s."""
    model, data, at = fit.state.model, fit.state.data, fit.state.at
    added, answers = np.zeros(()), np.zeros(())
    for node, share in _average_over_normal() if at.scatter > 0 else ((0.0, 1.0),):
        fixed = designs.fixed.copy()
        fixed[:, 0] += node * at.scatter
        derivatives, found = responses(
            model, data, at.theta, designs.pushes, fixed, designs.selection
        )
        added = added + share * information(
            derivatives, designs.weights, designs.selection, at.scatter, model.free_start
        )
        answers = found if node == 0 else answers
    return added, answers


def _average_over_normal() -> list[tuple[float, float]]:
    """(value, weight) of the nodes of Gauss-Hermite quadrature, the middle one first."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    pairs = zip(nodes.tolist(), (weights / weights.sum()).tolist(), strict=True)
    return sorted(pairs, key=lambda pair: abs(pair[0]))


def _find_usable(fit: Fit, added: NDArray, answers: NDArray) -> tuple[NDArray, list[str]]:
    """Which designs (N,) slide a distance and stay within the sensor's range; and notes.

    Raises `InputError` where none does.
    """
    limit = float(fit.rig.force_sensor.range)
    exists, within = np.isfinite(answers).all(axis=1), answers[:, 0] <= limit
    good = exists & within & np.isfinite(added).all(axis=(1, 2))
    notes = []
    if (~exists).any():
        notes.append(f"{int((~exists).sum())} candidates have no sliding distance: left out")
    if (exists & ~within).any():
        count = int((exists & ~within).sum())
        notes.append(f"{count} candidates exceed the force sensor's {limit:g} N: left out")
    if not good.any():
        raise InputError(
            f"next_push: none of {len(good)} candidates can be used: {'; '.join(notes)}"
        )
    if fit.kind == TABLE and fit.state.model.rig.pusher.stroke is None:
        notes.append("no stroke is given: the pusher is taken to stop at the first loss of contact")
    return good, notes


def _gather_information(fit: Fit, keep: list[int]) -> NDArray:
    """The information (keep, keep) that the fit's data hold on the parameters `keep`: the inverse
    of the covariance that the fit tells."""
    covariance = fit.covariance[np.ix_(keep, keep)]
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    values = np.maximum(values, _LEAST_VARIANCE * values.max())
    now = (vectors / values) @ vectors.T / np.outer(size, size)
    unit = open_units(fit.rig, [fit.names[j] for j in keep], fit.fastest_speed)
    return now + np.diag(_VAGUE / unit**2)
