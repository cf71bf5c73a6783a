"""One accepted step of a push as smooth functions of time: position, tip and contact force."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.polynomial import polynomial

from difffric.simulation.dynamics import Course, Motion, Point

_NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(8) / 7)
_TO_POWERS = np.linalg.inv(polynomial.polyvander(_NODES, 7))
"""Turns values at the nodes into coefficients of powers of the share of the step."""


def _septic():
    """Rows of the coefficients of 1, s, ..., s^7 by (x, x', x'', x''') at 0 and at 1."""
    rows = []
    for at in (0.0, 1.0):
        for order in range(4):
            row = np.zeros(8)
            for n in range(order, 8):
                row[n] = np.prod(np.arange(n - order + 1, n + 1)) * at ** (n - order)
            rows.append(row)
    return np.linalg.inv(np.array(rows))


_SEPTIC = _septic()


def _times(matrix, values) -> tuple:
    """A constant matrix times a few numbers, in plain arithmetic: it vectorises over pushes."""
    return tuple(
        sum(float(c) * v for c, v in zip(row, values, strict=True) if abs(c) > 1e-14)
        for row in matrix
    )


def _power_sum(coefficients, share):
    total = coefficients[-1]
    for c in coefficients[-2::-1]:
        total = total * share + c
    return total


class Stride(NamedTuple):
    """A step from `t` over `h` [s], with polynomials in the share of it (0 to `end`).

    `end` is 1, but for a hair where an event ends the step; its derivatives are the event's.
    """

    t: Array
    h: Array
    end: Array
    course: Course
    x: tuple
    """eight coefficients of the part's position [m]"""
    y: tuple
    """six coefficients of the tip's travel [m]"""

    @classmethod
    def of(cls, motion: Motion, course: Course, start, end, h, share) -> Stride:
        """From (state, its rate, the rate's rate) at shares 0 and 1."""

        def jet(s: Point, r: Point, rr: Point):
            gap = motion.rig.contact.gap
            return [s.y - gap - s.z, s.u * h, r.u * h**2, rr.u * h**3]

        def tip(s: Point, r: Point, rr: Point):
            return [s.y, r.y * h, rr.y * h**2]

        x = _times(_SEPTIC, jet(*start) + jet(*end))
        (y_0, v_0, a_0), (y_1, v_1, a_1) = tip(*start), tip(*end)
        rest = [y_1 - y_0 - v_0 - 0.5 * a_0, v_1 - v_0 - a_0, a_1 - a_0]
        y = (y_0, v_0, 0.5 * a_0, *_times(_QUINTIC, rest))
        return cls(start[0].t, h, share, course, x, y)

    def position(self, share):
        """x [m]."""
        return _power_sum(self.x, share)

    def point(self, motion: Motion, share) -> Point:
        """The state at a share of the step."""
        rate = [n * c for n, c in enumerate(self.x)][1:]
        x, y = self.position(share), _power_sum(self.y, share)
        u = _power_sum(rate, share) / self.h
        return Point(self.t + share * self.h, y - motion.rig.contact.gap - x, u, y)

    def force(self, motion: Motion, share):
        """The contact force [N]."""
        return motion.force(self.course, self.point(motion, share))

    def force_powers(self, motion: Motion):
        """Eight coefficients of the contact force [N]."""
        at = jax.vmap(lambda share: self.force(motion, share))(jnp.asarray(_NODES))
        return _times(_TO_POWERS, [at[i] for i in range(len(_NODES))])


_QUINTIC = np.linalg.inv(np.array([[1.0, 1.0, 1.0], [3.0, 4.0, 5.0], [6.0, 12.0, 20.0]]))


class OnePole(NamedTuple):
    """`tau f' = N - f` over a stride, N a polynomial: its exact solution, for any tau >= 0."""

    powers: tuple
    """of N's particular solution, or of f itself where the step is short beside tau"""
    rest: Array
    """what decays"""
    ratio: Array
    """step / tau"""

    @classmethod
    def of(cls, N, f_0, h, tau) -> OnePole:
        quick = tau < h
        # Quick: p + p' / ratio = N, from the highest power down.
        inverse = jnp.where(quick, tau, 0.0) / h
        p = [N[-1]]
        for n in range(len(N) - 2, -1, -1):
            p.append(N[n] - (n + 1) * inverse * p[-1])
        p = p[::-1]
        # Slow: f' = ratio (N - f), from the lowest power up.
        ratio = jnp.where(quick, 0.0, h / jnp.where(quick, 1.0, tau))
        f = [f_0]
        for n in range(_TERMS - 1):
            c = N[n] if n < len(N) else 0.0
            f.append(ratio * (c - f[-1]) / (n + 1))
        p += [0.0] * (_TERMS - len(p))
        powers = tuple(jnp.where(quick, a, b) for a, b in zip(p, f, strict=True))
        rest = jnp.where(quick, f_0 - p[0], 0.0)
        steep = jnp.where(tau > 0, h / jnp.where(tau > 0, tau, 1.0), jnp.inf)
        return cls(powers, rest, jnp.where(quick, steep, 0.0))

    def value(self, share):
        """f [N] at a share of the stride."""
        sharp = jnp.isinf(self.ratio)
        fades = jnp.where(sharp, 0.0, jnp.exp(-jnp.where(sharp, 1.0, self.ratio) * share))
        return _power_sum(self.powers, share) + self.rest * fades


_TERMS = 18
