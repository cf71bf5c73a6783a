"""One accepted step of a push as smooth functions of time: position, tip and contact force."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float
from numpy.polynomial import Chebyshev, Polynomial, polynomial
from numpy.typing import NDArray

from difffric.simulation.dynamics import Course, Motion, PhasePoint

Jet = tuple[PhasePoint, PhasePoint, PhasePoint]
"""A state, its rate, and the rate's rate."""


def _invert_hermite(orders: int, powers: Sequence[int], shares: Sequence[float]) -> NDArray:
    """The matrix that turns values and so many derivatives at these shares of a step into the
    coefficients of the powers of the share."""
    rows = []
    for at in shares:
        for order in range(orders):
            row = [
                float(np.prod(np.arange(n - order + 1, n + 1)) * at ** (n - order))
                if n >= order
                else 0.0
                for n in powers
            ]
            rows.append(row)
    return np.linalg.inv(np.array(rows))


_NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(8) / 7)
"""Shares of a step at which a polynomial of order 7 is best sampled (Chebyshev's extrema)."""
_TO_POWERS = np.linalg.inv(polynomial.polyvander(_NODES, 7))
"""Turns values at the nodes into coefficients of powers of the share of the step."""
_SEPTIC = _invert_hermite(4, range(8), (0.0, 1.0))
"""Gives the coefficients of 1, s, ..., s^7 by (x, x', x'', x''') at 0 and at 1."""
_QUINTIC = _invert_hermite(3, range(3, 6), (1.0,))
"""Gives the coefficients of s^3, s^4, s^5 by what is left of (y, y', y'') at 1."""


def _multiply(matrix: NDArray, values: Sequence[Array]) -> tuple[Any, ...]:
    """A constant matrix times a few numbers, in plain arithmetic: it vectorises over pushes."""
    return tuple(
        sum(float(c) * v for c, v in zip(row, values, strict=True) if abs(c) > 1e-14)
        for row in matrix
    )


def sum_powers(coefficients: Sequence[Any] | Array, share: Float[ArrayLike, ""]) -> Array:
    """The polynomial with these coefficients, lowest power first, at a share of the step."""
    total = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = total * share + c
    return total


class Stride(NamedTuple):
    """A step from `t` over `h` [s], with polynomials in the share of it (0 to `end`).

    `end` is 1, but for a hair where an event ends the step: then the Taylor step to the event is
    in it, and with it the derivatives of the event's time.
    """

    t: Float[Array, ""]
    h: Float[Array, ""]
    end: Float[Array, ""]
    course: Course
    x: tuple[Array, ...]
    """eight coefficients of the part's position [m]"""
    y: tuple[Array, ...]
    """six coefficients of the tip's travel [m]"""

    @classmethod
    def of(
        cls,
        motion: Motion,
        course: Course,
        start: Jet,
        end: Jet,
        h: Float[Array, ""],
        share: Float[Array, ""],
        brief: Bool[Array, ""],
    ) -> Stride:
        """From the state and its rates at the shares 0 and 1 of a step of h [s], which counts up
        to `share`. A step so `brief` that how far it leads is lost to rounding goes on as it
        began."""

        def jet(s: PhasePoint, r: PhasePoint, rr: PhasePoint):
            gap = motion.rig.contact.gap
            return [s.y - gap - s.z, s.u * h, r.u * h**2, rr.u * h**3]

        def tip(s: PhasePoint, r: PhasePoint, rr: PhasePoint):
            return [s.y, r.y * h, rr.y * h**2]

        first = jet(*start)
        x = _multiply(_SEPTIC, first + jet(*end))
        (y_0, v_0, a_0), (y_1, v_1, a_1) = tip(*start), tip(*end)
        rest = [y_1 - y_0 - v_0 - 0.5 * a_0, v_1 - v_0 - a_0, a_1 - a_0]
        y = (y_0, v_0, 0.5 * a_0, *_multiply(_QUINTIC, rest))
        taylor = [first[0], first[1], first[2] / 2, first[3] / 6, *[0.0] * 4]
        x = tuple(jnp.where(brief, a, b) for a, b in zip(taylor, x, strict=True))
        y = (*y[:3], *(jnp.where(brief, 0.0, c) for c in y[3:]))
        return cls(start[0].t, h, share, course, x, y)

    def position(self, share: Float[ArrayLike, ""]) -> Float[Array, ""]:
        """x, the part's position [m], at a share of the step."""
        return sum_powers(self.x, share)

    def point(self, motion: Motion, share: Float[ArrayLike, ""]) -> PhasePoint:
        """The state at a share of the step."""
        rate = [n * c for n, c in enumerate(self.x)][1:]
        x, y = self.position(share), sum_powers(self.y, share)
        u = sum_powers(rate, share) / self.h
        return PhasePoint(self.t + share * self.h, y - motion.rig.contact.gap - x, u, y)

    def force(self, motion: Motion, share: Float[ArrayLike, ""]) -> Float[Array, ""]:
        """The contact force [N] at a share of the step."""
        return motion.force(self.course, self.point(motion, share))

    def force_powers(self, motion: Motion) -> tuple[Array, ...]:
        """Eight coefficients of the contact force [N]."""
        at = jax.vmap(lambda share: self.force(motion, share))(jnp.asarray(_NODES))
        return _multiply(_TO_POWERS, [at[i] for i in range(len(_NODES))])


