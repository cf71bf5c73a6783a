"""The fit of whole recordings: from where peaks and distances lead, down every sample."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.mu_s_branches import find_branches
from difffric.calibration.multistart import (
    ALIKE,
    REFINED,
    descend_from,
    search_roughly,
    tell_best_fit,
)
from difffric.calibration.result import FitState
from difffric.calibration.table_starts import fit_forces
from difffric.errors import InputError, NumericalError
from difffric.estimation import coordinates
from difffric.estimation.descent import (
    Model,
    Settled,
    blind_to_motion,
    descend,
    first_point,
    prepare_descent,
    take_end,
)
from difffric.estimation.mixed_fit import ROUNDS, settle
from difffric.estimation.push_friction import rescan_push_friction, spread_push_friction
from difffric.estimation.stacked_data import (
    FitData,
    as_if_white,
    table_data,
    traces_data,
)
from difffric.measurements.noise import Noise
from difffric.measurements.reduction.reduce import Reduction
from difffric.progress import Tell
from difffric.rig import parameters

_LOOSE = 1e-5
"""How far a distance may be off [m] where it only leads to a start."""
_FITS = 1.15
"""A reduced chi-square above this makes a fit try its other starts too, until two agree."""
_COLOURED = 0.3
"""Noise more correlated than this is first taken to be white: differences of samples, which
whitening looks at, have a narrower basin than the samples."""
_TRUST = 1e3
"""How far a descent trusts its linear model at first: farther than with a table, as thousands of
samples determine every parameter well."""
_GUARD = 2e-5
"""How far a free start may move a jump [s]: samples that near are left out."""
_LAST_ROUNDS = 4
"""Rounds between mode and variances that are as good as all, once the start is near."""
_ROUGH_STEPS = 15
"""Steps of a fit of F_p that only leads to where the samples decide."""
_SAME_JUMPS = 2e-6
"""Jumps that moved by less than this [s] leave out the same samples."""
_POOR = 1.15
"""A push whose chi-square per sample is above this may have its mu_s on a wrong branch."""


@dataclass(frozen=True)
class NearStart:
    """A start near the optimum, beside the shared coordinates."""

    log_mu: NDArray
    """(n,) of each push"""
    scatter: float
    """of mu_s"""
    worth: float
    """what a step has to gain in chi-square"""


@dataclass(frozen=True)
class RecordingSearch:
    """The search for the fit of recordings."""

    model: Model
    """what of the rig is free"""
    reduction: Reduction
    """the recordings, with what they say without a model"""
    box: list[NDArray]
    """(free,) each: shared coordinates to start from, the set-up's own first"""
    tell: Tell
    """is called with the progress"""
    thorough: bool = True
    """whether further starts are followed where the fit is poor"""
    near: NearStart | None = None
    """what is known besides where the first of the starts is near the optimum: it is then the only
    one; None: it is not known to be"""

    def run(self) -> tuple[FitState, tuple[int, int]]:
        """The best fit, and how many of the starts that were followed lead to it.

        Raises `NumericalError` where no start gives a finite misfit.
        """
        compiling = self._compile_ahead()
        best, reached, tried = None, 0, 0
        for start in self._find_starts():
            compiling.join()
            tried += 1
            self.tell("fitting every sample", 0.4 + 0.1 * min(tried, 5))
            try:
                found = self._follow(start)
            except NumericalError:
                continue
            chi2 = found.at.components.chi2
            if best is None or chi2 < best.at.components.chi2 - ALIKE:
                best, reached = found, 0
            reached += chi2 < best.at.components.chi2 + ALIKE
            good = best.at.components.chi2 < _FITS * best.data.samples
            if reached > 1 or good or not self.thorough:
                return best, (reached, tried)
        if best is None:
            raise NumericalError("fit: no start gives a finite misfit")
        return best, (reached, tried)

    def _find_starts(self) -> Iterator[Settled | None]:
        """Where peaks and distances lead, the cheaper search first; at last None, the set-up.

        A search begins when the starts of the one before it are used up.
        """
        searches = (self._start_from_forces, self._start_from_table)
        for search in searches if self.near is None else ():
            try:
                starts = search()
            except (InputError, NumericalError):
                continue
            yield from starts
        yield None

    def _stack_loose_table(self) -> tuple[Model, FitData]:
        """Peaks and distances, which only lead to where the samples decide."""
        rig = self.model.rig
        rig, data = table_data(rig, self.reduction.pushes, rig.sensor_errors)
        sd = np.hypot(1.0 / np.maximum(data.rough, 1e-300), [0.0, _LOOSE])
        rough = np.where(data.rough > 0, 1.0 / sd, 0.0)
        return replace(self.model, rig=rig, free_start=False), replace(data, rough=rough)

    def _start_from_forces(self) -> list[Settled]:
        """Where F_p alone and then d too lead."""
        model, data = self._stack_loose_table()
        data = replace(data, in_few_steps=True)
        found = fit_forces(model, data, self.box, _ROUGH_STEPS)
        if found is None:
            return []
        starts = [found.theta, self.box[0]]
        return [at for _, at, _ in descend_from(model, data, starts, self.tell)[:1]]

    def _start_from_table(self) -> list[Settled]:
        """Where the whole search of a table leads."""
        model, data = self._stack_loose_table()
        return [at for _, at, _ in search_roughly(model, data, self.box, self.tell)[:REFINED]]

    def _compile_ahead(self) -> Thread:
        """Have the program that fits the samples made ready, beside those that the searches need.

        It takes the longest: it is begun first.
        """
        model, data = self._stack_samples(None)
        at = first_point(model, data, self.box[0])
        compiling = Thread(target=prepare_descent, args=(model, data, at), daemon=True)
        compiling.start()
        return compiling

    def _stack_samples(
        self, jumps: NDArray | None, stiffest: float = 0.0, at: Settled | None = None
    ) -> tuple[Model, FitData]:
        """The samples as a fit takes them, without those beside the `jumps` [s] of each push, and
        blind to what the errors of recorded motions do to the pushes as they are `at` a point.

        Blocks suit a contact of `stiffest` [N/m], or one as much stiffer than the set-up says as a
        rough guess may be off.
        """
        rig, pushes = self.model.rig, self.reduction.pushes
        known = float(parameters.values(rig)["k_N_per_m"])
        rough = parameters.PARAMETERS["k_N_per_m"].roughness or 1.0
        lightest = np.nanmin([float(rig.mass), *pushes.mass])
        rig, data = traces_data(
            rig,
            self.reduction.recordings,
            self.reduction.details,
            float(np.sqrt(2 * max(stiffest, rough * known) / lightest)),
            len(coordinates.names(rig)),
            jumps,
            _GUARD if self.model.free_start else 0.0,
            pushes.motion,
        )
        worth = self.near.worth if self.near is not None else 0.0
        model, data = replace(self.model, rig=rig), replace(data, worth=worth)
        if pushes.motion is not None:
            data = blind_to_motion(model, data, self.reduction.recordings, at)
        return model, data

    def _follow(self, start: Settled | None) -> FitState:
        """Fit the samples, leaving out those beside the jumps of the model as it stands."""
        theta = self.box[0] if start is None else start.theta
        named = self.model.layout.value(theta).items()
        stiffest = max([0.0, *(v for x, v in named if x.startswith("k_N_per_m"))])
        model, data = self._stack_samples(None, stiffest)
        at = first_point(model, data, theta)
        if start is not None:
            at = replace(at, s_eta=start.s_eta)
        coloured = any(abs(x.correlation) > _COLOURED for x in self._channel_noise())
        if coloured and self.near is None:
            rough = settle(model, as_if_white(data), at, trust=_TRUST, rounds=_LAST_ROUNDS)
            at = replace(first_point(model, data, rough.theta), s_eta=rough.s_eta)
        rounds, elsewhere = ROUNDS, [self._find_branches, spread_push_friction]
        if self.near is None:
            at = settle(model, data, at, trust=_TRUST, rounds=rounds)
            tell_best_fit(model, at, self.tell)
        else:  # where its jumps are is as good as known
            rounds, elsewhere = 2 * _LAST_ROUNDS, []
            at = self._look_near(model, data, at, self.near)
        while rounds > _LAST_ROUNDS:
            jumps = np.asarray(at.end.jumps)[: data.n]
            model, data = self._stack_samples(jumps, stiffest, at)
            rounds //= 2
            at = settle(model, data, at, trust=_TRUST, rounds=rounds)
            while elsewhere and (poor := _misfit_of_pushes(data, at) > _POOR).any():
                other = rescan_push_friction(model, data, at, elsewhere.pop(0)(at), poor)
                at = at if other is at else settle(model, data, other, trust=_TRUST)
            if _are_same(jumps, np.asarray(at.end.jumps)[: data.n]):
                break
        return FitState(model, data, at)

    def _look_near(self, model: Model, data: FitData, at: Settled, near: NearStart) -> Settled:
        """The samples as they are at a start near the optimum, without a step."""
        c = model.layout.fixed + model.layout.selection @ at.theta
        scatter = near.scatter if model.estimate_scatter else at.scatter
        at = replace(at, s_eta=near.log_mu - c[:, 0], scatter=scatter)
        end = descend(model, data, at, at.held, at.weights, scatter, _TRUST, steps=1)
        return take_end(at, end, at.held, scatter)

    def _channel_noise(self) -> list[Noise]:
        found = self.reduction.details[0]
        return [x for x in (found.noise_force, found.noise_position) if x is not None]

    def _find_branches(self, at: Settled) -> list[NDArray]:
        """Each push's log mu_s by which F_p and d are as they were measured."""
        model, data = self._stack_loose_table()
        data = replace(data, in_few_steps=True)
        return find_branches(model, data, replace(at, weights=data.rough))


def _misfit_of_pushes(data: FitData, at: Settled) -> NDArray:
    """(n,) each push's chi-square per sample."""
    rows = at.weights * np.asarray(at.end.rows)[: data.n, :, -1]
    return np.sum(rows**2, axis=1) / data.samples_of


def _are_same(old: NDArray, new: NDArray) -> bool:
    return old.shape == new.shape and bool(np.allclose(old, new, atol=_SAME_JUMPS, rtol=0))
