"""The model of each of many pushes as a function of mu_s: what every inversion asks.

NumPy answers for some thousand pushes in closed form at once, before JAX would be imported. All
else is asked of compiled programs, one of which serves all batches of pushes with rigs of one kind.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.compute.lanes import differentiate
from difffric.compute.number_tree import NumberTree
from difffric.compute.pytrees import list_leaves, map_tree, pick
from difffric.estimation import coordinates
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.columns import observe_columns, serves
from difffric.simulation.observables import Observables
from difffric.simulation.segments import Integrator

Quantity = Literal["peak_force", "sliding_distance"]
"""What of a push is inverted: F_p or d."""

QUANTITIES: tuple[Quantity, ...] = ("peak_force", "sliding_distance")
"""Both, in the order in which arrays (n, 2) of this package hold them."""

_CHUNK = 256
"""Pushes that a program takes at a time, so that one program serves all batches: a larger one
would make few pushes wait for many."""
_FEW, _FEW_WITH_STROKE = 4096, 512
"""So many pushes are inverted by NumPy sooner than a program is loaded for them. With a stroke each
is first scanned over mu_s."""


def are_many(rig: Rig, n: int) -> bool:
    """Whether n pushes of such a rig are worth a compiled program."""
    return n > (_FEW if rig.pusher.stroke is None else _FEW_WITH_STROKE)


class BothAt(NamedTuple):
    """F_p and d of n pushes, each at its own mu_s: arrays (n,)."""

    values: tuple[NDArray, NDArray]
    """F_p [N] and d [m]; NaN: there is none"""
    slopes: tuple[NDArray, NDArray]
    """their derivatives by mu_s"""
    kind: NDArray
    """a number that changes wherever a derivative may jump"""


class PushModels(NumberTree):
    """n pushes as functions of mu_s."""

    rigs: Rig
    """every number an array (n,)"""
    velocity: NDArray
    """(n,) [m/s]"""
    integrator: Integrator | None = None
    """None: the one that suits the rig"""
    compiled: bool = field(default=True, metadata={"static": True})
    """whether compiled programs are asked, and not NumPy, which must serve the rigs"""

    @classmethod
    def of(
        cls,
        rigs: Rig,
        velocity: NDArray,
        integrator: Integrator | None = None,
        compiled: bool | None = None,
    ) -> PushModels:
        """The models of n pushes. Unless it is said, compiled programs are asked for many pushes,
        and where NumPy does not serve the rigs."""
        if compiled is None:
            compiled = are_many(rigs, len(velocity))
        return cls(rigs, velocity, integrator, compiled or not serves(rigs, integrator))

    def __len__(self) -> int:
        return len(self.velocity)

    def pick(self, index: NDArray) -> PushModels:
        """The models of some pushes, by an array of indices, which may repeat."""
        rigs, velocity = pick((self.rigs, self.velocity), index)
        return PushModels(rigs, velocity, self.integrator, self.compiled)

    def observe_at(self, mu_s: NDArray) -> BothAt:
        """F_p, d and their derivatives, each push at its own mu_s (n,)."""
        if self.compiled:
            from difffric.identification.compiled_models import observe_batch

            def observe_chunk(some: PushModels, mu_s: NDArray) -> Any:
                return observe_batch(some.rigs, some.velocity, some.integrator, mu_s)

            return BothAt(*self.call_in_chunks(observe_chunk, mu_s))
        return _observe_columns(self, mu_s)

    def observe_values_at(self, mu_s: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """F_p [N], d [m] and the kind, each push at its own mu_s (n,)."""
        if self.compiled:  # the program that gives derivatives too serves again
            found = self.observe_at(mu_s)
            return *found.values, found.kind
        seen = observe_columns(parameters.with_values(self.rigs, {"mu_s": mu_s}), self.velocity)
        F, d, kind = map(np.asarray, (seen.peak_force, seen.sliding_distance, seen.kind))
        return F, d, kind

    def call_in_chunks(self, function: Callable[..., Any], *arrays: Any) -> Any:
        """A compiled function of models and more trees of as many entries, called in chunks of a
        fixed size, the last one filled up, so that one program serves all batches."""
        n, parts = len(self), []
        for start in range(0, n, _CHUNK):
            index = np.minimum(np.arange(start, start + _CHUNK), n - 1)
            found = function(self.pick(index), *pick(arrays, index))
            parts.append(map_tree(np.asarray, found))
        return map_tree(lambda *leaves: np.concatenate(leaves)[:n], *parts)

    def observe_rows(self, log_mu_s: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """(values, derivatives by log mu_s, kind) at rows of log mu_s (n, m): of F_p and d
        (2, n, m) each, and (n, m)."""
        rows, columns = log_mu_s.shape
        models = self.pick(np.repeat(np.arange(rows), columns))
        found = models.observe_at(np.exp(log_mu_s.ravel()))
        values, slopes = (np.reshape(x, (2, rows, columns)) for x in (found.values, found.slopes))
        return values, slopes * np.exp(log_mu_s), found.kind.reshape(rows, columns)

    def observe_distinct_rows(
        self, which: NDArray, log_mu_s: NDArray, by_force: NDArray
    ) -> tuple[NDArray, NDArray, NDArray]:
        """(value, derivative by log mu_s, kind), each (m, k), of F_p where `by_force` (m,) and else
        of d, of the pushes `which` (m,) at rows of equally spaced log mu_s (m, k): computed once
        for all rows that are alike, as those of a rig that is pushed at a few speeds are."""
        numbers = (np.asarray(x)[which] for x in (*list_leaves(self.rigs), self.velocity))
        code = np.zeros(len(which), int)
        for column in (*numbers, log_mu_s[:, 0], log_mu_s[:, -1]):
            if column.ndim > 1:  # a recorded motion's: its rows
                column = column.reshape(len(column), -1)
                values, own = np.unique(column, axis=0, return_inverse=True)
            else:
                values, own = np.unique(column, return_inverse=True)
            if len(values) > 1:
                code = np.unique(code * len(values) + own.ravel(), return_inverse=True)[1]
        _, first, again = np.unique(code, return_index=True, return_inverse=True)
        (F, d), (dF, dd), kind = self.pick(which[first]).observe_rows(log_mu_s[first])
        chosen = by_force[:, None]
        value, slope = np.where(chosen, F[again], d[again]), np.where(chosen, dF[again], dd[again])
        return value, slope, kind[again]


def _observe_columns(models: PushModels, mu_s: NDArray) -> BothAt:
    """What `PushModels.observe_at` gives, by NumPy."""

    def observe_at(mu_s: Any) -> Observables:
        return observe_columns(parameters.with_values(models.rigs, {"mu_s": mu_s}), models.velocity)

    seen, by = differentiate(observe_at, mu_s, np.ones(()))
    return BothAt(
        (seen.peak_force, seen.sliding_distance), (by.peak_force, by.sliding_distance), seen.kind
    )


def differentiate_models(
    models: PushModels, mu_s: NDArray, names: tuple[str, ...]
) -> tuple[NDArray, NDArray]:
    """The derivatives (n, 2, k) of F_p and d by the coordinates of `names`, and the regime (n,), of
    each of n pushes at its own mu_s (n,)."""
    if models.compiled:
        from difffric.identification.compiled_models import differentiate_batch

        return differentiate_batch(models.rigs, models.velocity, models.integrator, mu_s, names)
    values = parameters.values(models.rigs)

    def observe_with(shifts: list[Any]) -> Observables:
        moved = {
            name: coordinates.shift_value(name, values[name], shift)
            for name, shift in zip(names, shifts, strict=True)
        }
        rigs = parameters.with_values(models.rigs, {**moved, "mu_s": mu_s})
        return observe_columns(rigs, models.velocity)

    along = [direction[:, None] for direction in np.eye(len(names))]
    seen, by = differentiate(observe_with, [np.zeros(())] * len(names), along)
    return np.stack([by.peak_force.T, by.sliding_distance.T], axis=1), seen.regime


def compute_range_ratio(models: PushModels, mu_s: NDArray) -> float:
    """Delta F / Delta d of equation (7) [N/m]: the ratio of the ranges of F_p and d over pushes,
    each at its own mu_s (n,)."""
    F, d, _ = models.observe_values_at(mu_s)
    return float(np.ptp(F) / (np.nanmax(d) - np.nanmin(d)))
