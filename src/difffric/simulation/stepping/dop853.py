"""One Runge-Kutta step of a push, with its error."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient

from difffric.simulation.dynamics import Point
from difffric.simulation.stepping.tableau import ERRORS_3, ERRORS_5, STAGES, WEIGHTS


def rk_step(f, s: Point, rate: Point, h):
    """One step of h [s] from s, where the rates are `rate`: the state after it, and its error."""
    rates = [rate]

    def weighted(weights, rates):
        def total(*column):
            return sum(w * r for w, r in zip(weights, column, strict=True) if w)

        return jax.tree.map(total, *rates)

    for row in STAGES:
        rates.append(f(s.after(h, weighted(row, rates))))
    end = s.after(h, weighted(WEIGHTS, rates))._replace(t=s.t + h)
    firm = jax.tree.map(stop_gradient, rates)
    fifth, third = (numbers(weighted(e, firm)) for e in (ERRORS_5, ERRORS_3))
    return end, _errors(h, fifth, third)


def numbers(s: Point) -> list:
    """z, u, y, and the bristles' deflection where there are any."""
    return [x for x in s[1:] if x is not None]


def _errors(h, fifth, third):
    """As DOP853: the estimates of order 5 made such of order 7 by those of order 3."""
    found = []
    for e_5, e_3 in zip(fifth, third, strict=True):
        both = jnp.sqrt(e_5 * e_5 + 0.01 * e_3 * e_3)
        found.append(jnp.abs(h) * e_5 * e_5 / jnp.where(both > 0, both, 1.0))
    return found


_A = np.zeros((12, 12))
for _i, _row in enumerate(STAGES):
    _A[_i + 1, : len(_row)] = _row
_TIMES = _A.sum(1)
# What each rate adds to the stages after its own, then to the end and to the two errors.
_ADDS = np.zeros((12, 14))
for _j in range(12):
    _ADDS[_j, : 11 - _j] = _A[_j + 1 :, _j]
    _ADDS[_j, 11:] = WEIGHTS[_j], ERRORS_5[_j], ERRORS_3[_j]


def looped_step(f, s: Point, rate: Point, h):
    """`rk_step` as a loop over the stages, which compiles sooner and runs slower."""

    def add(shares, sums, total, k):
        def grown(sums, shares):
            pairs = zip(sums, shares, strict=True)
            return [[a + w * b for a, b in zip(x, k, strict=True)] for x, w in pairs]

        after = [*grown(sums[1:], shares[:10]), [shares[10] * b for b in k]]
        total = grown(total, shares[11:])
        return after, total

    zero = 0.0 * s.z
    begin = numbers(s)
    size = len(begin)
    sums, total = add(_ADDS[0], [[zero] * size] * 11, [[zero] * size] * 3, numbers(rate))

    def stage(carry, row):
        sums, total = carry
        p = Point(s.t + row[0] * h, *(x + h * a for x, a in zip(begin, sums[0], strict=True)))
        return add(row[1:], sums, total, numbers(f(p))), None

    rows = jnp.asarray(np.column_stack([_TIMES, _ADDS])[1:])
    (_, (move, fifth, third)), _ = jax.lax.scan(stage, (sums, total), rows)
    end = Point(s.t + h, *(x + h * a for x, a in zip(begin, move, strict=True)))
    return end, _errors(h, stop_gradient(fifth), stop_gradient(third))
