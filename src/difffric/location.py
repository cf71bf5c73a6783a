"""Where a misfit sits that no effect explains: each component in turn with a free-form curve."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric import ensemble as en
from difffric import free_form, refits
from difffric.candidates import Scales
from difffric.ensemble import Fits, Task
from difffric.free_form import FORMS

TYPICAL = 0.5
"""Standard deviation that a curve's coefficients are assumed to have: not much larger than 1."""
POINTS = 60
_ROUNDS = 12
_DIRECTIONS = 18


@dataclass(frozen=True)
class Location:
    """The component that explains a misfit best, and its free-form correction."""

    component: str
    form: str
    quantity: str
    """what the curve is over"""
    unit: str
    x: NDArray
    correction: NDArray
    """relative"""
    standard_error: NDArray
    explained: dict[str, float]
    """form -> share of the excess of chi-square that it explains"""
    penalised_drop: float
    """of -2 log likelihood, less what so many numbers would buy in any case"""

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


def locate(task: Task, plain: Fits, scales: Scales, excess: float) -> Location:
    """The location of what a plain fit (an ensemble of one) leaves unexplained."""
    model = task.model
    coordinates = model.coordinates.with_forms()
    rig = free_form.free_rig(model.rig, scales)
    prior = np.zeros(len(coordinates.names))
    prior[len(model.coordinates.names) :] = TYPICAL**-2
    wide = replace(
        task,
        model=replace(model, coordinates=coordinates, rig=rig, directions=_DIRECTIONS),
        prior=prior,
    )
    extra = []
    for name, form in FORMS.items():
        beside = [x for x in form.beside if x in coordinates.names]
        own = coordinates.indices((*free_form.names(name), *beside))
        extra.append((*plain.extra[0], *(i for i in own if i not in plain.extra[0])))
    start = plain.pick(np.zeros(len(extra), int))
    c = np.zeros((len(extra), len(coordinates.names)))
    c[:, : start.c.shape[1]] = start.c
    at = replace(start, extra=tuple(extra), c=c, gram=None, residual=None, damping=None)
    at = refits.refitted(wide, at, _ROUNDS)
    drop = float(en.criterion(task, plain)[0]) - en.criterion(wide, at)
    price = np.array([len(x) - len(plain.extra[0]) for x in extra]) * task.price
    best = int(np.argmax(drop - price))
    name = list(FORMS)[best]
    explained = dict(zip(FORMS, np.clip(drop / max(excess, 1.0), 0, 1).tolist(), strict=True))
    return _told(wide, at.pick([best]), name, scales, explained, float((drop - price)[best]))


def _told(task: Task, at: Fits, name: str, scales: Scales, explained, drop) -> Location:
    form = FORMS[name]
    x = np.linspace(0.0, form.over(scales)[0], POINTS)
    B = free_form.basis(name, scales, x)
    index = task.model.coordinates.indices(free_form.names(name))
    columns = [*task.shared, *at.extra[0]]
    mine = task.conditions + np.array([columns.index(i) for i in index])
    C = en.covariance(task, at)[0][np.ix_(mine, mine)]
    return Location(
        form.component, name, form.quantity, form.unit, x, B @ at.c[0, index],
        np.sqrt(np.einsum("ij,jk,ik->i", B, C, B)), explained, drop,
    )  # fmt: skip
