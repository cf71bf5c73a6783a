"""Calibration: the rig's parameters, each push's mu_s and its scatter, from measured pushes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from difffric.calibration.multistart import best_fit, box_of_starts
from difffric.calibration.recording_search import SampleSearch
from difffric.calibration.result import Fit
from difffric.calibration.result_builder import result
from difffric.errors import InputError
from difffric.estimation.coordinates import Layout, layout
from difffric.estimation.mixed_fit import Model
from difffric.estimation.stacked_data import (
    FitData,
    sensor_errors,
    slides_data,
    strokes_of,
    table_data,
)
from difffric.measurements.checks import checked_data
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.measurements.reduction.reduce import Reduction, reduce_recordings
from difffric.progress import Tell, silent
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup, check_rig
from difffric.simulation.segments import Integrator, default_integrator

FREE = ("k_N_per_m", "b_N_s_per_m", "k_v_N_s_per_m", "mu_s")
"""What a calibration determines by default; mu_s only where no gauge says it."""

_SCATTER = 0.03
"""Where the scatter's estimate starts."""


def rigs_of(rig: Rig, pushes: Pushes) -> Rig:
    """The rig spread over the pushes, each with its own mass and stroke where they say so."""
    rigs = parameters.spread(rig, len(pushes))
    mass = np.where(np.isnan(pushes.mass), rigs.mass, pushes.mass)
    rigs = parameters.with_values(rigs, {"mass_kg": mass})
    _, strokes = strokes_of(rig, pushes.stroke)
    if rig.pusher.stroke is None and np.isinf(strokes).all():
        return rigs
    return parameters.with_stroke(rigs, np.asarray(strokes))


def fit(
    rig: Rig | Setup,
    data: Pushes | Recordings,
    *,
    free: Sequence[str] | None = None,
    per_condition: Sequence[str] = ("mu_s",),
    priors: bool = False,
    free_start: bool = False,
    robust: bool = False,
    several_starts: bool = True,
    thorough: bool = True,
    use_data_mass: bool = False,
    skip_bad: bool = False,
    tell: Tell = silent,
    integrator: Integrator | None = None,
) -> Fit:
    """Calibrate a rig on measured pushes: a table, whole recordings, or free slides.

    `free` parameters are by name, shared by all pushes or (`per_condition`) one for each
    condition; by default k, b, k_v and mu_s, and what the set-up's tables say. mu_s of each
    push scatters about its condition's, and the scatter is estimated with the rest (restricted
    maximum likelihood). Where every push says its `mu_s_gauge` that is its mu_s, and there is
    neither a scatter nor a free mu_s. Where no standard errors are known, the spreads of F_p
    and d are estimated too.

    `priors` takes the set-up's standard errors as knowledge from other data; its bounds always
    hold. `free_start` gives each recorded push a start offset of its own; `robust` lets
    outliers of a table weigh less (Huber); `tell(what, share done)` hears of the progress.
    Unless `thorough`, recordings are followed from the best start alone, however poor the fit.

    Raises `InputError` for data that cannot be used (see `data_checks`), for fewer
    measurements than free parameters and for parameters that are unknown or said by the data;
    `NumericalError` where no start gives a finite misfit.
    """
    setup = rig if isinstance(rig, Setup) else Setup(rig)
    rig = check_rig(setup.rig)
    if isinstance(data, Recordings):
        data = checked_data(data, rig, use_data_mass=use_data_mass, skip_bad=skip_bad)
    else:
        data = checked_data(data, rig, use_data_mass=use_data_mass, skip_bad=skip_bad)
    integrator = integrator or default_integrator(rig)
    if robust and isinstance(data, Recordings):
        raise InputError("robust: expected a table; recordings are fitted sample by sample")
    if isinstance(data, Recordings):
        tell("reducing the recordings", 0.0)
        reduction = reduce_recordings(data, skip_bad=skip_bad)
        return _Task(
            setup, reduction.pushes, free, per_condition, priors, free_start, robust,
            several_starts, tell, integrator,
        ).recordings(reduction, thorough)  # fmt: skip
    if free_start:
        raise InputError("free_start: only recordings have a start offset; these data are a table")
    return _Task(
        setup, data, free, per_condition, priors, False, robust, several_starts, tell,
        integrator,
    ).table()  # fmt: skip


