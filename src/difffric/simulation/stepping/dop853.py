"""One step of DOP853 (`dop853_tableau`), to be compiled.

It stands here, and not in a library, as exact derivatives pass through it in forward mode and as it
is written out or looped over as compiling asks for.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.lax import stop_gradient
from jaxtyping import Float
from numpy.typing import NDArray

from difffric.compute.xla_options import hold
from difffric.simulation.dynamics import PhasePoint
from difffric.simulation.stepping.dop853_tableau import ERRORS_3, ERRORS_5, STAGES, WEIGHTS

Field = Callable[[PhasePoint], PhasePoint]
"""The rates at a state."""


def take_step(
    f: Field, s: PhasePoint, rate: PhasePoint, h: Float[Array, ""]
) -> tuple[PhasePoint, list[Array]]:
    """(state, errors) after one step of h [s] from s, where the rates are `rate`; an error for each
    of z, u, y and the bristles' deflection, in their units."""
    rates = [rate]

    def weigh(weights, rates):
        def total(*column):
            return sum(w * r for w, r in zip(weights, column, strict=True) if w)

        return jax.tree.map(total, *rates)

    for row in STAGES:
        rates.append(hold(f(hold(s.after(h, weigh(row, rates))))))
    end = s.after(h, weigh(WEIGHTS, rates))._replace(t=s.t + h)
    firm = jax.tree.map(stop_gradient, rates)
    fifth, third = (_list_numbers(weigh(e, firm)) for e in (ERRORS_5, ERRORS_3))
    return end, _combine_errors(h, fifth, third)


def _list_numbers(s: PhasePoint) -> list[Array]:
    """z, u, y, and the bristles' deflection where there are any."""
    return [x for x in s[1:] if x is not None]


def _combine_errors(h: Array, fifth: list[Array], third: list[Array]) -> list[Array]:
    """As DOP853: the estimates of order 5 made such of order 7 by those of order 3."""
    found = []
    for e_5, e_3 in zip(fifth, third, strict=True):
        both = jnp.sqrt(e_5 * e_5 + 0.01 * e_3 * e_3)
        found.append(jnp.abs(h) * e_5 * e_5 / jnp.where(both > 0, both, 1.0))
    return found


def _tabulate() -> NDArray:
    """A row for each stage after the first: its time as a share of the step, then what its rate
    adds to the stages after its own, to the end, and to the two errors."""
    taken = np.zeros((12, 12))
    for i, row in enumerate(STAGES):
        taken[i + 1, : len(row)] = row
    given = np.zeros((12, 14))
    for j in range(12):
        given[j, : 11 - j] = taken[j + 1 :, j]
        given[j, 11:] = WEIGHTS[j], ERRORS_5[j], ERRORS_3[j]
    return np.column_stack([taken.sum(1), given])


_ROWS = _tabulate()


def take_step_in_loop(
    f: Field, s: PhasePoint, rate: PhasePoint, h: Float[Array, ""]
) -> tuple[PhasePoint, list[Array]]:
    """`take_step` as a loop over the stages, which compiles sooner and runs slower."""

    def add(shares, sums, total, k):
        def grow(sums, shares):
            pairs = zip(sums, shares, strict=True)
            return [[a + w * b for a, b in zip(x, k, strict=True)] for x, w in pairs]

        after = [*grow(sums[1:], shares[:10]), [shares[10] * b for b in k]]
        total = grow(total, shares[11:])
        return after, total

    zero = 0.0 * s.z
    begin = _list_numbers(s)
    size = len(begin)
    sums, total = add(_ROWS[0, 1:], [[zero] * size] * 11, [[zero] * size] * 3, _list_numbers(rate))

    def stage(carry, row):
        sums, total = carry
        p = PhasePoint(s.t + row[0] * h, *(x + h * a for x, a in zip(begin, sums[0], strict=True)))
        return add(row[1:], sums, total, _list_numbers(hold(f(hold(p))))), None

    rows = jnp.asarray(_ROWS[1:])
    (_, (move, fifth, third)), _ = jax.lax.scan(stage, (sums, total), rows)
    end = PhasePoint(s.t + h, *(x + h * a for x, a in zip(begin, move, strict=True)))
    return end, _combine_errors(h, stop_gradient(fifth), stop_gradient(third))
