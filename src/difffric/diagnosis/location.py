"""Where a misfit sits that no effect explains: each component in turn with a free-form curve.

Loose curves are compared, as no one knows how large they are; the one that is told is as large as
the data make probable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.data import choose_subset
from difffric.diagnosis.inferred.curve_size import fit_to_size, measure_open
from difffric.diagnosis.inferred.friction import (
    compute_friction_errors,
    find_friction,
    measure_excess,
)
from difffric.estimation.ensembles import ensemble, ensemble_refits
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig import free_form
from difffric.rig.free_form import FORMS
from difffric.rig.scales import Scales

TYPICAL = 0.5
"""Standard deviation that a curve's coefficients are assumed to have: not much larger than 1."""
POINTS = 60
"""Points at which the curve of a correction is told."""
_FIRST_ROUNDS = 6
"""Steps at most of each form's fit to some of the pushes."""
_ROUNDS = 12
"""Steps at most of a leading form's fit to all pushes."""
FAR_LEFT = 1.0
"""What the leading curve leaves beyond noise, in units of it, from which all are fitted."""
_LEADERS = 2
"""Forms that are fitted to all pushes."""
_AS_MUCH = 0.5
"""Share of what a loose curve explains from which on one of the most probable size stands for it: a
loose one explains more where none follows what is there, and is then anything."""


@dataclass(frozen=True)
class Location:
    """The component that explains a misfit best, and its free-form correction."""

    component: str
    form: str
    """key of `rig.free_form.FORMS`"""
    quantity: str
    """what the curve is over"""
    unit: str
    """of the quantity"""
    x: NDArray
    """values of the quantity at which the curve is told"""
    correction: NDArray
    """relative"""
    standard_error: NDArray
    explained: dict[str, float]
    """form -> share of the excess of chi-square that it explains"""
    penalised_drop: float
    """of -2 log likelihood, less what so many numbers would buy in any case"""
    friction: tuple[NDArray, NDArray] | None = None
    """log mu_s (n,) of the pushes beside the correction, and their standard errors; None: not
    asked for yet"""

    def as_dict(self) -> dict[str, Any]:
        """As `result.json` holds it."""
        return {
            "over": self.quantity,
            "unit": self.unit,
            "x": self.x.tolist(),
            "relative_correction": self.correction.tolist(),
            "standard_error": self.standard_error.tolist(),
            "explained": self.explained,
        }


def add_free_forms(task: EnsembleTask, scales: Scales) -> EnsembleTask:
    """Return the task with all free forms, whose coefficients are assumed to be small."""
    model = task.model
    coordinates = model.coordinates.with_forms()
    rig = free_form.free_rig(model.rig, scales)
    prior = np.zeros(len(coordinates.names))
    prior[len(model.coordinates.names) :] = TYPICAL**-2
    return replace(
        task,
        model=replace(model, coordinates=coordinates, rig=rig),
        prior=prior,
        prior_about=None,
        reach=None,
    )


def locate(
    task: EnsembleTask,
    plain: Fits,
    scales: Scales,
    excess: float,
    among: tuple[str, ...] = tuple(FORMS),
) -> Location:
    """Locate what a plain fit (an ensemble of one) leaves unexplained.

    The forms `among` which it is looked for are fitted to some of the pushes, and those that lead
    to all. `excess` is the chi-square of the plain fit beyond the noise's, of which each form
    explains a share; one that explains less than its `least` is not told where another leads too.
    """
    wide = add_free_forms(task, scales)
    at = place_forms(wide, plain, among)
    price = np.array([len(x) - len(plain.extra[0]) for x in at.extra]) * task.price
    some = choose_subset(task) if task.model.recordings else np.arange(task.n)
    first = ensemble_refits.refit(wide, at, _FIRST_ROUNDS, some)
    share = task.counts[some].sum() / task.counts.sum()
    explained = ensemble.sum_squares(task, plain, some)[0] - ensemble.sum_squares(wide, first, some)
    leaders = np.argsort(share * price - explained)[:_LEADERS]
    explained = np.clip(explained / max(share * excess, 1.0), 0, 1)
    own = plain.own[np.zeros(len(leaders), int)]
    own[:, some] = first.own[leaders][:, some]
    at = replace(first.pick(leaders), own=own, gram=None, residual=None, damping=None)
    at = ensemble_refits.refit(wide, at, _ROUNDS)
    drop = float(ensemble.criterion(task, plain)[0]) - ensemble.criterion(wide, at)
    explained[leaders] = np.clip(drop / max(excess, 1.0), 0, 1)
    worths = drop - price[leaders]
    best = choose_form([among[k] for k in leaders], explained[leaders], worths)
    shares = dict(zip(among, explained.tolist(), strict=True))
    worth = float(worths[best])
    return make_location(wide, at.pick([best]), among[leaders[best]], scales, shares, worth)