_TERMS, _STORED = 16, 10
"""Powers of a filter's answer to a stride that is short beside its time constant: the series has
converged to rounding; and as many as tell it as well, lowest first, which are read hundreds of
times."""


def _fold_powers(most: int, stored: int) -> NDArray:
    """The matrix that turns the coefficients of s^stored, ..., s^(most - 1) into what they add to
    those of 1, ..., s^(stored - 1), as near as polynomials of that order come for s from 0 to 1:
    their Chebyshev series, cut (Lanczos, Applied Analysis, 1956)."""
    columns = []
    for n in range(stored, most):
        one = Polynomial.basis(n, window=(0, 1), domain=(0, 1))
        short = one.convert(kind=Chebyshev, domain=(0, 1)).truncate(stored)
        columns.append(short.convert(kind=Polynomial, domain=(-1, 1)).coef)
    return np.stack(columns, axis=1)


_FOLD = _fold_powers(_TERMS, _STORED)
"""What the highest powers of a filter's answer add to those that are stored."""


class OnePole(NamedTuple):
    """`tau f' = N - f` over a stride, N a polynomial: its exact solution, for any tau >= 0."""

    powers: Float[Array, "terms *strides"]
    """of N's particular solution, or of the answer from nothing where the step is short beside
    tau"""
    rest: Float[Array, "*strides"]
    """what decays [N]"""
    ratio: Float[Array, "*strides"]
    """step / tau; infinite: what decays is gone"""

    @classmethod
    def of(
        cls,
        N: Sequence[Array] | Array,
        f_0: Float[Array, "*strides"],
        h: Float[Array, "*strides"],
        tau: Float[Array, ""] | float,
    ) -> OnePole:
        """From N's coefficients [N], f at the start [N], the step and tau [s]."""
        quick = tau < h
        N = jnp.stack([*N])
        none = 0.0 * (N[0] + f_0)
        # Looped over: written out, XLA computes each power anew from the first one on.
        # Quick: p + p' / ratio = N, from the highest power down.
        inverse = jnp.where(quick, tau, 0.0) / h
        n = jnp.arange(1.0, len(N) + 1)

        def go_down(above, given):
            n, c = given
            new = c - n * inverse * above
            return new, new

        _, p = jax.lax.scan(go_down, none, (n, N), reverse=True)
        # Slow: f' = ratio (N - f) from nothing, from the lowest power up.
        ratio = jnp.where(quick, 0.0, h / jnp.where(quick, 1.0, tau))
        every = jnp.arange(1.0, _TERMS + 1), jnp.concatenate([N, _pad(N, _TERMS)])

        def go_up(below, given):
            n, c = given
            return ratio * (c - below) / n, below

        _, f = jax.lax.scan(go_up, none, every)
        f = f[:_STORED] + jnp.stack(_multiply(_FOLD, [*f[_STORED:]]))
        powers = jnp.where(quick, jnp.concatenate([p, _pad(p, _STORED)]), f)
        rest = jnp.where(quick, f_0 - p[0], f_0)
        return cls(powers, rest, jnp.where(tau > 0, h / jnp.where(tau > 0, tau, 1.0), jnp.inf))

    def fade(self, share: Float[ArrayLike, ""]) -> Float[Array, "*strides"]:
        """What is left at a share of the stride of what decays, of 1."""
        sharp = jnp.isinf(self.ratio)
        return jnp.where(sharp, 0.0, jnp.exp(-jnp.where(sharp, 1.0, self.ratio) * share))

    def value(self, share: Float[ArrayLike, ""]) -> Float[Array, "*strides"]:
        """f [N] at a share of the stride."""
        return sum_powers(self.powers, share) + self.rest * self.fade(share)


def _pad(powers: Array, terms: int) -> Array:
    """Zeros (.., strides) for as many powers as are missing up to so many terms."""
    return jnp.zeros((terms - len(powers), *powers.shape[1:]))
