"""Measured pushes with all that it takes to turn their readings into mu_s, looked up once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from difffric.compute.pytrees import map_tree
from difffric.estimation import coordinates
from difffric.estimation.push_rigs import make_push_rigs
from difffric.identification.inversion import BRACKET, Inversion, choose_by_force, invert_both
from difffric.identification.push_models import (
    PushModels,
    compute_range_ratio,
    differentiate_models,
)
from difffric.measurements.pushes import COLUMNS, Pushes
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup
from difffric.simulation.events import Regime
from difffric.simulation.families import MU_S, SPEEDS_MM_MIN
from difffric.simulation.observables import regime_of
from difffric.simulation.segments import Integrator
from difffric.units import from_mm_min

if TYPE_CHECKING:
    from difffric.calibration.result import Fit


@dataclass(frozen=True)
class Calibration:
    """What is known of the rig: its values by condition, and how uncertain they are."""

    rig: Rig
    names: tuple[str, ...]
    """calibrated parameters, without mu_s"""
    of: Callable[[str], tuple[Rig, NDArray]]
    """condition -> rig, covariance of the coordinates of `names`"""
    spreads: tuple[float, float]
    """of F_p [N] and d [m], as the calibration found them; NaN: it did not"""
    setup: Setup
    """the set-up that it is of"""

    @classmethod
    def read(cls, rig: Rig | Setup | Fit) -> Calibration:
        """From a fit its covariance, from a set-up its standard errors (without correlations)."""
        if not isinstance(rig, Rig | Setup):
            fit = rig
            names = tuple(dict.fromkeys(n for n in fit.names if n != "mu_s"))

            def of_fit(condition: str) -> tuple[Rig, NDArray]:
                at, columns = fit.for_condition(condition)
                here = [j for j, n in enumerate(names) if n in columns]
                found = [columns[names[j]] for j in here]
                covariance = np.zeros((len(names), len(names)))
                covariance[np.ix_(here, here)] = fit.covariance[np.ix_(found, found)]
                return at, covariance

            spreads = fit.spread_force, fit.spread_distance
            return cls(fit.rig, names, of_fit, spreads, replace(fit.setup, rig=fit.rig))
        setup = rig if isinstance(rig, Setup) else Setup(rig)
        said = {
            name: x.standard_error
            for name, x in setup.extras.items()
            if name != "mu_s" and x.standard_error
        }
        values = parameters.values(setup.rig) if said else {}
        errors = {name: error for name, error in said.items() if name in values}
        variance = [(e / coordinates.slope(n, float(values[n]))) ** 2 for n, e in errors.items()]
        return cls(
            setup.rig,
            tuple(errors),
            lambda condition: (setup.rig, np.diag(variance)),
            (np.nan, np.nan),
            setup,
        )


@dataclass(frozen=True)
class ResolvedPushes:
    """n measured pushes on calibrated rigs of one kind: everything is looked up, an entry a push,
    so that inverting and combining need nothing else. Rigs of one kind have the same laws and the
    same calibrated parameters."""

    pushes: Pushes
    models: PushModels
    """F_p and d over mu_s, at the rig's values for the condition and the push's mass and stroke"""
    names: tuple[str, ...]
    """the k calibrated parameters, without mu_s"""
    roots: NDArray
    """(n, k, k) R with R R^T the covariance of their coordinates"""
    errors: NDArray
    """(n, 2) standard errors of F_p [N] and d [m]: the push's own, else the calibration's spread,
    else what the sensors explain; NaN: not known"""
    sensor_errors: NDArray
    """(n, 2) likewise, but without the calibration's spread"""
    range_ratio: NDArray
    """(n,) equation (7)'s ratio of the ranges [N/m]; NaN for free slides, which have no (7)"""

    @classmethod
    def of(
        cls,
        known: Calibration,
        pushes: Pushes,
        *,
        integrator: Integrator | None = None,
        range_ratio: float | None = None,
        compiled: bool | None = None,
    ) -> ResolvedPushes:
        """Look everything up. `range_ratio` is that of the paper's range unless given; `compiled`
        as for `PushModels.of`."""
        conditions, which = np.unique(np.array(pushes.condition, object), return_inverse=True)
        found = [known.of(condition) for condition in conditions]
        roots = np.stack([root_of(covariance) for _, covariance in found])
        if range_ratio is None:
            free = pushes.free_slides
            range_ratio = np.nan if free else _find_range_ratio(known, integrator)
        sensors = known.rig.sensor_errors
        fallback = [s if np.isnan(f) else f for f, s in zip(known.spreads, sensors, strict=True)]
        rigs = _spread([rig for rig, _ in found], which, pushes)
        return cls(
            pushes,
            PushModels.of(rigs, pushes.velocity, integrator, compiled),
            known.names,
            roots[which],
            fill_errors(pushes, fallback),
            fill_errors(pushes, sensors),
            np.full(len(pushes), range_ratio),
        )

    def __len__(self) -> int:
        return len(self.pushes)

    def pick(self, index: NDArray) -> ResolvedPushes:
        """Some of the pushes, by an array of indices, which may repeat."""
        arrays = (self.roots, self.errors, self.sensor_errors, self.range_ratio)
        roots, errors, sensors, ratio = (x[index] for x in arrays)
        pushes, models = self.pushes.select(index), self.models.pick(index)
        return ResolvedPushes(pushes, models, self.names, roots, errors, sensors, ratio)

    def with_readings(self, pushes: Pushes) -> ResolvedPushes:
        """The same pushes, read anew: their own standard errors count, and else what stood here."""
        return replace(
            self,
            pushes=pushes,
            errors=fill_errors(pushes, self.errors),
            sensor_errors=fill_errors(pushes, self.sensor_errors),
        )

    @classmethod
    def join(cls, parts: Sequence[ResolvedPushes]) -> ResolvedPushes:
        """The pushes of several rigs of one kind, one after the other."""

        def join_columns(name: str) -> NDArray:
            return np.concatenate([getattr(x, name) for x in parts])

        columns: dict[str, Any] = {
            name: np.concatenate([getattr(x.pushes, name) for x in parts]) for name in COLUMNS
        }
        # NumPy's arrays: JAX's take a hundred times as long to index.
        rigs = [map_tree(np.asarray, x.models.rigs) for x in parts]
        rigs = map_tree(lambda *leaves: np.concatenate(leaves), *rigs)
        pushes, first = Pushes(**columns), parts[0]
        return cls(
            pushes,
            PushModels(rigs, pushes.velocity, first.models.integrator, first.models.compiled),
            first.names,
            *map(join_columns, ("roots", "errors", "sensor_errors", "range_ratio")),
        )

    def invert(
        self, bracket: tuple[float, float] = BRACKET
    ) -> tuple[list[Inversion], list[Inversion]]:
        """What F_p and what d of each push say of mu_s. Of several mu_s for one d the measured
        force chooses."""
        pushes = self.pushes
        force, distance = invert_both(
            self.models, pushes.peak_force, pushes.sliding_distance, bracket
        )
        return force, choose_by_force(self.models, distance, pushes.peak_force)

    def differentiate(
        self, force: Sequence[Inversion], distance: Sequence[Inversion]
    ) -> tuple[NDArray, list[str | None]]:
        """(n, 2, k) the derivatives of F_p at the force's mu_s, and of d at the distance's, by the
        coordinates of the calibrated parameters; and the regime between the two, None where
        neither is known."""
        n, k = len(self), len(self.names)
        mu = np.array([[x.value or np.nan for x in xs] for xs in (force, distance)])
        known = np.isfinite(mu).sum(axis=0)
        middle = np.nansum(mu, axis=0) / np.maximum(known, 1)
        points = np.stack([*mu, middle], axis=1)
        points = np.where(np.isfinite(points) & (points > 0), points, 0.1).ravel()
        models = self.models.pick(np.repeat(np.arange(n), 3))
        if self.names:
            gradient, regime = differentiate_models(models, points, self.names)
        else:
            gradient, regime = np.empty(0), regime_of(models.observe_values_at(points)[2])
        gradient = np.asarray(gradient).reshape(n, 3, 2, k)
        regime = np.asarray(regime).reshape(n, 3)[:, 2]
        names = [Regime(int(r)).word if has else None for r, has in zip(regime, known, strict=True)]
        return np.stack([gradient[:, 0, 0], gradient[:, 1, 1]], axis=1), names


