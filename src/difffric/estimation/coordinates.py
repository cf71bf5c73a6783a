"""The coordinates of a fit: which numbers are free, for which pushes, and on what scale.

Positive parameters move as logarithms, k_v, which may be zero, as it is. A model's coordinates
are all its parameters and the start offset of the push; a fit moves those that are free,
through a selection matrix, so that what is free is a run-time choice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from difffric.errors import InputError
from difffric.rig import catalogue, parameters
from difffric.rig.rig import Rig

START = "start_s"
"""The start offset of a push [s]: how late the pusher starts after the trigger."""

LINEAR = {"k_v_N_s_per_m": 10.0, START: 1e-5} | {
    name: key.typical or 1.0 for name, (_, key) in catalogue.KEYS.items() if not key.inverse
}
"""What moves on a linear scale, with its unit step."""

_LIMITS = {"mu_k_over_mu_s": (0.0, 1.0), "k_v_N_s_per_m": (0.0, np.inf)} | {
    name: (key.lower, key.upper) for name, (_, key) in catalogue.KEYS.items()
}
"""The values [SI] between which a parameter makes sense, where that is not all positive ones."""

_LEAST = 1e-12
"""Where a logarithm starts that is asked for zero."""


def names(rig: Rig) -> tuple[str, ...]:
    """All coordinates of a rig's model."""
    return (*parameters.names(rig), START)


def to_coordinate(name: str, value):
    """The coordinate of a value [SI]."""
    if name in LINEAR:
        return np.asarray(value, float) / LINEAR[name]
    return np.log(np.clip(value, _LEAST, 1 / _LEAST))


def to_value(name: str, coordinate):
    """The value [SI] of a coordinate; traceable."""
    return LINEAR[name] * coordinate if name in LINEAR else jnp.exp(coordinate)


def slope(name: str, value: float) -> float:
    """d value / d coordinate."""
    return LINEAR.get(name, value)


def rig_at(rig: Rig, coordinates) -> Rig:
    """The rig with all its parameters at these coordinates (in the order of `names`)."""
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
        return len(self.labels)

    def value(self, theta: NDArray) -> dict[str, float]:
        """Label -> value [SI]."""
        pairs = zip(self.labels, self.names, theta, strict=True)
        return {label: float(to_value(name, x)) for label, name, x in pairs}

    def without(self, gone: NDArray, theta: NDArray) -> Layout:
        """The same, with some free parameters held at `theta`: their columns are empty."""
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
    """Arrange the free parameters `free` of n pushes.

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
    start = np.array([to_coordinate(name, values[name]) for name in behind])

    def limit(name, side, default):
        value = bounds.get(name, (None, None))[side]
        if value is None or (value <= 0 and name not in LINEAR):
            return default
        return float(to_coordinate(name, value))

    def sense(name, side):
        value = _LIMITS.get(name, (0.0, np.inf))[side]
        if name not in LINEAR and value <= 0:
            return -np.inf
        return float(to_coordinate(name, value)) if np.isfinite(value) else value

    floor = [sense(name, 0) for name in behind]
    ceiling = [sense(name, 1) for name in behind]
    return Layout(
        labels=tuple(labels),
        names=tuple(behind),
        selection=np.stack(columns, axis=2) if columns else np.zeros((n, len(every), 0)),
        fixed=fixed,
        start=start,
        lower=np.array([max(limit(x, 0, -np.inf), f) for x, f in zip(behind, floor, strict=True)]),
        upper=np.array([min(limit(x, 1, np.inf), c) for x, c in zip(behind, ceiling, strict=True)]),
        prior_sd=np.array(
            [priors[x] / abs(slope(x, values[x])) if x in priors else np.inf for x in behind]
        ),
    )
