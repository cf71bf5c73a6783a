"""Closed forms of the two affine motions: the damped oscillator and the viscous slide.

Everything here holds without a break from underdamped through critical to overdamped, and
for a vanishing viscosity; derivatives pass through each of these limits.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

_SINE = [(-1.0) ** n / float(np.prod(np.arange(1.0, 2 * n + 2))) for n in range(8)]
_COSINE = [(-1.0) ** n / float(np.prod(np.arange(1.0, 2 * n + 1))) for n in range(8)]
_ARCTAN = [(-1.0) ** n / (2 * n + 1) for n in range(10)]
_DECAY = [(-1.0) ** n / float(np.prod(np.arange(1.0, n + 3))) for n in range(14)]
_BRAKE = [(-1.0) ** n / (n + 2) for n in range(14)]


def _series(coefficients, x):
    total = jnp.full_like(x, coefficients[-1])
    for c in coefficients[-2::-1]:
        total = total * x + c
    return total


class Oscillator(NamedTuple):
    """p'' + 2 alpha p' + omega0_sq p = 0."""

    alpha: Array
    omega0_sq: Array

    @property
    def discriminant(self):
        """omega0^2 - alpha^2: positive underdamped, negative overdamped [1/s^2]."""
        return self.omega0_sq - self.alpha**2

    def basis(self, t):
        """exp(-alpha t) times cos(omega t) and sin(omega t)/omega, omega^2 = discriminant."""
        D = self.discriminant
        x = D * t**2
        small = jnp.abs(x) < 0.1
        under, over = (D > 0) & ~small, (D <= 0) & ~small
        omega = jnp.sqrt(jnp.where(under, D, 1.0))
        t_u = jnp.where(under, t, 0.0)
        beta = jnp.sqrt(jnp.where(over, -D, 1.0))
        t_o = jnp.where(over, t, 0.0)
        fast = jnp.exp(-(self.alpha + beta) * t_o)
        slow = jnp.exp(-self.omega0_sq / (self.alpha + beta) * t_o)
        x_s = jnp.where(small, x, 0.0)
        decay = jnp.exp(-self.alpha * jnp.where(over, 0.0, t))
        c = jnp.where(
            over,
            0.5 * (slow + fast),
            decay * jnp.where(small, _series(_COSINE, x_s), jnp.cos(omega * t_u)),
        )
        s = jnp.where(
            over,
            0.5 * (slow - fast) / beta,
            decay * jnp.where(small, t * _series(_SINE, x_s), jnp.sin(omega * t_u) / omega),
        )
        return c, s

    def flow(self, p, dp, t):
        """(p, p') after the time t [s]."""
        c, s = self.basis(t)
        q = self.alpha * dp + self.omega0_sq * p
        return p * c + (dp + self.alpha * p) * s, dp * c - q * s

    def turning_time(self, p, dp, sign):
        """First t >= 0 with p' = 0, where sign * p' >= 0 at the start; infinite if never.

        With p' = 0 at the start and p on the far side (sign * p < 0) it is half a period.
        """
        D = self.discriminant
        W = sign * dp
        Q = sign * (self.alpha * dp + self.omega0_sq * p)
        s = D * W**2 / jnp.where(Q == 0, 1.0, Q) ** 2
        small = (Q > 0) & (jnp.abs(s) < 0.01)
        under = (D > 0) & ~small
        ratio = W / jnp.where(Q > 0, Q, 1.0)
        near = ratio * _series(_ARCTAN, jnp.where(small, s, 0.0))
        omega = jnp.sqrt(jnp.where(under, D, 1.0))
        angle = jnp.arctan2(omega * jnp.where(under, W, 0.0), jnp.where(under, Q, 1.0))
        # W may be -0.0, or a rounding below it: half a period ahead all the same.
        trig = jnp.where(angle < 0, angle + 2 * jnp.pi, angle) / omega
        beta = jnp.sqrt(jnp.where(D < 0, -D, 1.0))
        over = (D < 0) & ~small & (Q > beta * W)
        r = jnp.where(over, beta * ratio, 0.0)
        hyperbolic = 0.5 * jnp.log1p(2 * r / (1 - r)) / beta
        return jnp.where(small, near, jnp.where(under, trig, jnp.where(over, hyperbolic, jnp.inf)))

    def extremum(self, p, dp, t):
        """|p| at a turning time t: omega0^2 p^2 + 2 alpha p p' + p'^2 falls as exp(-2 alpha t),
        so that no trigonometry is needed."""
        Q = self.omega0_sq * p**2 + 2 * self.alpha * p * dp + dp**2
        Q = jnp.where(Q > 0, Q, 0.0)
        root = jnp.where(Q > 0, jnp.sqrt(jnp.where(Q > 0, Q, 1.0)), 0.0)
        return jnp.exp(-self.alpha * t) * root / jnp.sqrt(self.omega0_sq)


class Slide(NamedTuple):
    """u' = -(drag + rate u): Coulomb and viscous friction per unit of mass."""

    drag: Array
    rate: Array

    def flow(self, u, t):
        """(distance, speed) after the time t [s], from the speed u."""
        x = self.rate * t
        small = jnp.abs(x) < 0.2
        x_l = jnp.where(small, 1.0, x)
        one = jnp.where(small, 1.0 - x * _series(_DECAY, x), -jnp.expm1(-x_l) / x_l)
        two = jnp.where(small, _series(_DECAY, x), (x_l + jnp.expm1(-x_l)) / x_l**2)
        return t * (u * one - self.drag * t * two), u - (self.drag + self.rate * u) * t * one

    def rest(self, u):
        """(time, distance) to rest from the speed u."""
        y = self.rate * u / self.drag
        small = jnp.abs(y) < 0.1
        y_l = jnp.where(small, 1.0, y)
        y_s = jnp.where(small, y, 0.0)
        log = jnp.log1p(y_l)
        half = jnp.where(small, _series(_BRAKE, y_s), (1.0 - log / y_l) / y_l)
        one = jnp.where(small, 1.0 - y_s * half, log / y_l)
        return u / self.drag * one, u**2 / self.drag * half
