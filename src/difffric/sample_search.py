"""The fit of whole recordings: from where peaks and distances lead, down every sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from difffric import coordinates, parameters
from difffric.errors import InputError, NumericalError
from difffric.first_search import fit_of_forces
from difffric.fit_data import FitData, sensor_errors, table_data, traces_data
from difffric.reduction import Reduction
from difffric.searches import ALIKE, FACTORS, REFINED, Tell, descents, first_search
from difffric.settling import ROUNDS, Model, Settled, descend, first_point, settle, unstuck

_LOOSE = 1e-5
"""How far a distance may be off [m] where it only leads to a start."""
_FITS = 1.5
"""A reduced chi-square above this makes a fit try its other starts too."""
_TRUST = 1e3
_GUARD = 2e-5
"""How far a free start may move a jump [s]: samples that near are left out."""
_LAST_ROUNDS = 4
_POOR = 1.5
"""A push whose chi-square per sample is above this may have its mu_s on a wrong branch."""


@dataclass(frozen=True)
class SampleSearch:
    """Fits the recordings of `reduction`; `model` says what of the rig is free."""

    model: Model
    reduction: Reduction
    box: list[NDArray]
    """starts"""
    tell: Tell

    def run(self) -> tuple[Model, FitData, Settled, tuple[int, int]]:
        """The best fit, and how many of the starts that were followed lead to it.

        Raises `NumericalError` where no start gives a finite misfit.
        """
        compiling = Thread(target=self._compile, daemon=True)
        compiling.start()  # beside the programs that the searches need
        best, reached, tried = None, 0, 0
        searches: tuple[Callable[[], list[Settled | None]], ...] = (
            self._forces_first, self._tables_first, lambda: [None],
        )  # fmt: skip
        for search in searches:
            try:
                starts = search()
            except (InputError, NumericalError):
                continue
            compiling.join()
            for start in starts:
                tried += 1
                self.tell("fitting every sample", 0.4 + 0.1 * min(tried, 5))
                try:
                    found = self._follow(start)
                except NumericalError:
                    continue
                chi2 = found[2].components.chi2
                if best is None or chi2 < best[2].components.chi2 - ALIKE:
                    best, reached = found, 0
                reached += chi2 < best[2].components.chi2 + ALIKE
                if best[2].components.chi2 < _FITS * best[1].samples:
                    return *best, (reached, tried)
        if best is None:
            raise NumericalError("fit: no start gives a finite misfit")
        return *best, (reached, tried)

    def _loose_table(self) -> tuple[Model, FitData]:
        """Peaks and distances, which only lead to where the samples decide."""
        rig = self.model.rig
        rig, data = table_data(rig, self.reduction.pushes, sensor_errors(rig))
        sd = np.hypot(1.0 / np.maximum(data.rough, 1e-300), [0.0, _LOOSE])
        data = replace(data, rough=np.where(data.rough > 0, 1.0 / sd, 0.0))
        return replace(self.model, rig=rig, free_start=False), data

    def _forces_first(self) -> list[Settled | None]:
        """Where F_p alone and then d too lead."""
        model, data = self._loose_table()
        found = fit_of_forces(model, data, self.box)
        if found is None:
            return []
        starts = [found[0].theta, self.box[0]]
        return [at for _, at, _ in descents(model, data, starts, self.tell)[:1]]

    def _tables_first(self) -> list[Settled | None]:
        """Where the whole search of a table leads."""
        model, data = self._loose_table()
        return [at for _, at, _ in first_search(model, data, self.box, self.tell)[:REFINED]]

    def _compile(self) -> None:
        """Have the program that fits the samples compiled."""
        try:
            model, data = self._samples(None)
            at = first_point(model, data, self.box[0])
            descend(model, data, at, at.held, data.weights, max(model.scatter, 1e-3), _TRUST, 0)
        except Exception:  # the fit itself will say what is wrong
            return

    def _samples(self, jumps: NDArray | None, stiffest: float = 0.0) -> tuple[Model, FitData]:
        """The samples as a fit takes them, in blocks that suit a contact `stiffest` [N/m], or
        three times as stiff as the set-up says."""
        rig, pushes = self.model.rig, self.reduction.pushes
        known = float(parameters.values(rig)["k_N_per_m"])
        lightest = np.nanmin([float(rig.mass), *pushes.mass])
        rig, data = traces_data(
            rig,
            self.reduction.recordings,
            self.reduction.details,
            float(np.sqrt(2 * max(stiffest, FACTORS["k_N_per_m"] * known) / lightest)),
            len(coordinates.names(rig)),
            jumps,
            _GUARD if self.model.free_start else 0.0,
        )
        return replace(self.model, rig=rig), data

    def _follow(self, start: Settled | None) -> tuple[Model, FitData, Settled]:
        """Fit the samples, leaving out those beside the jumps of the model as it stands."""
        theta = self.box[0] if start is None else start.theta
        named = self.model.layout.value(theta).items()
        stiffest = max([0.0, *(v for x, v in named if x.startswith("k_N_per_m"))])
        jumps, at, rounds = None, start, ROUNDS
        while True:
            model, data = self._samples(jumps, stiffest)
            fresh = first_point(model, data, theta)
            if at is None:
                at = fresh
            elif jumps is None:
                at = replace(fresh, s_eta=at.s_eta)
            at = settle(model, data, at, trust=_TRUST, rounds=rounds)
            if jumps is None and (_misfit(data, at) > _POOR).any():
                at = settle(model, data, unstuck(model, data, at), trust=_TRUST)
            new = np.asarray(at.end.jumps)[: data.n]
            if rounds <= _LAST_ROUNDS or (jumps is not None and _same(jumps, new)):
                return model, data, at
            jumps, rounds = new, rounds // 2


def _misfit(data: FitData, at: Settled) -> NDArray:
    """(n,) each push's chi-square per sample."""
    rows = at.weights * np.asarray(at.end.rows)[: data.n, :, -1]
    return np.sum(rows**2, axis=1) / data.samples_of


def _same(old: NDArray, new: NDArray) -> bool:
    return old.shape == new.shape and bool(np.allclose(old, new, atol=2e-6, rtol=0))
