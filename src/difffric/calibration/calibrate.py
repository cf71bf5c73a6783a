"""Calibration: the rig's parameters, each push's mu_s and its scatter, from measured pushes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from difffric.calibration.free_parameters import (
    choose_first_scatter,
    choose_free,
    collect_given,
    has_gauge,
)
from difffric.calibration.multistart import fit_from_starts, make_starts
from difffric.calibration.recording_search import NearStart, RecordingSearch
from difffric.calibration.result import Fit, FitState
from difffric.calibration.result_builder import build_fit
from difffric.compute.precision import require_float64
from difffric.errors import InputError, NumericalError
from difffric.estimation.coordinates import layout
from difffric.estimation.descent import Model
from difffric.estimation.stacked_data import slides_data, table_data
from difffric.measurements.checks import check_data
from difffric.measurements.latched_distances import describe_latch
from difffric.measurements.pusher_tracking import describe_tracking
from difffric.measurements.pushes import Pushes
from difffric.measurements.recorded_motion import describe_motion
from difffric.measurements.recordings import Recordings
from difffric.measurements.reduction.recorded_pusher import reduce_for
from difffric.measurements.reduction.reduce import Reduction
from difffric.progress import Tell, silent
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup, check_rig, refuse_recorded_motion
from difffric.simulation.segments import Integrator


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

    mu_s of each push scatters about its condition's, and the scatter is estimated with the rest
    (restricted maximum likelihood). Where every push says its `mu_s_gauge` that is its mu_s, and
    there is neither a scatter nor a free mu_s. Where no standard errors are known, the spreads of
    F_p and d are estimated too.

    Arguments:
        rig: the rig, or the set-up, whose values are the first start.
        data: what was measured.
        free: the names of the parameters to determine; by default k, b, k_v and mu_s, and what
            the set-up's tables say is free.
        per_condition: which of them have a value for each condition; all others are shared.
        priors: whether the set-up's standard errors count as knowledge from other data. Its
            bounds always hold.
        free_start: whether each recorded push has a start offset of its own.
        robust: whether outliers of a table weigh less (Huber).
        several_starts: whether the search starts from a grid about the set-up's values too.
        thorough: whether recordings are followed from further starts where the fit is poor.
        use_data_mass: whether the data's mass may differ from the rig's by more than 1 %.
        skip_bad: whether pushes that cannot be used are left out and named in `Fit.skipped`.
        tell: is called with what is being done and the share of it that is done.
        integrator: how the pushes are solved; by default as the rig's laws allow.

    Raises `InputError` for data that cannot be used (see `measurements.checks`), for fewer
    measurements than free parameters, for parameters that are unknown or said by the data and
    where JAX computes in 32 bits; `NumericalError` where no start gives a finite misfit.
    """
    require_float64()
    setup = rig if isinstance(rig, Setup) else Setup(rig)
    rig = check_rig(setup.rig)
    wishes = _Wishes(
        free,
        per_condition,
        priors,
        free_start,
        robust,
        several_starts,
        integrator,
    )
    if isinstance(data, Recordings):
        recordings = check_data(data, rig, use_data_mass=use_data_mass, skip_bad=skip_bad)
        if robust:
            raise InputError("robust: expected a table; recordings are fitted sample by sample")
        tell("reducing the recordings", 0.0)
        reduction = reduce_for(setup, recordings, skip_bad)
        pushes = reduction.pushes
        task = _arrange(setup, pushes, wishes)
        task.notes.extend(_describe_recordings(setup, reduction))
        search = RecordingSearch(task.model, reduction, task.starts, tell, thorough)
        state, reached = search.run()
    else:
        pushes = check_data(data, rig, use_data_mass=use_data_mass, skip_bad=skip_bad)
        refuse_recorded_motion(setup, pushes.no_pusher)
        reduction = None
        if free_start:
            raise InputError(
                "free_start: only recordings have a start offset; these data are a table"
            )
        task = _arrange(setup, pushes, wishes)
        state, reached = _fit_table(task, pushes, tell)
    tell("done", 1.0)
    return build_fit(setup, pushes, reduction, state, reached, task.notes)