def root_of(covariance: NDArray) -> NDArray:
    """R with R R^T the covariance, which may be singular: of a parameter that is held."""
    variance, axes = np.linalg.eigh(covariance)
    return axes * np.sqrt(np.maximum(variance, 0.0))


def fill_errors(pushes: Pushes, fallback: NDArray | Sequence[float | None]) -> NDArray:
    """(n, 2) standard errors of F_p [N] and d [m]: the pushes' own, else `fallback` (2,) or
    (n, 2), where None and NaN say that it is not known."""
    own = np.stack([pushes.peak_force_se, pushes.sliding_distance_se], axis=1)
    return np.where(np.isnan(own), np.asarray(fallback, float), own)


def _find_range_ratio(known: Calibration, integrator: Integrator | None) -> float:
    """Equation (7)'s ratio of the ranges [N/m] over the paper's speeds and mu_s."""
    v, mu_s = (x.ravel() for x in np.meshgrid(from_mm_min(SPEEDS_MM_MIN), MU_S, indexing="ij"))
    rigs = _spread([known.rig], np.zeros(len(v), int), Pushes(velocity=v))
    return compute_range_ratio(PushModels.of(rigs, v, integrator), mu_s)


def _spread(rigs: Sequence[Rig], which: NDArray, pushes: Pushes) -> Rig:
    """The rig of each push: that of its condition, with its own mass and stroke."""
    if all(rig is rigs[0] for rig in rigs):  # a set-up's: it knows of no conditions
        return make_push_rigs(rigs[0], pushes)
    every = [make_push_rigs(rig, pushes) for rig in rigs]
    here = np.arange(len(pushes))
    return map_tree(lambda *leaves: np.stack(leaves)[which, here], *every)