def locate_first_among(
    leading: tuple[str, ...], task: EnsembleTask, plain: Fits, scales: Scales, excess: float
) -> Location:
    """Do as `locate` with the forms that are `leading` by linear answers, and with all where the
    one that is found leaves far more than noise: there linear answers say little."""
    location = locate(task, plain, scales, excess, leading)
    left = (1.0 - location.explained[location.form]) * excess
    if left <= FAR_LEFT * task.counts.sum():
        return location
    return locate(task, plain, scales, excess)


def choose_form(names: Sequence[str], explained: NDArray, worths: NDArray) -> int:
    """Return the number of the form that is told: the one that is worth most, but for those that
    explain less than their `least` where another explains enough."""
    enough = explained >= np.array([FORMS[name].least for name in names])
    return int(np.argmax(np.where(enough | ~enough.any(), worths, -np.inf)))


def settle_location(
    task: EnsembleTask, plain: Fits, location: Location, scales: Scales
) -> Location:
    """Return the `location` that is told, its curve fitted on from the plain fit (an ensemble of
    one) and as large as the data make probable, with the mu_s of the pushes beside it.

    Where that explains less than half of what the loose curve does, or knows no mu_s, the loose one
    is told, and mu_s is that of the plain fit, as far open as the curve is large. A location whose
    mu_s is known already stays as it is.
    """
    if location.friction is not None or not task.mu_free:
        return location
    form = location.form
    wide = add_free_forms(task, scales)
    start = ensemble.evaluate(wide, place_forms(wide, plain, [form]))
    curve = wide.model.coordinates.indices(free_form.names(form))
    sized = fit_to_size(wide, start, curve)
    price = (len(start.extra[0]) - len(plain.extra[0])) * task.price
    value = ensemble.criterion(replace(wide, prior=None), ensemble.join(start, sized.fits))
    known = np.isfinite(sized.friction).all()
    if not known or value[0] - value[1] < _AS_MUCH * (location.penalised_drop + price):
        friction, errors = find_friction(task, plain), compute_friction_errors(task, plain)
        far = measure_open(form, location.correction, arrived=False)
        return replace(location, friction=(friction, np.hypot(errors, far)))
    shares, worth = location.explained, location.penalised_drop
    told = make_location(sized.task, sized.fits, form, scales, shares, worth)
    friction, errors = sized.friction
    errors = np.hypot(errors, measure_open(form, told.correction, arrived=True))
    return replace(told, friction=(friction, errors))


def place_forms(wide: EnsembleTask, plain: Fits, forms: Sequence[str]) -> Fits:
    """Repeat the plain fit for each of the forms, its coefficients free and still zero."""
    coordinates = wide.model.coordinates
    extra = []
    for name in forms:
        form = FORMS[name]
        beside = [x for x in form.beside if x in coordinates.names]
        own = coordinates.indices((*free_form.names(name), *beside))
        extra.append((*plain.extra[0], *(i for i in own if i not in plain.extra[0])))
    start = plain.pick(np.zeros(len(extra), int))
    c = np.zeros((len(extra), len(coordinates.names)))
    c[:, : start.c.shape[1]] = start.c
    return replace(start, extra=tuple(extra), c=c, gram=None, residual=None, damping=None)


def make_location(
    task: EnsembleTask,
    at: Fits,
    name: str,
    scales: Scales,
    explained: dict[str, float],
    penalised_drop: float,
) -> Location:
    """Return the curve of the form `name` with its standard error, as the fit `at` has it."""
    form = FORMS[name]
    x = np.linspace(0.0, form.over(scales)[0], POINTS)
    B = free_form.basis(name, scales, x)
    index = task.model.coordinates.indices(free_form.names(name))
    columns = [*task.shared, *at.extra[0]]
    mine = task.conditions + np.array([columns.index(i) for i in index])
    C = measure_excess(task, at) * ensemble.covariance(task, at)[0][np.ix_(mine, mine)]
    return Location(
        component=form.component,
        form=name,
        quantity=form.quantity,
        unit=form.unit,
        x=x,
        correction=B @ at.c[0, index],
        standard_error=np.sqrt(np.einsum("ij,jk,ik->i", B, C, B)),
        explained=explained,
        penalised_drop=penalised_drop,
    )
