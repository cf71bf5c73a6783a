"""The model of each of many pushes as a function of mu_s: what every inversion asks.

One compiled program serves all batches of pushes with rigs of one kind.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int
from numpy.typing import NDArray

from difffric.compute.program_cache import cache_program
from difffric.compute.pytrees import pick
from difffric.rig import parameters
from difffric.rig.rig import Rig
from difffric.simulation.observables import Observables, observe
from difffric.simulation.segments import Integrator

Quantity = Literal["peak_force", "sliding_distance"]
"""What of a push is inverted: F_p or d."""

QUANTITIES: tuple[Quantity, ...] = ("peak_force", "sliding_distance")
"""Both, in the order in which arrays (n, 2) of this package hold them."""

_CHUNK = 256
"""Pushes that a program takes at a time, so that one program serves all batches: a larger one
would make few pushes wait for many."""


class BothAt(NamedTuple):
    """F_p and d of n pushes, each at its own mu_s: arrays (n,)."""

    values: tuple[NDArray, NDArray]
    """F_p [N] and d [m]; NaN: there is none"""
    slopes: tuple[NDArray, NDArray]
    """their derivatives by mu_s"""
    kind: NDArray
    """a number that changes wherever a derivative may jump"""


class PushModels(eqx.Module):
    """n pushes as functions of mu_s."""

    rigs: Rig
    """every number an array (n,)"""
    velocity: NDArray
    """(n,) [m/s]"""
    integrator: Integrator | None = None
    """None: the one that suits the rig"""

    def __len__(self) -> int:
        return len(self.velocity)

    def pick(self, index: NDArray) -> PushModels:
        """The models of some pushes, by an array of indices, which may repeat."""
        rigs, velocity = pick((self.rigs, self.velocity), index)
        return PushModels(rigs, velocity, self.integrator)

    def observe_at(self, mu_s: NDArray) -> BothAt:
        """F_p, d and their derivatives, each push at its own mu_s (n,)."""

        return BothAt(*self.call_in_chunks(_observe_batch, mu_s))

    def call_in_chunks(self, function: Callable[..., Any], *arrays: Any) -> Any:
        """A compiled function of models and more trees of as many entries, called in chunks of a
        fixed size, the last one filled up, so that one program serves all batches."""
        n, parts = len(self), []
        for start in range(0, n, _CHUNK):
            index = np.minimum(np.arange(start, start + _CHUNK), n - 1)
            found = function(self.pick(index), *pick(arrays, index))
            parts.append(jax.tree.map(np.asarray, found))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:n], *parts)

    def observe_rows(
        self, log_mu_s: NDArray, quantity: Quantity
    ) -> tuple[NDArray, NDArray, NDArray]:
        """(value, derivative by log mu_s, kind), each (n, m), of one quantity at rows of log mu_s
        (n, m)."""
        rows, columns = log_mu_s.shape
        models = self.pick(np.repeat(np.arange(rows), columns))
        found = models.observe_at(np.exp(log_mu_s.ravel()))
        which = QUANTITIES.index(quantity)
        arrays = (found.values[which], found.slopes[which], found.kind)
        value, slope, kind = (a.reshape(rows, columns) for a in arrays)
        return value, slope * np.exp(log_mu_s), kind

    def observe_distinct_rows(
        self, which: NDArray, log_mu_s: NDArray, quantity: Quantity
    ) -> tuple[NDArray, NDArray, NDArray]:
        """`observe_rows` of the pushes `which` (m,) at rows of equally spaced log mu_s: once for
        all rows that are alike, as those of a rig that is pushed at a few speeds are."""
        numbers = (np.asarray(x)[which] for x in (*jax.tree.leaves(self.rigs), self.velocity))
        code = np.zeros(len(which), int)
        for column in (*numbers, log_mu_s[:, 0], log_mu_s[:, -1]):
            values, own = np.unique(column, return_inverse=True)
            if len(values) > 1:
                code = np.unique(code * len(values) + own, return_inverse=True)[1]
        _, first, again = np.unique(code, return_index=True, return_inverse=True)
        found = self.pick(which[first]).observe_rows(log_mu_s[first], quantity)
        return found[0][again], found[1][again], found[2][again]


def observe_at(
    rig: Rig,
    velocity: Float[ArrayLike, ""],
    mu_s: Float[ArrayLike, ""],
    integrator: Integrator | None = None,
) -> Observables:
    """What is measured of a push at `velocity` [m/s] if its mu_s were this one; traceable."""
    return observe(parameters.with_values(rig, {"mu_s": mu_s}), velocity, integrator)


@cache_program
def _observe_batch(
    models: PushModels, mu_s: Float[Array, " n"]
) -> tuple[
    tuple[Float[Array, " n"], Float[Array, " n"]],
    tuple[Float[Array, " n"], Float[Array, " n"]],
    Int[Array, " n"],
]:
    """(F_p, d), their derivatives by mu_s, and the kind."""

    def observe_one(rig, velocity, mu_s):
        def read(value):
            seen = observe_at(rig, velocity, value, models.integrator)
            return (seen.peak_force, seen.sliding_distance), seen.kind

        return jax.jvp(read, (mu_s,), (jnp.ones_like(mu_s),), has_aux=True)

    return jax.vmap(observe_one)(models.rigs, models.velocity, mu_s)


def compute_range_ratio(models: PushModels, mu_s: NDArray) -> float:
    """Delta F / Delta d of equation (7) [N/m]: the ratio of the ranges of F_p and d over pushes,
    each at its own mu_s (n,)."""
    F, d = models.observe_at(mu_s).values
    return float(np.ptp(F) / (np.nanmax(d) - np.nanmin(d)))
