"""The fit of a free curve in place of causes, beside a background of small effects.

A comparison by linear answers stands where the joint fit does, which something outside the
catalogue bends. So the curves that lead there are fitted, with all small effects beside them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from difffric.diagnosis.background.curve_comparison import CurveComparison
from difffric.diagnosis.background.evidence import PossibleCause
from difffric.diagnosis.background.joint_fit import LEAST_SHARE, WIDE, fit_best, measure_left
from difffric.diagnosis.background.joint_search import ARRIVED
from difffric.diagnosis.background.search import BackgroundSearch
from difffric.diagnosis.background.shape_grid import leave_out
from difffric.diagnosis.background.small_effects import SmallEffects
from difffric.diagnosis.data import DiagnosisData
from difffric.diagnosis.inferred.curve_size import measure_open
from difffric.diagnosis.inferred.friction import compute_friction_errors, find_friction
from difffric.diagnosis.location import (
    FAR_LEFT,
    Location,
    add_free_forms,
    locate,
    make_location,
    place_forms,
)
from difffric.estimation.ensembles import ensemble
from difffric.estimation.ensembles.ensemble import EnsembleTask, Fits
from difffric.rig.catalogue import CUTTING
from difffric.rig.free_form import SPLINES

_LEFT = 1.03
"""Squares per number up to which the joint fit leaves no room for a curve."""
_TRIED = 3
"""Forms that are fitted: those that lead by linear answers."""
_HALF = 0.5
"""Share of what the joint fit leaves beyond noise that a curve has to explain: what shapes at wrong
places leave, a curve explained a sixth of, or half of three hundredths."""
NEARLY_ALL = 0.8
"""The same from which on nothing else is asked for."""
_TWICE = 2.0
"""How many times what its numbers cost in any case it has to explain."""


@dataclass(frozen=True)
class CurveFit:
    """A curve that explains what causes do not."""

    location: Location
    """with the mu_s of the pushes beside it"""
    share: float
    """of what the joint fit left beyond the noise that it explains"""


def fit_curve_for_causes(
    found: BackgroundSearch,
    items: Collection[PossibleCause],
    compared: CurveComparison,
    excess: float,
) -> CurveFit | None:
    """Return the curve in place of the `items` that were chosen as causes, with which the data
    are explained better than by them, where the search `found` left more than noise; `excess` is
    what the plain fit leaves beyond it in chi-square.

    Beside the curve all small effects scatter no more than a background does, so that a cause that
    is there is missed. Where far more than noise is left, small effects stand for what the right
    curve would: the one that explains more by itself is returned then.
    """
    data, task = found.data, found.data.task
    left = measure_left(task, found.joint)
    if left < _LEFT or not (left > ARRIVED or compared.may_be_needed):
        return None
    share = max(compared.share, LEAST_SHARE)
    wide = _assume_beside_forms(data, found.small, share)
    forms = compared.rank_forms()[:_TRIED]
    fits, which = fit_best(wide, _list_starts(found, wide, {item.effect for item in items}, forms))
    form = forms[which % len(forms)]
    drop = ensemble.criterion(found.small.assume(task, WIDE), found.joint)
    drop = float(drop[0] - ensemble.criterion(wide, fits)[0])
    price = task.price * SPLINES
    beyond = measure_left(task, fits) - 1.0
    if not (drop >= _TWICE * price and beyond <= (1.0 - _HALF) * (left - 1.0)):
        return None
    explained = {form: 1.0 - max(beyond, 0.0) * float(task.counts.sum()) / max(excess, 1.0)}
    location = make_location(wide, fits, form, data.scales, explained, drop - price)
    errors = compute_friction_errors(wide, fits, grown=False)
    arrived = 1.0 + beyond <= ARRIVED
    errors = np.hypot(errors, measure_open(form, location.correction, arrived))
    location = replace(location, friction=(find_friction(wide, fits, grown=False), errors))
    if beyond > FAR_LEFT:
        alone = locate(task, found.plain, data.scales, excess)
        if alone.explained[alone.form] > explained[form]:
            location = alone
            beyond = (1.0 - alone.explained[alone.form]) * excess / float(task.counts.sum())
    return CurveFit(location, 1.0 - beyond / (left - 1.0))


def _assume_beside_forms(data: DiagnosisData, small: SmallEffects, share: float) -> EnsembleTask:
    """The task of fits with all free forms and the small effects, which scatter by the `share`."""
    wide, assumed = add_free_forms(data.task, data.scales), small.assume(data.task, share)
    assert wide.prior is not None and assumed.prior is not None
    assert assumed.prior_about is not None and assumed.reach is not None
    K = len(assumed.prior)
    more = len(wide.prior) - K
    return replace(
        wide,
        prior=np.concatenate([assumed.prior, wide.prior[K:]]),
        prior_about=np.append(assumed.prior_about, np.zeros(more)),
        reach=np.append(assumed.reach, np.full(more, np.inf)),
    )


def _list_starts(
    found: BackgroundSearch, wide: EnsembleTask, effects: set[str], forms: Sequence[str]
) -> list[Fits]:
    """List the fits to begin with: of each form, the joint fit without the shapes of the `effects`,
    and without any but those that cut pushes short."""
    shaped = {*found.shaped}
    gone = [shaped & effects - {*CUTTING}, shaped - {*CUTTING}]
    starts = []
    for some in gone if gone[0] != gone[1] else gone[:1]:
        bare = leave_out(found.data.task, found.joint, some)
        at = place_forms(wide, bare, forms)
        starts += [at.pick([j]) for j in range(len(forms))]
    return starts
