"""The push that would settle what some measurements leave open.

Two models that explain the same table differ somewhere else: in another friction, at another speed.
Where they differ most, in units of the errors with which one measures, one push decides. And a
number that is hardly determined becomes so by the push whose F_p and d depend on it most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.result import Fit
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.columns import differentiate_columns, observe_columns
from difffric.studies.published_tables import assume_errors
from difffric.units import from_mm_min

SPEEDS_MM_MIN = np.array(
    [300.0, 500.0, 750.0, 1000.0, 1500.0, 2000.0, 3000.0, 4000.0, 5000.0, 7000.0]
)
FRICTIONS = (0.08, 0.14, 0.25)
"""mu_s of parts that one can have: between them lie the paper's two conditions."""


@dataclass(frozen=True)
class Proposal:
    """A push that would tell two models apart, or determine a number."""

    velocity_mm_min: float
    mu_s: float
    purpose: str
    """what it decides"""
    before: float
    """of a number: its standard error [SI]; of two models: 0"""
    after: float
    """of a number: its standard error with the push; of two models: how many standard errors they
    are apart there"""
    quantity: str
    """which of the two numbers of the push says most: F_p or d"""

    def as_dict(self) -> dict:
        """As `result.json` holds it."""
        return dict(vars(self))


def tell_apart(one: Rig, other: Rig, purpose: str) -> Proposal:
    """The push in which two models differ most."""
    v, mu = (x.ravel() for x in np.meshgrid(from_mm_min(SPEEDS_MM_MIN), FRICTIONS, indexing="ij"))
    seen = [observe_columns(parameters.with_values(rig, {"mu_s": mu}), v) for rig in (one, other)]
    first, second = (np.stack([s.peak_force, s.sliding_distance], axis=1) for s in seen)
    apart = np.abs(first - second) / np.sqrt(2) / np.stack(assume_errors(*first.T), axis=1)
    apart = np.nan_to_num(apart)
    best = int(np.argmax(apart.max(axis=1)))
    return Proposal(
        float(np.repeat(SPEEDS_MM_MIN, len(FRICTIONS))[best]),
        float(mu[best]),
        purpose,
        0.0,
        float(apart[best].max()),
        ("F_p", "d")[int(np.argmax(apart[best]))],
    )


def determine(fit: Fit, names: Sequence[str]) -> list[Proposal]:
    """For each number of a fit [SI] the push that would determine it best."""
    labels = [x for x in fit.free if fit.standard_error(x) is not None]
    index = [fit.index(x) for x in labels]
    errors = np.array([fit.standard_error(x) or 0.0 for x in labels])
    C = fit.correlation[np.ix_(index, index)] * np.outer(errors, errors)
    v, mu = (x.ravel() for x in np.meshgrid(from_mm_min(SPEEDS_MM_MIN), FRICTIONS, indexing="ij"))
    rig = parameters.with_values(fit.rig, {"mu_s": mu})
    seen, by = differentiate_columns(rig, v, labels)
    J = np.stack([by.peak_force.T, by.sliding_distance.T], axis=1)
    F, d = np.asarray(seen.peak_force), np.asarray(seen.sliding_distance)
    sd = np.stack(assume_errors(F, d), axis=1)
    J = np.nan_to_num(J / sd[:, :, None])
    after = np.stack([_add_rows(C, rows) for rows in J])
    out = []
    for name in names:
        j = labels.index(name)
        best = int(np.argmin(after[:, j]))
        alone = [_add_rows(C, J[best, [q]])[j] for q in (0, 1)]
        out.append(
            Proposal(
                float(np.repeat(SPEEDS_MM_MIN, len(FRICTIONS))[best]),
                float(mu[best]),
                name,
                float(errors[j]),
                float(after[best, j]),
                ("F_p", "d")[int(np.argmin(alone))],
            )
        )
    return out


def _add_rows(C: NDArray, rows: NDArray) -> NDArray:
    """Standard errors of numbers of the covariance C once `rows` (m, P) are measured too, each in
    units of its error."""
    S = rows @ C @ rows.T + np.eye(len(rows))
    new = C - C @ rows.T @ np.linalg.solve(S, rows @ C)
    return np.sqrt(np.maximum(np.diag(new), 0.0))
