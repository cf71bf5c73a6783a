"""Whether something outside the catalogue explains the data better than any set of causes.

A smooth curve corrects one component at a time; its coefficients are normal about zero, correlated
along the curve (a Gaussian process), with a length and a size that are averaged over. It competes
with the sets of causes by the same likelihood, beside the same background.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from difffric.diagnosis.background.cause_sets import score_set
from difffric.diagnosis.background.evidence import PossibleCause
from difffric.diagnosis.background.search import BackgroundSearch
from difffric.diagnosis.data import DiagnosisData
from difffric.diagnosis.location import add_free_forms
from difffric.rig import free_form
from difffric.rig.free_form import FORMS

_LENGTHS = (0.7, 1.5, 3.5)
"""Lengths over which a curve bends, in its splines."""
_SIZES = np.geomspace(1e-4, 0.5, 9)
"""Relative sizes of a curve."""
_SELDOM = float(np.log(3.0))
"""Log odds against something outside the catalogue."""
_ODDS = float(np.log(20.0))
"""Log odds by which a curve must explain the data better than causes, or nothing, do."""
_MANY, _HALF = 3, 0.5
"""From how many causes on one may doubt that they are any, and the share of what they explain."""


@dataclass(frozen=True)
class CurveComparison:
    """Log posterior probabilities, but for a constant: those of nothing at all are 0."""

    causes: float
    """of the causes alone"""
    curves: dict[str, float]
    """of each free form alone"""
    both: dict[str, float]
    """of each beside the causes"""
    count: int = 0
    """how many causes there are"""

    @property
    def best(self) -> str:
        """The form that explains most by itself."""
        return max(self.curves, key=lambda name: self.curves[name])

    @property
    def is_outside(self) -> bool:
        """Whether a curve explains the data better than the causes, which add nothing to it, and
        than nothing at all, by odds that leave no doubt: a smooth cause is a smooth curve, too.

        Of many causes it is enough that a curve explains half of what they do, and is needed beside
        them: they then imitate what none of them is.
        """
        alone, beside = self.curves[self.best], max(self.both.values(), default=0.0)
        imitated = self.count >= _MANY and alone > _HALF * self.causes
        if imitated and beside > self.causes + _ODDS:
            return True
        return alone > max(self.causes, beside, 0.0) + _ODDS


def compare_with_curves(
    data: DiagnosisData, search: BackgroundSearch, items: Sequence[PossibleCause]
) -> CurveComparison:
    """Compare the causes `items` with curves in place of them and beside them."""
    task, joint, evidence = data.task, search.joint, search.evidence
    wide = add_free_forms(task, data.scales)
    names = wide.model.coordinates.names
    K = len(task.model.coordinates.names)
    c = np.zeros((task.n, len(names)))
    c[:, :K] = joint.c[0]
    c[:, 0] = joint.mu[0, task.condition] + joint.own[0]
    directions = np.eye(len(names))[K:]
    rows = wide.model.answers(np.arange(task.n), c, directions, True).rows[..., :-1]
    rows = rows / joint.spread[0][:, None, None]
    curves = np.split(rows.reshape(task.n, -1, len(FORMS) * free_form.SPLINES), len(FORMS), axis=2)
    priors = [size**2 * _correlate(length) for length in _LENGTHS for size in _SIZES]
    price = float(np.log(len(FORMS))) + _SELDOM
    alone = evidence.weigh_curves((), curves, priors)
    beside = evidence.weigh_curves(items, curves, priors) if items else alone
    causes = score_set(evidence, items)
    return CurveComparison(
        causes=causes,
        count=len(items),
        curves={form: x - price for form, x in zip(FORMS, alone[1:], strict=True)},
        both={
            form: causes + x - beside[0] - price
            for form, x in zip(FORMS, beside[1:] if items else (), strict=False)
        },
    )


def _correlate(length: float) -> NDArray:
    """The correlation of a curve's coefficients."""
    k = np.arange(free_form.SPLINES)
    return np.exp(-0.5 * ((k[:, None] - k) / length) ** 2) + 1e-8 * np.eye(len(k))