def refine_fit(setup: Setup, reduction: Reduction, near: NearStart) -> Fit:
    """Fit recordings whose `reduction` is known, as `fit` does by default, from a set-up and
    scattering mu_s that are near the optimum already.

    Where that leads nowhere, the search begins as `fit` does. Raises `NumericalError` where no
    start gives a finite misfit.
    """
    wishes = _Wishes(None, ("mu_s",), False, False, False, False, None)
    task = _arrange(setup, reduction.pushes, wishes)
    task.notes.extend(_describe_recordings(setup, reduction))
    given = task.model, reduction, task.starts, silent
    search = RecordingSearch(*given, thorough=False, near=near)
    try:
        found = search.run()
    except NumericalError:
        found = replace(search, near=None).run()
    return build_fit(setup, reduction.pushes, reduction, *found, task.notes)


def _describe_recordings(setup: Setup, reduction: Reduction) -> tuple[str, ...]:
    """What a reader should know of the recordings: how the pusher moved, and what d is counted
    from."""
    recordings = reduction.recordings
    notes = describe_motion(recordings), describe_tracking(recordings, setup.rig.pusher.stroke)
    return (*notes[0], *notes[1], *describe_latch(reduction))


@dataclass(frozen=True)
class _Wishes:
    """What a call of `fit` asks for, beside the rig and the data."""

    free: Sequence[str] | None
    per_condition: Sequence[str]
    priors: bool
    free_start: bool
    robust: bool
    several_starts: bool
    integrator: Integrator | None


@dataclass(frozen=True)
class _Arrangement:
    """What a search needs before it sees the measurements."""

    model: Model
    """what of the rig is free, at which scatter"""
    starts: list[NDArray]
    """(free,) each: shared coordinates to start from, the set-up's own first"""
    notes: list[str]
    """what a reader of the fit should know already"""


def _arrange(setup: Setup, pushes: Pushes, wishes: _Wishes) -> _Arrangement:
    """Lay out the free parameters of these pushes and the points to start from."""
    notes: list[str] = []
    if not has_gauge(pushes) and np.isfinite(pushes.mu_s_gauge).any():
        notes.append("mu_s_gauge is not given for every push: it is not used")
    names = choose_free(setup, pushes, wishes.free)
    bounds = {k: (x.lower, x.upper) for k, x in setup.extras.items()}
    errors = {k: x.standard_error for k, x in setup.extras.items() if x.standard_error}
    arranged = layout(
        setup.rig,
        names,
        wishes.per_condition,
        pushes.condition,
        collect_given(pushes, names),
        bounds,
        errors if wishes.priors else {},
    )
    scatter, estimate = choose_first_scatter(setup, len(pushes), arranged.names, notes)
    model = Model(
        rig=setup.rig,
        integrator=wishes.integrator,
        layout=arranged,
        scatter=scatter,
        estimate_scatter=estimate,
        free_start=wishes.free_start,
        robust=wishes.robust,
    )
    return _Arrangement(model, make_starts(arranged, wishes.several_starts), notes)


def _fit_table(task: _Arrangement, pushes: Pushes, tell: Tell) -> tuple[FitState, tuple[int, int]]:
    """The fit of a table or of free slides, and how many of how many starts lead to it.

    Raises `InputError` where there are no more measurements than free parameters.
    """
    rig = task.model.rig
    if pushes.free_slides:
        data = slides_data(rig, pushes, rig.sensor_errors[1])
    else:
        rig, data = table_data(rig, pushes, rig.sensor_errors)
    columns = task.model.layout.n_free
    if data.samples <= columns:
        raise InputError(f"fit: {data.samples} measurements cannot determine {columns} values")
    return fit_from_starts(replace(task.model, rig=rig), data, task.starts, tell)
