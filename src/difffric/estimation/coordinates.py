"""The coordinates of a calibration: which numbers are free, for which pushes, and on what scale.

A positive parameter moves as its logarithm, one that may be zero on a linear scale; the table of
`rig.parameters` says which. A model's coordinates are all its parameters and the start offset of
the push. A fit moves those that are free, through a selection matrix, so that the choice of what
is free needs no new compilation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from difffric.compute import arrays as xp
from difffric.errors import InputError
from difffric.rig import parameters
from difffric.rig.parameters import PARAMETERS
from difffric.rig.rig import Rig

START = "start_s"
"""The start offset of a push [s]: how late the pusher starts after the trigger."""

_START_STEP = 1e-5
"""The unit step of a start offset [s], which moves on a linear scale."""

NOTHING = -7.0
"""The logarithm at which a parameter that runs towards zero is held."""

_LEAST = 1e-12
"""The value [SI] at which a logarithm starts that is asked for zero."""


def names(rig: Rig) -> tuple[str, ...]:
    """All coordinates of a rig's model."""
    return (*parameters.names(rig), START)


def linear_step(name: str) -> float | None:
    """The unit step [SI] of a coordinate on a linear scale; None: it is a logarithm."""
    return _START_STEP if name == START else PARAMETERS[name].step


def to_coordinate(name: str, value: ArrayLike) -> NDArray:
    """The coordinate of a value [SI]; NumPy's, for numbers outside a compiled program."""
    step = linear_step(name)
    if step is not None:
        return np.asarray(value, float) / step
    return np.log(np.clip(value, _LEAST, 1 / _LEAST))


def to_value(name: str, coordinate: Any) -> Any:
    """The value [SI] of a coordinate; traceable."""
    step = linear_step(name)
    return xp.exp(coordinate) if step is None else step * coordinate


def shift_value(name: str, value: Any, shift: Any) -> Any:
    """The value [SI] that lies `shift` coordinates beyond a value [SI]; traceable."""
    step = linear_step(name)
    return value * xp.exp(shift) if step is None else value + step * shift


def has_vanished(label: str, coordinate: float) -> bool:
    """Whether a free parameter, by its label, ran towards zero until it was held. One that is
    split by condition (`b_N_s_per_m[DRY]`) does not count: its value says how small it is."""
    return label in PARAMETERS and PARAMETERS[label].may_vanish and coordinate <= NOTHING


def slope(name: str, value: float) -> float:
    """d value / d coordinate at a value [SI]."""
    step = linear_step(name)
    return value if step is None else step


def limits(
    name: str, lower: float | None = None, upper: float | None = None
) -> tuple[float, float]:
    """The coordinates between which a fit keeps a parameter: its own limits, and bounds [SI]
    where a set-up gives them."""
    row = PARAMETERS[name]
    linear = row.step is not None

    def limit(value: float | None, default: float) -> float:
        if value is None or (value <= 0 and not linear):
            return default
        return float(to_coordinate(name, value))

    def own_limit(value: float) -> float:
        if value <= 0 and not linear:
            return -np.inf
        return float(to_coordinate(name, value)) if np.isfinite(value) else value

    return (
        max(limit(lower, -np.inf), own_limit(row.lower)),
        min(limit(upper, np.inf), own_limit(row.upper)),
    )


def rig_at(rig: Rig, coordinates: Any) -> Rig:
    """The rig with all its parameters at these coordinates, in the order of `names`; traceable."""
    known = parameters.names(rig)
    new = {name: to_value(name, coordinates[j]) for j, name in enumerate(known)}
    return parameters.with_values(rig, new)


@dataclass(frozen=True)
class Layout:
    """Which coordinates are free, for which pushes, and within what.

    `selection[i, :, j]` is 1 where the free parameter j is a coordinate of push i; `fixed[i]`
    holds the coordinates of push i that are not free, 0 where they are.
    """

    labels: tuple[str, ...]
    """as results write them: `k_N_per_m`, `mu_s[DRY]`"""
    names: tuple[str, ...]
    """the parameter behind each label"""
    selection: NDArray
    """(pushes, coordinates, free)"""
    fixed: NDArray
    """(pushes, coordinates)"""
    start: NDArray
    """(free,) where the fit starts"""
    lower: NDArray
    upper: NDArray
    prior_sd: NDArray
    """(free,) standard deviation of what was known before, about `start`; inf: nothing"""

    @property
    def n_free(self) -> int:
        """The number of free parameters."""
        return len(self.labels)

    def value(self, theta: NDArray) -> dict[str, float]:
        """Label -> value [SI] at the free coordinates `theta` (free,)."""
        pairs = zip(self.labels, self.names, theta, strict=True)
        return {label: float(to_value(name, x)) for label, name, x in pairs}

    def without(self, gone: NDArray, theta: NDArray) -> Layout:
        """The layout with the free parameters `gone` (free,) held at `theta`: their columns of the
        selection are empty."""
        held = np.where(gone, theta, 0.0)
        return replace(
            self,
            selection=self.selection * ~gone,
            fixed=self.fixed + self.selection @ held,
        )


def layout(
    rig: Rig,
    free: Sequence[str],
    per_condition: Sequence[str],
    conditions: Sequence[str],
    given: Mapping[str, NDArray],
    bounds: Mapping[str, tuple[float | None, float | None]],
    priors: Mapping[str, float],
) -> Layout:
    """Arrange the free parameters of n pushes as columns of numbers.

    `conditions` has an entry a push; `given` holds values [SI] that the pushes' records say,
    NaN where they do not (mass, mu_s of the gauge); `bounds` and `priors` (standard errors) are
    in SI, by name. Raises `InputError` for unknown names and for a mass that is both.
    """
    known = parameters.names(rig)
    unknown = sorted({*free, *per_condition} - set(known))
    if unknown:
        raise InputError(
            f"free: no such parameter: {', '.join(unknown)}; expected some of {', '.join(known)}"
        )
    n, every = len(conditions), names(rig)
    values = {**{k: float(v) for k, v in parameters.values(rig).items()}, START: 0.0}
    fixed = np.empty((n, len(every)))
    for j, name in enumerate(every):
        own = given.get(name, np.full(n, np.nan))
        if name in free and np.isfinite(own).any():
            raise InputError(f"free: {name} is said by the data; it cannot be free too")
        fixed[:, j] = to_coordinate(name, np.where(np.isnan(own), values[name], own))
    groups = list(dict.fromkeys(conditions))
    labels, behind, columns = [], [], []
    for name in free:
        split = name in per_condition and len(groups) > 1
        for group in groups if split else [None]:
            member = np.array([group is None or c == group for c in conditions])
            labels.append(name if group is None else f"{name}[{group}]")
            behind.append(name)
            column = np.zeros((n, len(every)))
            column[member, every.index(name)] = 1.0
            columns.append(column)
        fixed[:, every.index(name)] = 0.0
    within = [limits(name, *bounds.get(name, (None, None))) for name in behind]
    return Layout(
        labels=tuple(labels),
        names=tuple(behind),
        selection=np.stack(columns, axis=2) if columns else np.zeros((n, len(every), 0)),
        fixed=fixed,
        start=np.array([to_coordinate(name, values[name]) for name in behind]),
        lower=np.array([lower for lower, _ in within]),
        upper=np.array([upper for _, upper in within]),
        prior_sd=np.array(
            [priors[x] / abs(slope(x, values[x])) if x in priors else np.inf for x in behind]
        ),
    )
