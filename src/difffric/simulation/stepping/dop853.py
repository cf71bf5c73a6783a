"""One step of DOP853, an explicit Runge-Kutta method of order 8 with errors of orders 5 and 3
(Dormand and Prince; Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I,
2nd ed., Springer 1993, II.5 and II.10).

The step stands here, and not in a library, as exact derivatives pass through it in forward mode and
as it is written out or looped over as compiling asks for; scipy's tableau is private to it.
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

from difffric.simulation.dynamics import PhasePoint

# fmt: off
_STAGES = (
    (0.05260015195876773,),
    (0.0197250569845379, 0.0591751709536137,),
    (0.02958758547680685, 0.0, 0.08876275643042054,),
    (0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792,),
    (0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242,),
    (0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125,),
    (
        0.03709200011850479, 0.0, 0.0, 0.17038392571223998, 0.10726203044637328,
        -0.015319437748624402, 0.008273789163814023,
    ),
    (
        0.6241109587160757, 0.0, 0.0, -3.3608926294469414, -0.868219346841726, 27.59209969944671,
        20.154067550477894, -43.48988418106996,
    ),
    (
        0.47766253643826434, 0.0, 0.0, -2.4881146199716677, -0.590290826836843,
        21.230051448181193, 15.279233632882423, -33.28821096898486, -0.020331201708508627,
    ),
    (
        -0.9371424300859873, 0.0, 0.0, 5.186372428844064, 1.0914373489967295, -8.149787010746927,
        -18.52006565999696, 22.739487099350505, 2.4936055526796523, -3.0467644718982196,
    ),
    (
        2.273310147516538, 0.0, 0.0, -10.53449546673725, -2.0008720582248625, -17.9589318631188,
        27.94888452941996, -2.8589982771350235, -8.87285693353063, 12.360567175794303,
        0.6433927460157636,
    ),
)
"""What each stage takes of the ones before it; the first is the rate at the start."""
_WEIGHTS = (
    0.054293734116568765,
    0.0,
    0.0,
    0.0,
    0.0,
    4.450312892752409,
    1.8915178993145003,
    -5.801203960010585,
    0.3111643669578199,
    -0.1521609496625161,
    0.20136540080403034,
    0.04471061572777259,
)
"""What the step takes of each stage's rate."""
_ERRORS_5 = (
    0.01312004499419488,
    0.0,
    0.0,
    0.0,
    0.0,
    -1.2251564463762044,
    -0.4957589496572502,
    1.6643771824549864,
    -0.35032884874997366,
    0.3341791187130175,
    0.08192320648511571,
    -0.022355307863886294,
)
"""The same of the estimate of the error of order 5."""
_ERRORS_3 = (
    -0.18980075407240762,
    0.0,
    0.0,
    0.0,
    0.0,
    4.450312892752409,
    1.8915178993145003,
    -5.801203960010585,
    -0.4226823213237919,
    -0.1521609496625161,
    0.20136540080403034,
    0.02265179219836082,
)
"""The same of the estimate of the error of order 3."""
# fmt: on

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

    for row in _STAGES:
        rates.append(f(s.after(h, weigh(row, rates))))
    end = s.after(h, weigh(_WEIGHTS, rates))._replace(t=s.t + h)
    firm = jax.tree.map(stop_gradient, rates)
    fifth, third = (_list_numbers(weigh(e, firm)) for e in (_ERRORS_5, _ERRORS_3))
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
    for i, row in enumerate(_STAGES):
        taken[i + 1, : len(row)] = row
    given = np.zeros((12, 14))
    for j in range(12):
        given[j, : 11 - j] = taken[j + 1 :, j]
        given[j, 11:] = _WEIGHTS[j], _ERRORS_5[j], _ERRORS_3[j]
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
        return add(row[1:], sums, total, _list_numbers(f(p))), None

    rows = jnp.asarray(_ROWS[1:])
    (_, (move, fifth, third)), _ = jax.lax.scan(stage, (sums, total), rows)
    end = PhasePoint(s.t + h, *(x + h * a for x, a in zip(begin, move, strict=True)))
    return end, _combine_errors(h, stop_gradient(fifth), stop_gradient(third))