class _Task:
    """One call of `fit`: what was asked for, and the steps to the answer."""

    def __init__(
        self, setup, pushes, free, per_condition, priors, free_start, robust, several_starts,
        tell, integrator,
    ):  # fmt: skip
        self.setup, self.pushes, self.tell = setup, pushes, tell
        self.notes: list[str] = []
        known = not np.isnan(pushes.mu_s_gauge).any()
        if not known and np.isfinite(pushes.mu_s_gauge).any():
            self.notes.append("mu_s_gauge is not given for every push: it is not used")
        names = self._free(free, known)
        given = {"mass_kg": pushes.mass}
        if known and "mu_s" not in names:
            given["mu_s"] = pushes.mu_s_gauge
        bounds = {k: (x.lower, x.upper) for k, x in setup.extras.items()}
        errors = {k: x.standard_error for k, x in setup.extras.items() if x.standard_error}
        self.layout: Layout = layout(
            setup.rig, names, per_condition, pushes.condition, given, bounds,
            errors if priors else {},
        )  # fmt: skip
        scatter, estimate = self._scatter("mu_s" in names)
        self.model = Model(
            rig=setup.rig,
            integrator=integrator,
            layout=self.layout,
            scatter=scatter,
            estimate_scatter=estimate,
            free_start=free_start,
            robust=robust,
        )
        self.box = box_of_starts(self.layout, several_starts)

    def _free(self, free, gauged: bool) -> tuple[str, ...]:
        """The names of the free parameters."""
        if free is not None:
            chosen = tuple(dict.fromkeys(free))
            if not chosen:
                known = ", ".join(parameters.names(self.setup.rig))
                raise InputError(f"free: expected some of {known}; got nothing")
            return chosen
        known = parameters.names(self.setup.rig)
        said = {k: x.free for k, x in self.setup.extras.items() if k in known}
        names = [x for x in FREE if said.get(x) is not False and x in known]
        names += [k for k, yes in said.items() if yes and k not in names]
        if gauged:
            names = [x for x in names if x != "mu_s"]
        if self.pushes.free_slides:
            names = [x for x in names if x not in ("k_N_per_m", "b_N_s_per_m")]
        return tuple(names)

    def _scatter(self, mu_free: bool) -> tuple[float, bool]:
        """The scatter where it starts or stands, and whether it is to be estimated."""
        said = self.setup.mu_s_scatter
        extras = self.setup.extras.get("friction.mu_s_scatter")
        if not mu_free:
            return 0.0, False
        if extras is not None and extras.free is False:
            return said or 0.0, False
        columns = sum(name == "mu_s" for name in self.layout.names)
        if len(self.pushes) < columns + 2:
            self.notes.append(
                "too few pushes to estimate the scatter of mu_s: "
                + (f"the set-up's {said:g} is taken" if said else "none is assumed")
            )
            return said or 0.0, False
        return said or _SCATTER, True

    def table(self) -> Fit:
        """The fit of a table, or of free slides."""
        rig, pushes = self.setup.rig, self.pushes
        if pushes.free_slides:
            data = slides_data(rig, pushes, sensor_errors(rig)[1])
        else:
            rig, data = table_data(rig, pushes, sensor_errors(rig))
        self._enough(data)
        model = replace(self.model, rig=rig)
        at, reached = best_fit(model, data, self.box, self.tell)
        return self._result(None, model, data, at, reached)

    def _enough(self, data: FitData) -> None:
        if data.samples <= self.layout.n_free:
            raise InputError(
                f"fit: {data.samples} measurements cannot determine {self.layout.n_free} values"
            )

    def recordings(self, reduction: Reduction, thorough: bool) -> Fit:
        """The fit of whole recordings."""
        search = SampleSearch(self.model, reduction, self.box, self.tell, thorough)
        return self._result(reduction, *search.run())

    def _result(self, reduction, model, data, at, reached) -> Fit:
        self.tell("done", 1.0)
        return result(self.setup, self.pushes, reduction, model, data, at, reached, self.notes)
